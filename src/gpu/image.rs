//! Two-dimensional images.

use std::sync::Arc;

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::Allocation;

use super::error::call;
use super::{Device, GpuError};

/// An image to be made: one layer, one level, device memory.
#[derive(Clone, Debug)]
pub struct ImageDesc<'a> {
    /// What validation messages call it.
    pub name: &'a str,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Pixel format.
    pub format: vk::Format,
    /// What it is used for.
    pub usage: vk::ImageUsageFlags,
}

/// An image, its memory and a view of it.
pub struct Image {
    device: Arc<Device>,
    pub(super) raw: vk::Image,
    pub(super) view: vk::ImageView,
    pub(super) format: vk::Format,
    width: u32,
    height: u32,
    allocation: Option<Allocation>,
}

impl Image {
    /// Makes an image; its content is undefined.
    ///
    /// # Errors
    /// Out of memory; a format, use or size that the device does not have.
    pub fn new(device: &Arc<Device>, desc: &ImageDesc<'_>) -> Result<Self, GpuError> {
        device.check_image(desc.format, desc.usage, [desc.width, desc.height])?;
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(desc.format)
            .extent(vk::Extent3D { width: desc.width, height: desc.height, depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(desc.usage);
        // SAFETY: a plain description; a bad one is reported by the call or by the validation layer.
        let raw = unsafe { device.raw.create_image(&info, None) }.map_err(call("vkCreateImage"))?;
        let mut image = Self {
            device: device.clone(),
            raw,
            view: vk::ImageView::null(),
            format: desc.format,
            width: desc.width,
            height: desc.height,
            allocation: None,
        };
        device.set_name(raw, desc.name)?;
        // SAFETY: the image is alive.
        let needs = unsafe { device.raw.get_image_memory_requirements(raw) };
        let allocation = device.allocate(desc.name, needs, MemoryLocation::GpuOnly, false)?;
        let allocation = image.allocation.insert(allocation);
        // SAFETY: only used for binding, and the allocation outlives the image (see `drop`).
        let memory = unsafe { allocation.memory() };
        // SAFETY: the range was allocated for these requirements and is bound once.
        let bound = unsafe { device.raw.bind_image_memory(raw, memory, allocation.offset()) };
        bound.map_err(call("vkBindImageMemory"))?;
        let info = vk::ImageViewCreateInfo::default()
            .image(raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(desc.format)
            .subresource_range(whole(desc.format));
        // SAFETY: the image is alive, bound, and has this format.
        let view = unsafe { device.raw.create_image_view(&info, None) };
        image.view = view.map_err(call("vkCreateImageView"))?;
        Ok(image)
    }

    /// Pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels.
    pub fn height(&self) -> u32 {
        self.height
    }
}

/// Whether a format holds depth.
pub(super) fn is_depth(format: vk::Format) -> bool {
    format == vk::Format::D32_SFLOAT
}

/// Color or depth.
pub(super) fn aspect(format: vk::Format) -> vk::ImageAspectFlags {
    if is_depth(format) { vk::ImageAspectFlags::DEPTH } else { vk::ImageAspectFlags::COLOR }
}

fn whole(format: vk::Format) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange::default().aspect_mask(aspect(format)).level_count(1).layer_count(1)
}

impl Drop for Image {
    fn drop(&mut self) {
        // SAFETY: no commands use it (recorders borrow it, submits are waited for); null is ignored.
        unsafe { self.device.raw.destroy_image_view(self.view, None) };
        // SAFETY: as above, and its view is gone.
        unsafe { self.device.raw.destroy_image(self.raw, None) };
        if let Some(allocation) = self.allocation.take() {
            self.device.free(allocation);
        }
    }
}
