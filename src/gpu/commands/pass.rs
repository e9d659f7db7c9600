//! Render passes and their target images.

use std::sync::Arc;

use ash::vk;

use crate::gpu::error::call;
use crate::gpu::image::read_layout;
use crate::gpu::{Device, GpuError, Image};

/// Parameters of a render pass: its attachments are cleared at the start (except for [`DepthTest::Equal`]),
/// stored at the end, and then read.
#[derive(Clone, Debug)]
pub struct RenderPassDesc<'a> {
    /// Name in validation messages.
    pub name: &'a str,
    /// Formats of the color attachments.
    pub colors: &'a [vk::Format],
    /// Final layout of the color attachments, for the later read.
    pub color_read: vk::ImageLayout,
    /// Depth attachment if any; shaders read it afterwards.
    pub depth: Option<Depth>,
}

/// A depth attachment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Depth {
    /// Format.
    pub format: vk::Format,
    /// Depth test against earlier draws.
    pub test: DepthTest,
}

/// Comparison of a new depth with the stored depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthTest {
    /// Passes if less; cleared to 1.
    Less,
    /// Passes if greater; cleared to 0.
    Greater,
    /// Passes if equal to the depth of an earlier pass, which is neither cleared nor written.
    Equal,
}

/// A render pass with one subpass.
pub struct RenderPass {
    device: Arc<Device>,
    pub(in super::super) raw: vk::RenderPass,
    pub(in super::super) colors: usize,
    pub(in super::super) depth: Option<DepthTest>,
}

impl RenderPass {
    /// Creates a render pass.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub fn new(device: &Arc<Device>, desc: &RenderPassDesc<'_>) -> Result<Self, GpuError> {
        let retained = desc.depth.is_some_and(|depth| depth.test == DepthTest::Equal);
        let attachment = |format: vk::Format, layout| {
            vk::AttachmentDescription::default()
                .format(format)
                .samples(vk::SampleCountFlags::TYPE_1)
                .load_op(vk::AttachmentLoadOp::CLEAR)
                .store_op(vk::AttachmentStoreOp::STORE)
                .stencil_load_op(vk::AttachmentLoadOp::DONT_CARE)
                .stencil_store_op(vk::AttachmentStoreOp::DONT_CARE)
                .final_layout(layout)
        };
        let depth_attachment = |depth: Depth| {
            let layout = read_layout(depth.format);
            let cleared = attachment(depth.format, layout);
            if retained {
                cleared.load_op(vk::AttachmentLoadOp::LOAD).initial_layout(layout)
            } else {
                cleared
            }
        };
        let mut attachments: Vec<_> =
            desc.colors.iter().map(|format| attachment(*format, desc.color_read)).collect();
        attachments.extend(desc.depth.map(depth_attachment));
        let layout = vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL;
        let color = |attachment| vk::AttachmentReference { attachment, layout };
        let colors: Vec<_> = (0..desc.colors.len() as u32).map(color).collect();
        let depth = vk::AttachmentReference {
            attachment: desc.colors.len() as u32,
            layout: match desc.depth {
                Some(depth) if retained => read_layout(depth.format),
                _ => vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL,
            },
        };
        let mut subpass = vk::SubpassDescription::default().color_attachments(&colors);
        if desc.depth.is_some() {
            subpass = subpass.depth_stencil_attachment(&depth);
        }
        let (subpasses, dependencies) = ([subpass], dependencies());
        let info = vk::RenderPassCreateInfo::default()
            .attachments(&attachments)
            .subpasses(&subpasses)
            .dependencies(&dependencies);
        // SAFETY: `info` and what it points to live until after the call.
        let raw = unsafe { device.calls().create_render_pass(&info, None) };
        let raw = raw.map_err(call("vkCreateRenderPass"))?;
        let pass = Self {
            device: device.clone(),
            raw,
            colors: desc.colors.len(),
            depth: desc.depth.map(|d| d.test),
        };
        device.set_name(raw, desc.name)?;
        Ok(pass)
    }
}

/// Returns the dependencies: earlier reads finish before the pass writes, and later shaders and copies see
/// its writes.
fn dependencies() -> [vk::SubpassDependency; 2] {
    use vk::{AccessFlags as Access, PipelineStageFlags as At};
    let draws = At::COLOR_ATTACHMENT_OUTPUT | At::EARLY_FRAGMENT_TESTS | At::LATE_FRAGMENT_TESTS;
    let writes = Access::COLOR_ATTACHMENT_WRITE | Access::DEPTH_STENCIL_ATTACHMENT_WRITE;
    let readers = At::FRAGMENT_SHADER | At::COMPUTE_SHADER | At::TRANSFER;
    let before = vk::SubpassDependency::default()
        .src_subpass(vk::SUBPASS_EXTERNAL)
        .src_stage_mask(readers | draws)
        .src_access_mask(writes)
        .dst_stage_mask(draws)
        .dst_access_mask(writes | Access::DEPTH_STENCIL_ATTACHMENT_READ);
    let after = vk::SubpassDependency::default()
        .dst_subpass(vk::SUBPASS_EXTERNAL)
        .src_stage_mask(draws)
        .src_access_mask(writes)
        .dst_stage_mask(readers)
        .dst_access_mask(Access::SHADER_READ | Access::TRANSFER_READ);
    [before, after]
}

impl Drop for RenderPass {
    fn drop(&mut self) {
        // SAFETY: no commands use it (recorders borrow it, submits are waited for).
        unsafe { self.device.calls().destroy_render_pass(self.raw, None) };
    }
}

/// Drawn area of a target, from its top left corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Padding of the viewport on each side, pixels, so that large points with centers outside the area are
    /// drawn.
    pub viewport_pad: u32,
}

/// The images that a pass draws into.
pub struct Target {
    pub(in super::super) pass: Arc<RenderPass>,
    pub(in super::super) raw: vk::Framebuffer,
    pub(in super::super) extent: vk::Extent2D,
    _images: Vec<Arc<Image>>,
}

impl Target {
    /// Creates a framebuffer from images of one size: colors first, then depth if the pass has it.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the size exceeds the device's limits.
    pub fn new(pass: &Arc<RenderPass>, images: Vec<Arc<Image>>) -> Result<Self, GpuError> {
        let views: Vec<_> = images.iter().map(|image| image.view).collect();
        let (width, height) = images.first().map_or((0, 0), |i| (i.width(), i.height()));
        let info = vk::FramebufferCreateInfo::default()
            .render_pass(pass.raw)
            .attachments(&views)
            .width(width)
            .height(height)
            .layers(1);
        // SAFETY: the views are alive and owned by the target from here on.
        let raw = unsafe { pass.device.calls().create_framebuffer(&info, None) };
        let raw = raw.map_err(call("vkCreateFramebuffer"))?;
        Ok(Self { pass: pass.clone(), raw, extent: vk::Extent2D { width, height }, _images: images })
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        // SAFETY: no commands use it (recorders borrow it, submits are waited for).
        unsafe { self.pass.device.calls().destroy_framebuffer(self.raw, None) };
    }
}
