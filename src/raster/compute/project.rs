//! Projection of points into visibility buffers (`glsl/project.wgsl`).

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::coverage::Coverage;
use super::tables::ProjectItem;
use crate::gpu::{ComputePipeline, Device, GpuError, PipelineLayout, assert_layout, shaders};
use crate::raster::SplatSchedule;
use crate::raster::steps::{Step, steps};

/// Descriptor set of a point page.
pub(super) const PAGE_SET: u32 = 1;
/// Points per workgroup that draws squares: CPU drivers terminate invocations that loop more than 65 535
/// times, and each square may have up to 63 by 63 pixels.
const SQUARES_PER_GROUP: u32 = 512;
/// Workgroups in a row of a dispatch.
const GROUPS_PER_ROW: u32 = shaders::project_wgsl_pixel::GROUPS_PER_ROW;

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
    /// Creates the uniforms. `key_rows`: rows of a key tile; `pad`: padding around each strip, pixels.
    pub(super) fn new(schedule: &SplatSchedule, key_rows: u32, pad: u32) -> Self {
        let step_count = schedule.steps().len() as u32;
        Self { steps: steps(schedule), step_count, z_far_m: schedule.z_far_m(), key_rows, pad }
    }
}

/// Returns the items of a range (first and end) of points in a row.
pub(super) fn items_of(
    draw: u32,
    row: u32,
    [first, end]: [u32; 2],
    covering: Coverage,
) -> impl Iterator<Item = ProjectItem> {
    let step = if covering == Coverage::Drawn { SQUARES_PER_GROUP } else { (end - first).max(1) };
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
