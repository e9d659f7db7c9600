//! Two-dimensional images.

use std::sync::Arc;

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::Allocation;

use super::error::call;
use super::{Buffer, Device, GpuError};

/// Parameters of an image to create: one mip level, device memory.
#[derive(Clone, Debug)]
pub struct ImageDesc<'a> {
    /// Name in validation messages.
    pub name: &'a str,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Layer count of an array image; `None` for a plain image.
    pub layers: Option<u32>,
    /// Pixel format.
    pub format: vk::Format,
    /// Allowed uses.
    pub usage: vk::ImageUsageFlags,
}

impl ImageDesc<'_> {
    fn info(&self) -> vk::ImageCreateInfo<'static> {
        vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(self.format)
            .extent(vk::Extent3D { width: self.width, height: self.height, depth: 1 })
            .mip_levels(1)
            .array_layers(self.layers.unwrap_or(1))
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(self.usage)
    }
}

/// An image, its memory and a view of it.
pub struct Image {
    device: Arc<Device>,
    pub(super) raw: vk::Image,
    pub(super) view: vk::ImageView,
    pub(super) format: vk::Format,
    /// Layout that shaders read it in.
    pub(super) read_layout: vk::ImageLayout,
    width: u32,
    height: u32,
    layers: Option<u32>,
    allocation: Option<Allocation>,
    /// Owner of the memory, for an image over a buffer.
    _buffer: Option<Arc<Buffer>>,
}

impl Image {
    /// Creates an image with undefined contents.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the device does not support the format, usage or size.
    pub fn new(device: &Arc<Device>, desc: &ImageDesc<'_>) -> Result<Self, GpuError> {
        device.check_image(desc)?;
        let read_layout = read_layout(desc.format);
        let mut image = Self::without_memory(device, desc, vk::ImageTiling::OPTIMAL, read_layout)?;
        let raw = image.raw;
        // SAFETY: the image is alive.
        let needs = unsafe { device.calls().get_image_memory_requirements(raw) };
        let allocation = device.allocate(desc.name, needs, MemoryLocation::GpuOnly, false)?;
        let allocation = image.allocation.insert(allocation);
        // SAFETY: only used for binding, and the allocation outlives the image (see `drop`).
        let memory = unsafe { allocation.memory() };
        // SAFETY: the range was allocated for these requirements and is bound once.
        let bound = unsafe { device.calls().bind_image_memory(raw, memory, allocation.offset()) };
        bound.map_err(call("vkBindImageMemory"))?;
        image.make_view()?;
        Ok(image)
    }

    /// Creates a sampled image that aliases a buffer's memory: its pixels are the buffer's bytes in tightly
    /// packed rows. Its read layout is GENERAL, entered by one [`Recorder::adopt`](super::Recorder::adopt).
    /// Returns `None` if the device does not support such images, this size, or rows without padding.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the host can map the buffer.
    pub(crate) fn over_buffer(buffer: &Arc<Buffer>, desc: &ImageDesc<'_>) -> Result<Option<Self>, GpuError> {
        let (device, tiling) = (buffer.device(), vk::ImageTiling::LINEAR);
        if buffer.users().is_some() {
            return Err(device.unsupported("a buffer of the device alone under an image", desc.name));
        }
        if !device.has_image(desc.format, tiling, desc.usage, [desc.width, desc.height])? {
            return Ok(None);
        }
        let mut image = Self::without_memory(device, desc, tiling, vk::ImageLayout::GENERAL)?;
        image._buffer = Some(buffer.clone());
        let raw = image.raw;
        // SAFETY: the image is alive.
        let needs = unsafe { device.calls().get_image_memory_requirements(raw) };
        let part = vk::ImageSubresource::default().aspect_mask(aspect(desc.format));
        // SAFETY: the image is alive and linear, and has this one level and layer.
        let layout = unsafe { device.calls().get_image_subresource_layout(raw, part) };
        let gapless = layout.offset == 0 && layout.row_pitch == u64::from(desc.width) * image.pixel_bytes();
        let Some((memory, offset)) = buffer.memory_for(&needs).filter(|_| gapless) else { return Ok(None) };
        // SAFETY: the buffer's memory is of a type that the image accepts, large enough and aligned; the
        // image owns a reference to the buffer, so the memory outlives it.
        let bound = unsafe { device.calls().bind_image_memory(raw, memory, offset) };
        bound.map_err(call("vkBindImageMemory"))?;
        image.make_view()?;
        Ok(Some(image))
    }

    /// Creates an image without bound memory; tiling and layout depend on the memory that the caller binds.
    fn without_memory(
        device: &Arc<Device>,
        desc: &ImageDesc<'_>,
        tiling: vk::ImageTiling,
        read_layout: vk::ImageLayout,
    ) -> Result<Self, GpuError> {
        let info = desc.info().tiling(tiling);
        // SAFETY: the create info contains no pointers; the call or the validation layer reports an invalid
        // one.
        let raw = unsafe { device.calls().create_image(&info, None) }.map_err(call("vkCreateImage"))?;
        let image = Self {
            device: device.clone(),
            raw,
            view: vk::ImageView::null(),
            format: desc.format,
            read_layout,
            width: desc.width,
            height: desc.height,
            layers: desc.layers,
            allocation: None,
            _buffer: None,
        };
        device.set_name(raw, desc.name)?;
        Ok(image)
    }

    fn make_view(&mut self) -> Result<(), GpuError> {
        let plain = self.layers.is_none();
        let info = vk::ImageViewCreateInfo::default()
            .image(self.raw)
            .view_type(if plain { vk::ImageViewType::TYPE_2D } else { vk::ImageViewType::TYPE_2D_ARRAY })
            .format(self.format)
            .subresource_range(whole(self.format));
        // SAFETY: the image is alive, bound, and has this format.
        let view = unsafe { self.device.calls().create_image_view(&info, None) };
        self.view = view.map_err(call("vkCreateImageView"))?;
        Ok(())
    }

    /// Returns the width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns the number of layers.
    pub fn layers(&self) -> u32 {
        self.layers.unwrap_or(1)
    }

    /// Returns the size of a pixel in bytes.
    pub(super) fn pixel_bytes(&self) -> u64 {
        match self.format {
            vk::Format::R32G32B32A32_UINT => 16,
            vk::Format::R32G32_UINT | vk::Format::R16G16B16A16_SFLOAT => 8,
            vk::Format::R8G8_UNORM => 2,
            _ => 4,
        }
    }
}

/// Returns whether a format holds depth.
fn is_depth(format: vk::Format) -> bool {
    format == vk::Format::D32_SFLOAT
}

/// Returns the layout that shaders read an image in after a pass has drawn it.
pub(super) fn read_layout(format: vk::Format) -> vk::ImageLayout {
    if is_depth(format) {
        vk::ImageLayout::DEPTH_STENCIL_READ_ONLY_OPTIMAL
    } else {
        vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL
    }
}

/// Returns the aspect of a format: color or depth.
pub(super) fn aspect(format: vk::Format) -> vk::ImageAspectFlags {
    if is_depth(format) { vk::ImageAspectFlags::DEPTH } else { vk::ImageAspectFlags::COLOR }
}

pub(super) fn whole(format: vk::Format) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange::default()
        .aspect_mask(aspect(format))
        .level_count(1)
        .layer_count(vk::REMAINING_ARRAY_LAYERS)
}

impl Drop for Image {
    fn drop(&mut self) {
        // SAFETY: no commands use it (recorders borrow it, submits are waited for); null is ignored.
        unsafe { self.device.calls().destroy_image_view(self.view, None) };
        // SAFETY: as above, and its view is destroyed.
        unsafe { self.device.calls().destroy_image(self.raw, None) };
        if let Some(allocation) = self.allocation.take() {
            self.device.free(allocation);
        }
    }
}
