//! Points to visibility buffer: the graphics pipeline draws squares with a depth test (`glsl/splat.vert`,
//! `.frag`).
//!
//! # How it works
//! Every point snaps to the center of its pixel, so that a square of odd size covers whole pixels. Depth is
//! `z·2⁻³⁰`, exact in `f32`; the test is LESS and primitives are in order, so the smallest index wins ties.
//! Points centered outside the viewport may be discarded, so the viewport exceeds the image by the maximum
//! radius.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use bytemuck::{Pod, Zeroable};

use super::pages::{Pages, PieceDraw};
use crate::cloud::Point;
use crate::gpu::{
    Area, Bind, Buffer, BufferDesc, Depth, DepthTest, DescriptorSet, Device, GpuError, GraphicsPipeline,
    GraphicsPipelineDesc, Image, ImageDesc, Memory, PipelineLayout, Recorder, RenderPass, RenderPassDesc,
    Scope, Target, Topology, VertexBuffer, assert_layout, shaders,
};
use crate::raster::steps::{Step, steps};
use crate::raster::tiles::Tile;
use crate::raster::{Draw, SplatSchedule};

const VISIBILITY: vk::Format = vk::Format::R32G32_UINT;
const DEPTH: vk::Format = vk::Format::D32_SFLOAT;

/// Uniforms shared by all draws of a tile.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct SplatFrame {
    steps: [Step; SplatSchedule::MAX_STEPS],
    tile_origin: [f32; 2],
    tile_size: [f32; 2],
    viewport_pad: f32,
    step_count: u32,
    pad: [u32; 2],
}
assert_layout!(SplatFrame, shaders::splat_vert::splat_frame, [
    steps: STEPS,
    tile_origin: TILE_ORIGIN,
    tile_size: TILE_SIZE,
    viewport_pad: VIEWPORT_PAD,
    step_count: STEP_COUNT,
]);

/// Push constants of a draw.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct SplatPush {
    image_x: [f32; 4],
    image_y: [f32; 4],
    image_z: [f32; 4],
    crop_x: [f32; 4],
    crop_y: [f32; 4],
    crop_radius_m: f32,
    piece: u32,
    pad: [u32; 2],
}
assert_layout!(SplatPush, shaders::splat_vert::splat_push, [
    image_x: IMAGE_X,
    image_y: IMAGE_Y,
    image_z: IMAGE_Z,
    crop_x: CROP_X,
    crop_y: CROP_Y,
    crop_radius_m: CROP_RADIUS_M,
    piece: PIECE,
]);

/// Resources independent of image sizes.
pub(super) struct SplatStage {
    pipeline: GraphicsPipeline,
    pass: Arc<RenderPass>,
    frame: Arc<Buffer>,
    set: DescriptorSet,
}

/// Target images of one size.
pub(super) struct SplatTarget {
    /// Per pixel: point within the page + 1, or 0; piece.
    pub(super) visibility: Arc<Image>,
    /// `z·2⁻³⁰`, 1 where empty.
    pub(super) depth: Arc<Image>,
    target: Target,
}

impl SplatStage {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let (vertex, fragment) = (&shaders::splat_vert::SHADER, &shaders::splat_frag::SHADER);
        let layout = Arc::new(PipelineLayout::new(device, &[vertex, fragment])?);
        let color_read = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        let depth = Some(Depth { format: DEPTH, test: DepthTest::Less });
        let desc = RenderPassDesc { name: "splat", colors: &[VISIBILITY], color_read, depth };
        let pass = Arc::new(RenderPass::new(device, &desc)?);
        let position = std::mem::offset_of!(Point, position) as u32;
        let pipeline = GraphicsPipeline::new(&GraphicsPipelineDesc {
            name: "splat",
            layout: &layout,
            vertex,
            fragment,
            pass: &pass,
            topology: Topology::Points,
            vertices: Some(VertexBuffer {
                stride: size_of::<Point>() as u32,
                per_instance: false,
                offsets: &[position],
            }),
        })?;
        let (size, usage) = (size_of::<SplatFrame>() as u64, Usage::UNIFORM_BUFFER | Usage::TRANSFER_DST);
        let desc = BufferDesc { name: "splat frame", size, usage, memory: Memory::Device };
        let frame = Arc::new(Buffer::new(device, &desc)?);
        let set = DescriptorSet::new(&layout, 0, vec![Bind::Buffer(frame.clone())])?;
        Ok(Self { pipeline, pass, frame, set })
    }

    /// Creates target images for tiles of up to this width and height, pixels.
    pub(super) fn target(
        &self,
        device: &Arc<Device>,
        [width, height]: [u32; 2],
    ) -> Result<SplatTarget, GpuError> {
        let image = |name, format, usage: ImageUsageFlags| {
            let usage = usage | ImageUsageFlags::SAMPLED;
            Image::new(device, &ImageDesc { name, width, height, layers: None, format, usage }).map(Arc::new)
        };
        let visibility = image("visibility", VISIBILITY, ImageUsageFlags::COLOR_ATTACHMENT)?;
        let depth = image("depth", DEPTH, ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT)?;
        let target = Target::new(&self.pass, vec![visibility.clone(), depth.clone()])?;
        Ok(SplatTarget { visibility, depth, target })
    }

    /// Records the draws of a tile's pieces.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        target: &'a SplatTarget,
        tile: &Tile,
        schedule: &SplatSchedule,
        (pages, draws, pieces): (&'a Pages, &[Draw], &[PieceDraw]),
    ) -> Result<(), GpuError> {
        recorder.update(&self.frame, 0, bytemuck::bytes_of(&frame(tile, schedule)))?;
        recorder.barrier(Scope::CopyWrite, Scope::ShaderRead);
        let [width, height] = tile.size;
        let area = Area { width, height, viewport_pad: schedule.max_radius() };
        let mut pass = recorder.pass(&target.target, area);
        pass.bind(&self.pipeline, &[&self.set]);
        for (index, piece) in pieces.iter().enumerate() {
            let slice = piece.slice;
            let push = push(&draws[piece.draw], index as u32);
            pass.vertices(&pages.pages[slice.page as usize].points);
            pass.draw(bytemuck::bytes_of(&push), slice.first..slice.first + slice.count, 1)?;
        }
        Ok(())
    }
}

/// Fails if the device does not support points as large as the schedule's maximum.
pub(super) fn check_point_size(device: &Device, schedule: &SplatSchedule) -> Result<(), GpuError> {
    let size = 2.0 * schedule.max_radius() as f32 + 1.0;
    if size == 1.0 {
        return Ok(());
    }
    let expected = format!("points of {size} pixels");
    let limits = device.limits();
    if !device.large_points() {
        return Err(device.unsupported(expected, "only points of 1 pixel (no feature largePoints)"));
    }
    if size > limits.point_size_range[1] || limits.point_size_granularity > 1.0 {
        let (max, step) = (limits.point_size_range[1], limits.point_size_granularity);
        return Err(device.unsupported(expected, format!("at most {max} pixels in steps of {step}")));
    }
    Ok(())
}

fn frame(tile: &Tile, schedule: &SplatSchedule) -> SplatFrame {
    SplatFrame {
        steps: steps(schedule),
        tile_origin: tile.origin.map(|v| v as f32),
        tile_size: tile.size.map(|v| v as f32),
        viewport_pad: schedule.max_radius() as f32,
        step_count: schedule.steps().len() as u32,
        pad: [0; 2],
    }
}

fn push(draw: &Draw, piece: u32) -> SplatPush {
    let [image_x, image_y, image_z] = draw.image_from_local;
    let [crop_x, crop_y] = draw.crop_from_local;
    let crop_radius_m = draw.crop_radius_m;
    SplatPush { image_x, image_y, image_z, crop_x, crop_y, crop_radius_m, piece, pad: [0; 2] }
}
