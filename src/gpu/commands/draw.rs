//! Recording of draws into a target.

use std::ops::Range;

use ash::vk;

use crate::gpu::{
    Area, Buffer, DepthTest, DescriptorSet, GpuError, GraphicsPipeline, Indices, Recorder, Target,
};

impl<'a> Recorder<'a> {
    /// Begins a render pass on the top left area of a target and clears it: colors to 0, depth to the value
    /// of its [`DepthTest`].
    pub fn pass(&mut self, target: &'a Target, area: Area) -> Pass<'_, 'a> {
        let extent = vk::Extent2D {
            width: area.width.min(target.extent.width),
            height: area.height.min(target.extent.height),
        };
        let depth = if target.pass.depth == Some(DepthTest::Greater) { 0.0 } else { 1.0 };
        let depth_stencil = vk::ClearDepthStencilValue { depth, stencil: 0 };
        let mut clears = vec![vk::ClearValue::default(); target.pass.colors];
        clears.extend(target.pass.depth.map(|_| vk::ClearValue { depth_stencil }));
        let render_area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
        let info = vk::RenderPassBeginInfo::default()
            .render_pass(target.pass.raw)
            .framebuffer(target.raw)
            .render_area(render_area)
            .clear_values(&clears);
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
        Pass { recorder: self, pipeline: None, vertices: None, indices: None }
    }
}

/// A render pass being recorded; ends on drop.
pub struct Pass<'r, 'a> {
    recorder: &'r mut Recorder<'a>,
    pipeline: Option<&'a GraphicsPipeline>,
    vertices: Option<&'a Buffer>,
    indices: Option<&'a Indices>,
}

impl<'a> Pass<'_, 'a> {
    /// Binds a pipeline and descriptor sets for the following draws.
    pub fn bind(&mut self, pipeline: &'a GraphicsPipeline, sets: &[&'a DescriptorSet]) {
        let point = vk::PipelineBindPoint::GRAPHICS;
        // SAFETY: recording; the pipeline is alive and fits the pass.
        unsafe { self.recorder.device().cmd_bind_pipeline(self.recorder.raw(), point, pipeline.raw) };
        self.recorder.bind_sets(point, &pipeline.layout, sets);
        self.pipeline = Some(pipeline);
    }

    /// Binds a buffer of vertices (or instances) for the following draws.
    pub fn vertices(&mut self, buffer: &'a Buffer) {
        self.recorder.uses(buffer);
        // SAFETY: recording; the buffer is alive.
        unsafe {
            self.recorder.device().cmd_bind_vertex_buffers(self.recorder.raw(), 0, &[buffer.raw], &[0])
        };
        self.vertices = Some(buffer);
    }

    /// Binds an index buffer for the following draws.
    pub fn indices(&mut self, indices: &'a Indices) {
        let (buffer, kind) = (indices.raw(), vk::IndexType::UINT32);
        // SAFETY: recording; the buffer is alive and has the index buffer usage.
        unsafe { self.recorder.device().cmd_bind_index_buffer(self.recorder.raw(), buffer, 0, kind) };
        self.indices = Some(indices);
    }

    /// Draws a vertex range of the bound buffer, or the given number of instances. A pipeline without vertex
    /// inputs needs no buffer.
    ///
    /// # Errors
    /// Fails if the buffer is too small, or if no pipeline or buffer is bound.
    pub fn draw(&mut self, push: &[u8], vertices: Range<u32>, instances: u32) -> Result<(), GpuError> {
        let pipeline = self.pipeline.ok_or_else(|| unbound("pipeline"))?;
        self.check_vertices(pipeline, if pipeline.per_instance { instances } else { vertices.end })?;
        self.recorder.push_constants(&pipeline.layout, push)?;
        let (first, count) = (vertices.start, vertices.end.saturating_sub(vertices.start));
        // SAFETY: recording inside a pass with a bound pipeline; all vertices are inside the buffer.
        unsafe { self.recorder.device().cmd_draw(self.recorder.raw(), count, instances, first, 0) };
        Ok(())
    }

    /// Draws the vertices selected by a range of the bound indices.
    ///
    /// # Errors
    /// Fails if one of the buffers is too small, or if no pipeline or buffer is bound.
    pub fn draw_indexed(&mut self, push: &[u8], indices: Range<u32>) -> Result<(), GpuError> {
        let pipeline = self.pipeline.ok_or_else(|| unbound("pipeline"))?;
        let bound = self.indices.ok_or_else(|| unbound("index buffer"))?;
        bound.check(&indices)?;
        self.check_vertices(pipeline, bound.end())?;
        self.recorder.push_constants(&pipeline.layout, push)?;
        let (first, count) = (indices.start, indices.end.saturating_sub(indices.start));
        // SAFETY: recording inside a pass with a bound pipeline; all indices are inside their buffer, and all
        // vertices that they select inside theirs.
        unsafe { self.recorder.device().cmd_draw_indexed(self.recorder.raw(), count, 1, first, 0, 0) };
        Ok(())
    }

    /// Fails if the bound buffer has fewer than `count` vertices (or instances).
    fn check_vertices(&self, pipeline: &GraphicsPipeline, count: u32) -> Result<(), GpuError> {
        let Some(stride) = pipeline.stride else { return Ok(()) };
        let buffer = self.vertices.ok_or_else(|| unbound("vertex buffer"))?;
        buffer.check(u64::from(count) * u64::from(stride))
    }
}

fn unbound(what: &str) -> GpuError {
    GpuError::Range { expected: 1, found: 0, name: format!("an unbound {what}") }
}

impl Drop for Pass<'_, '_> {
    fn drop(&mut self) {
        // SAFETY: recording inside the pass that `Recorder::pass` began.
        unsafe { self.recorder.device().cmd_end_render_pass(self.recorder.raw()) };
    }
}
