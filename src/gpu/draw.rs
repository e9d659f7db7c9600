//! Recording what is drawn into a target.

use std::ops::Range;

use ash::vk;

use super::{Area, Buffer, DescriptorSet, GpuError, GraphicsPipeline, Recorder, Target};

impl<'a> Recorder<'a> {
    /// Starts drawing into the top left of a target, which is cleared: color to 0, depth to 1.
    pub fn pass(&mut self, target: &'a Target, area: Area) -> Pass<'_, 'a> {
        let extent = vk::Extent2D {
            width: area.width.min(target.extent.width),
            height: area.height.min(target.extent.height),
        };
        let depth_stencil = vk::ClearDepthStencilValue { depth: 1.0, stencil: 0 };
        let clears = [vk::ClearValue::default(), vk::ClearValue { depth_stencil }];
        let render_area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
        let info = vk::RenderPassBeginInfo::default()
            .render_pass(target.pass.raw)
            .framebuffer(target.raw)
            .render_area(render_area)
            .clear_values(if target.pass.depth { &clears } else { &clears[..1] });
        // SAFETY: recording outside a pass; the area is inside the target.
        unsafe { self.device().cmd_begin_render_pass(self.raw(), &info, vk::SubpassContents::INLINE) };
        let pad = area.viewport_pad as f32;
        let viewport = vk::Viewport {
            x: -pad,
            y: -pad,
            width: area.width as f32 + 2.0 * pad,
            height: area.height as f32 + 2.0 * pad,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        // SAFETY: recording.
        unsafe { self.device().cmd_set_viewport(self.raw(), 0, &[viewport]) };
        // SAFETY: recording.
        unsafe { self.device().cmd_set_scissor(self.raw(), 0, &[render_area]) };
        Pass { recorder: self, pipeline: None, vertices: None }
    }
}

/// Drawing into a target; it ends when this is dropped.
pub struct Pass<'r, 'a> {
    recorder: &'r mut Recorder<'a>,
    pipeline: Option<&'a GraphicsPipeline>,
    vertices: Option<&'a Buffer>,
}

impl<'a> Pass<'_, 'a> {
    /// Draws with this pipeline and these sets from now on.
    pub fn bind(&mut self, pipeline: &'a GraphicsPipeline, sets: &[&'a DescriptorSet]) {
        let point = vk::PipelineBindPoint::GRAPHICS;
        // SAFETY: recording; the pipeline is alive and fits the pass.
        unsafe { self.recorder.device().cmd_bind_pipeline(self.recorder.raw(), point, pipeline.raw) };
        self.recorder.bind_sets(point, &pipeline.layout, sets);
        self.pipeline = Some(pipeline);
    }

    /// Takes vertices (or instances) from this buffer from now on.
    pub fn vertices(&mut self, buffer: &'a Buffer) {
        self.recorder.uses(buffer);
        // SAFETY: recording; the buffer is alive.
        unsafe {
            self.recorder.device().cmd_bind_vertex_buffers(self.recorder.raw(), 0, &[buffer.raw], &[0])
        };
        self.vertices = Some(buffer);
    }

    /// Draws vertices of the bound buffer once, or so many instances of it.
    ///
    /// # Errors
    /// The buffer is too small, or nothing is bound.
    pub fn draw(&mut self, push: &[u8], vertices: Range<u32>, instances: u32) -> Result<(), GpuError> {
        let unbound = || GpuError::Range { expected: 1, found: 0, name: "an unbound vertex buffer".into() };
        let (pipeline, buffer) = self.pipeline.zip(self.vertices).ok_or_else(unbound)?;
        let used = if pipeline.per_instance { instances } else { vertices.end };
        buffer.check(u64::from(used) * u64::from(pipeline.stride))?;
        self.recorder.push_constants(&pipeline.layout, push)?;
        let (first, count) = (vertices.start, vertices.end.saturating_sub(vertices.start));
        // SAFETY: recording inside a pass with a bound pipeline; all vertices are inside the buffer.
        unsafe { self.recorder.device().cmd_draw(self.recorder.raw(), count, instances, first, 0) };
        Ok(())
    }
}

impl Drop for Pass<'_, '_> {
    fn drop(&mut self) {
        // SAFETY: recording inside the pass that `Recorder::pass` began.
        unsafe { self.recorder.device().cmd_end_render_pass(self.recorder.raw()) };
    }
}
