//! Spreading of keys for radii that are too large to gather (`glsl/spread.wgsl`).
//!
//! # How it works
//! A point that is nearest in its pixel covers everything that a farther one with the same center covers,
//! since radii never increase with depth. One key per pixel is therefore enough for any radius: a pixel shows
//! the minimum of the surrounding keys whose squares reach it. Keys are ordered by depth, and the keys with
//! at least a given radius are those up to some depth. The minimum key within each radius of the schedule is
//! therefore sufficient: a window. Windows grow from pass to pass, each from nine of the previous pass. The
//! cost depends only on the pixel count; squares drawn per point cost more with every point and with their
//! area.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::passes::{Pass, passes};
use super::tables::ProjectBand;
use crate::gpu::{
    ComputePipeline, DescriptorSet, Device, GpuError, PipelineLayout, Recorder, Scope, assert_layout, shaders,
};
use crate::raster::SplatSchedule;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct SpreadPush {
    step: u32,
    pad: u32,
    key_rows: u32,
    rows: u32,
    bound: u32,
    last_bound: u32,
    keep: u32,
}
assert_layout!(SpreadPush, shaders::spread_wgsl_fold::spread_push, [
    step: STEP,
    pad: PAD,
    key_rows: KEY_ROWS,
    rows: ROWS,
    bound: BOUND,
    last_bound: LAST_BOUND,
    keep: KEEP,
]);

/// Inputs of the spread passes of a batch.
pub(super) struct Spread<'p> {
    pub(super) schedule: &'p SplatSchedule,
    pub(super) bands: &'p [ProjectBand],
    /// Padding around each strip, pixels.
    pub(super) pad: u32,
    /// Rows of a key tile.
    pub(super) key_rows: u32,
}

impl Spread<'_> {
    /// Returns the workgroup counts for `rows` rows per invocation.
    fn groups(&self, rows: u32) -> [u32; 3] {
        let most = |side: fn(&ProjectBand) -> f32| {
            let sides = self.bands.iter().map(|band| side(band) as u32 + 2 * self.pad);
            sides.max().unwrap_or(0)
        };
        let (width, height) = (most(|band| band.columns), most(|band| band.rows));
        [width.div_ceil(GROUP), height.div_ceil(rows), self.bands.len() as u32]
    }
}

/// Pipelines of the spread passes.
pub(super) struct SpreadStage {
    widen: ComputePipeline,
    fold: ComputePipeline,
    last: ComputePipeline,
}

/// Descriptor sets per layer: from its keys to the first window buffer, from that to the second, and back.
pub(super) const SETS: usize = 3;
/// Columns of a workgroup.
const GROUP: u32 = 64;

impl SpreadStage {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let pipeline = |shader| ComputePipeline::new(device, shader);
        Ok(Self {
            widen: pipeline(&shaders::spread_wgsl_widen::SHADER)?,
            fold: pipeline(&shaders::spread_wgsl_fold::SHADER)?,
            last: pipeline(&shaders::spread_wgsl_last::SHADER)?,
        })
    }

    /// Returns the layout shared by all pipelines.
    pub(super) fn layout(&self) -> &PipelineLayout {
        self.last.layout()
    }

    /// Converts keys of points into keys of squares, in place, in the layers of these sets.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        device: &Device,
        layers: &'a [[DescriptorSet; SETS]],
        spread: &Spread<'_>,
    ) -> Result<(), GpuError> {
        let rows = if device.is_cpu() { 32 } else { 4 };
        let Spread { schedule, pad, key_rows, .. } = *spread;
        let (passes, groups) = (passes(schedule), spread.groups(rows));
        for sets in layers {
            // Points of radius 0 are squares already.
            let mut keep = schedule.steps().iter().any(|step| step.radius == 0);
            for (number, pass) in passes.iter().enumerate() {
                let (is_first, is_last) = (number == 0, number + 1 == passes.len());
                let fold = !is_first && (pass.bound > 0 || is_last);
                let pipeline = if is_last {
                    &self.last
                } else if fold {
                    &self.fold
                } else {
                    &self.widen
                };
                let Pass { step, bound, next_bound: last_bound, .. } = *pass;
                let push = SpreadPush { step, pad, key_rows, rows, bound, last_bound, keep: keep.into() };
                let set = if is_first { &sets[0] } else { &sets[1 + (number + 1) % 2] };
                recorder.dispatch_groups(pipeline, &[set], bytemuck::bytes_of(&push), groups)?;
                recorder.barrier(Scope::Compute, Scope::Compute);
                keep |= fold;
            }
        }
        recorder.stamp("spread");
        Ok(())
    }
}
