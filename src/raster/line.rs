//! Lines: a quad per segment, and an exact test per pixel (`glsl/line.vert`, `.frag`).
//!
//! # How it works
//! The host works out the numbers of [`LineTest`] once; the vertex shader draws a rectangle that is larger by more
//! than its rounding, and the fragment shader decides with the operations of the CPU twin. Later segments are drawn
//! over earlier ones, since primitives keep their order.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use bytemuck::{Pod, Zeroable};

use super::Segment;
use super::line_test::LineTest;
use super::tiles::Tile;
use crate::gpu::{
    Area, Buffer, BufferDesc, Device, GpuError, GraphicsPipeline, GraphicsPipelineDesc, Image, ImageDesc,
    Memory, PipelineLayout, Recorder, RenderPass, RenderPassDesc, Scope, Target, Topology, VertexBuffer,
    assert_layout, shaders,
};

const COLOR: vk::Format = vk::Format::R8G8B8A8_UINT;
/// Bytes per pixel.
const PIXEL_BYTES: u64 = 4;

/// A segment as the shaders take it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct LineInstance {
    from: [f32; 2],
    along: [f32; 2],
    length_half_width: [f32; 2],
    rgb: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct LinePush {
    tile_origin: [f32; 2],
    tile_size: [f32; 2],
}
assert_layout!(LinePush, shaders::line_vert::line_push, [tile_origin: TILE_ORIGIN, tile_size: TILE_SIZE]);
assert_layout!(LinePush, shaders::line_frag::line_push, [tile_origin: TILE_ORIGIN, tile_size: TILE_SIZE]);

impl LineInstance {
    /// `None` for a segment that covers nothing in an image of this width and height.
    pub(super) fn new(segment: &Segment, half_width: f32, size: [u32; 2]) -> Option<Self> {
        let test = LineTest::new(segment, half_width, size)?;
        let [r, g, b] = segment.rgb;
        Some(Self {
            from: test.from,
            along: test.along,
            length_half_width: [test.length, test.half_width],
            rgb: u32::from_le_bytes([r, g, b, 0]),
        })
    }
}

/// What does not depend on sizes.
pub(super) struct LineStage {
    pipeline: GraphicsPipeline,
    pass: Arc<RenderPass>,
}

/// Image of one size.
pub(super) struct LineTarget {
    color: Arc<Image>,
    target: Target,
    /// What the host reads: RGBA per pixel of the tile.
    pub(super) readback: Buffer,
}

impl LineTarget {
    /// Width and height, pixels.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.color.width(), self.color.height()]
    }
}

impl LineStage {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let (vertex, fragment) = (&shaders::line_vert::SHADER, &shaders::line_frag::SHADER);
        let layout = Arc::new(PipelineLayout::new(device, &[vertex, fragment])?);
        let color_read = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        let desc = RenderPassDesc { name: "lines", colors: &[COLOR], color_read, depth: None };
        let pass = Arc::new(RenderPass::new(device, &desc)?);
        let offsets = [
            std::mem::offset_of!(LineInstance, from) as u32,
            std::mem::offset_of!(LineInstance, along) as u32,
            std::mem::offset_of!(LineInstance, length_half_width) as u32,
            std::mem::offset_of!(LineInstance, rgb) as u32,
        ];
        let stride = size_of::<LineInstance>() as u32;
        let pipeline = GraphicsPipeline::new(&GraphicsPipelineDesc {
            name: "lines",
            layout: &layout,
            vertex,
            fragment,
            pass: &pass,
            topology: Topology::TriangleStrip,
            vertices: Some(VertexBuffer { stride, per_instance: true, offsets: &offsets }),
        })?;
        Ok(Self { pipeline, pass })
    }

    /// An image for tiles of up to this width and height, pixels.
    pub(super) fn target(
        &self,
        device: &Arc<Device>,
        [width, height]: [u32; 2],
    ) -> Result<LineTarget, GpuError> {
        let usage = ImageUsageFlags::COLOR_ATTACHMENT | ImageUsageFlags::TRANSFER_SRC;
        let desc = ImageDesc { name: "lines", width, height, layers: None, format: COLOR, usage };
        let color = Arc::new(Image::new(device, &desc)?);
        let target = Target::new(&self.pass, vec![color.clone()])?;
        let size = u64::from(width) * u64::from(height) * PIXEL_BYTES;
        let (usage, memory) = (Usage::TRANSFER_DST, Memory::Readback);
        let readback = Buffer::new(device, &BufferDesc { name: "lines for the host", size, usage, memory })?;
        Ok(LineTarget { color, target, readback })
    }

    /// Room for so many segments.
    pub(super) fn buffer(device: &Arc<Device>, segments: usize) -> Result<Buffer, GpuError> {
        let (size, usage) = ((segments * size_of::<LineInstance>()) as u64, Usage::VERTEX_BUFFER);
        Buffer::new(device, &BufferDesc { name: "segments", size, usage, memory: Memory::Upload })
    }

    /// Draws the segments of one tile and copies it to the host.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        target: &'a LineTarget,
        tile: &Tile,
        (lines, count): (&'a Buffer, u32),
    ) -> Result<(), GpuError> {
        let push =
            LinePush { tile_origin: tile.origin.map(|v| v as f32), tile_size: tile.size.map(|v| v as f32) };
        let [width, height] = tile.size;
        let mut pass = recorder.pass(&target.target, Area { width, height, viewport_pad: 0 });
        pass.bind(&self.pipeline, &[]);
        pass.vertices(lines);
        pass.draw(bytemuck::bytes_of(&push), 0..4, count)?;
        drop(pass);
        recorder.copy_image(&target.color, tile.size, &target.readback)?;
        recorder.barrier(Scope::CopyWrite, Scope::Host);
        recorder.stamp("lines");
        Ok(())
    }
}
