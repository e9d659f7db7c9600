//! Projection of points into visibility buffers (`glsl/project.wgsl`).

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::spread::Coverage;
use crate::gpu::{ComputePipeline, Device, GpuError, PipelineLayout, assert_layout, shaders};
use crate::raster::steps::{Step, steps};
use crate::raster::{Draw, SplatSchedule};

/// Descriptor set of a page of points.
pub(super) const PAGE_SET: u32 = 1;
/// Maximum radius that the resolve shaders gather.
pub(super) const MAX_LOOKED_FOR: u32 = 2;
/// Points per workgroup that draws squares: CPU drivers terminate invocations that loop more than 65 535 times, and
/// each square may have up to 63 by 63 pixels.
const SQUARES_AT_ONCE: u32 = 512;
/// Workgroups in a row of a dispatch.
const GROUPS_PER_ROW: u32 = 32_768;

/// Uniforms shared by all draws.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct ProjectFrame {
    steps: [Step; SplatSchedule::MAX_STEPS],
    step_count: u32,
    z_far_m: f32,
    key_rows: u32,
    pad: u32,
}
assert_layout!(ProjectFrame, shaders::project_wgsl_pixel::project_frame, [
    steps: STEPS,
    step_count: STEP_COUNT,
    z_far_m: Z_FAR_M,
    key_rows: KEY_ROWS,
    pad: PAD,
]);

impl ProjectFrame {
    /// Creates the uniforms. `key_rows`: rows of a tile of keys; `pad`: padding around each strip, pixels.
    pub(super) fn new(schedule: &SplatSchedule, key_rows: u32, pad: u32) -> Self {
        let step_count = schedule.steps().len() as u32;
        Self { steps: steps(schedule), step_count, z_far_m: schedule.z_far_m(), key_rows, pad }
    }
}

/// An instance in a row strip.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct ProjectDraw {
    image_x: [f32; 4],
    image_y: [f32; 4],
    image_z: [f32; 4],
    crop_x: [f32; 4],
    crop_y: [f32; 4],
    crop_radius_m: f32,
    first_number: u32,
    band: u32,
    layers: u32,
}
assert_layout!(ProjectDraw, shaders::project_wgsl_pixel::project_draw, [
    image_x: IMAGE_X,
    image_y: IMAGE_Y,
    image_z: IMAGE_Z,
    crop_x: CROP_X,
    crop_y: CROP_Y,
    crop_radius_m: CROP_RADIUS_M,
    first_number: FIRST_NUMBER,
    band: BAND,
    layers: LAYERS,
]);

impl ProjectDraw {
    /// Creates the entry. `band`: index in the table of strips; `layers`: bit mask.
    pub(super) fn new(draw: &Draw, band: u32, layers: u32) -> Self {
        let [image_x, image_y, image_z] = draw.image_from_local;
        let [crop_x, crop_y] = draw.crop_from_local;
        let (crop_radius_m, first_number) = (draw.crop_radius_m, draw.first_number);
        Self { image_x, image_y, image_z, crop_x, crop_y, crop_radius_m, first_number, band, layers }
    }
}

/// Location of a strip's keys.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct ProjectBand {
    /// Width, pixels.
    pub(super) columns: f32,
    /// Height, pixels.
    pub(super) rows: f32,
    /// First row in the view.
    pub(super) first_row: f32,
    /// Key row where its padding begins.
    pub(super) key_row: u32,
}
assert_layout!(ProjectBand, shaders::project_wgsl_pixel::project_band, [
    columns: COLUMNS,
    rows: ROWS,
    first_row: FIRST_ROW,
    key_row: KEY_ROW,
]);

/// Range of a chunk's points to draw.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct ProjectItem {
    pub(super) draw: u32,
    /// Row in the page.
    pub(super) row: u32,
    /// First column.
    pub(super) first: u32,
    /// End column.
    pub(super) end: u32,
}
assert_layout!(ProjectItem, shaders::project_wgsl_pixel::project_item, [
    draw: DRAW,
    row: ROW,
    first: FIRST,
    end: END,
]);

/// Returns the items of a range (first and end) of points in a row.
pub(super) fn items_of(
    draw: u32,
    row: u32,
    [first, end]: [u32; 2],
    covering: Coverage,
) -> impl Iterator<Item = ProjectItem> {
    let step = if covering == Coverage::Drawn { SQUARES_AT_ONCE } else { (end - first).max(1) };
    let item = move |first| ProjectItem { draw, row, first, end: end.min(first + step) };
    (first..end).step_by(step as usize).map(item)
}

/// Range of items to draw.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct ProjectPush {
    pub(super) first: u32,
    pub(super) count: u32,
}
assert_layout!(ProjectPush, shaders::project_wgsl_pixel::project_push, [first: FIRST, count: COUNT]);

impl ProjectPush {
    pub(super) fn groups(&self) -> [u32; 3] {
        [self.count.min(GROUPS_PER_ROW), self.count.div_ceil(GROUPS_PER_ROW), 1]
    }
}

/// One pipeline per kind of work, so that none does unnecessary work.
pub(super) struct ProjectStage {
    pixel: [ComputePipeline; 2],
    layered: [ComputePipeline; 2],
    square: ComputePipeline,
}

impl ProjectStage {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        use shaders as s;
        let narrow = device.is_cpu();
        let pipeline = |shader| ComputePipeline::new(device, shader);
        let either = |wide, slim| pipeline(if narrow { slim } else { wide });
        Ok(Self {
            pixel: [
                either(&s::project_wgsl_pixel::SHADER, &s::project_wgsl_pixel_narrow::SHADER)?,
                either(&s::project_wgsl_pixel_crop::SHADER, &s::project_wgsl_pixel_crop_narrow::SHADER)?,
            ],
            layered: [
                either(&s::project_wgsl_layered::SHADER, &s::project_wgsl_layered_narrow::SHADER)?,
                either(&s::project_wgsl_layered_crop::SHADER, &s::project_wgsl_layered_crop_narrow::SHADER)?,
            ],
            square: pipeline(&s::project_wgsl_square::SHADER)?,
        })
    }

    /// Returns the pipeline for chunks with or without crop, in a frame with this number of layers.
    pub(super) fn pipeline(&self, crop: bool, layers: usize, covering: Coverage) -> &ComputePipeline {
        match (covering == Coverage::Drawn, layers > 1) {
            (true, _) => &self.square,
            (false, true) => &self.layered[usize::from(crop)],
            (false, false) => &self.pixel[usize::from(crop)],
        }
    }

    /// Returns the layout shared by all pipelines.
    pub(super) fn layout(&self) -> &PipelineLayout {
        self.square.layout()
    }
}
