//! Spreading of keys for radii that are too large to gather (`glsl/spread.wgsl`).
//!
//! # How it works
//! A point that is nearest in its pixel covers everything that a farther one with the same center covers, since
//! radii never increase with depth. One key per pixel is therefore enough for any radius: a pixel shows the minimum
//! of the surrounding keys whose squares reach it. Keys are ordered by depth, and the keys with at least a given
//! radius are those up to some depth. The minimum key within each radius of the schedule is therefore sufficient: a
//! window. Windows grow from pass to pass, each from nine of the previous pass. The cost depends only on the number
//! of pixels; that of squares drawn per point grows with the number of points and the area of a square.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::plan::PlannedItem;
use super::project::{MAX_LOOKED_FOR, ProjectBand};
use super::slot::Slot;
use crate::gpu::{
    ComputePipeline, Device, GpuError, PipelineLayout, Recorder, Scope, assert_layout, shaders,
};
use crate::raster::{SplatSchedule, SplatStep};

assert_layout!(ProjectBand, shaders::spread_wgsl_fold::spread_band, [
    columns: COLUMNS,
    rows: ROWS,
    first_row: FIRST_ROW,
    key_row: KEY_ROW,
]);

/// Method by which points cover more than their own pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coverage {
    /// Radii are small: the resolve shaders gather the neighborhood.
    LookedFor,
    /// Points are few: each draws its square.
    Drawn,
    /// Each point writes its own pixel, then keys are spread.
    Spread,
}

/// Cost of a pixel in a pass, relative to an atomic minimum.
const PASS_COST: u64 = 2;

impl Coverage {
    /// Returns the cheapest method for these points and this number of key pixels.
    pub(super) fn choose(schedule: &SplatSchedule, items: &[PlannedItem], key_pixels: u64) -> Self {
        if schedule.max_radius() <= MAX_LOOKED_FOR {
            return Self::LookedFor;
        }
        let square = |item: &PlannedItem| {
            let [first, end] = item.points;
            let radius = schedule.steps().iter().find(|step| item.nearest_m <= step.z_max_m);
            let side = radius.map_or(0, |step| 2 * u64::from(step.radius) + 1);
            u64::from(end - first) * side * side
        };
        let drawn: u64 = items.iter().map(square).sum();
        let spread = key_pixels * passes(schedule).len() as u64 * PASS_COST;
        if drawn <= spread { Self::Drawn } else { Self::Spread }
    }
}

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

/// One pass of window growth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pass {
    /// Radius of the previous windows, pixels.
    radius: u32,
    /// Distance between adjacent windows of the nine, pixels.
    step: u32,
    /// Bits of the depth up to which the previous windows are squares; 0 if their radius is not in the schedule.
    bound: u32,
    /// The same for the grown windows.
    next_bound: u32,
}

/// Returns the passes for a schedule whose maximum radius exceeds 1.
fn passes(schedule: &SplatSchedule) -> Vec<Pass> {
    let mut radii: Vec<u32> = schedule.steps().iter().map(|step| step.radius).collect();
    radii.sort_unstable();
    radii.dedup();
    let bound = |radius: u32| {
        let covers = |step: &&SplatStep| step.radius >= radius;
        let farthest = schedule.steps().iter().rfind(covers).filter(|_| radii.contains(&radius));
        farthest.map_or(0, |step| step.z_max_m.to_bits())
    };
    let (mut passes, mut radius) = (Vec::new(), 0);
    for target in &radii {
        while radius < *target {
            // With this limit, three windows in a row leave no gap between them.
            let step = (target - radius).min(2 * radius + 1);
            passes.push(Pass { radius, step, bound: bound(radius), next_bound: bound(radius + step) });
            radius += step;
        }
    }
    passes
}

/// Inputs of the spread passes of a batch.
pub(super) struct Spread<'p> {
    pub(super) schedule: &'p SplatSchedule,
    pub(super) bands: &'p [ProjectBand],
    pub(super) layers: usize,
    /// Padding around each strip, pixels.
    pub(super) pad: u32,
    /// Rows of a tile of keys.
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

    /// Converts keys of points into keys of squares, in place.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        device: &Device,
        slot: &'a Slot,
        spread: &Spread<'_>,
    ) -> Result<(), GpuError> {
        let rows = if device.is_cpu() { 32 } else { 4 };
        let Spread { schedule, layers, pad, key_rows, .. } = *spread;
        let (passes, groups) = (passes(schedule), spread.groups(rows));
        for sets in &slot.spread[..layers] {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn passes_of(schedule: &str) -> Vec<(u32, u32, bool)> {
        let passes = passes(&schedule.parse().unwrap());
        passes.iter().map(|pass| (pass.radius, pass.step, pass.bound > 0)).collect()
    }

    #[test]
    fn windows_grow_by_at_most_three_and_stop_at_each_radius() {
        assert_eq!(passes_of("9:31"), [(0, 1, false), (1, 3, false), (4, 9, false), (13, 18, false)]);
        assert_eq!(passes_of("9:3"), [(0, 1, false), (1, 2, false)]);
        let steps = passes_of("5:12,6:12,9:4,20:0");
        assert_eq!(steps, [(0, 1, true), (1, 3, false), (4, 8, true)]);
        let schedule: SplatSchedule = "5:12,6:12,9:4,20:0".parse().unwrap();
        let bounds: Vec<u32> = passes(&schedule).iter().map(|pass| pass.next_bound).collect();
        assert_eq!(bounds, [0, 9.0_f32.to_bits(), 6.0_f32.to_bits()]);
    }

    #[test]
    fn nine_windows_cover_the_larger_one() {
        for radius in 3..=SplatSchedule::MAX_RADIUS {
            let steps =
                (2..16).map(|i| SplatStep { z_max_m: i as f32, radius: radius.saturating_sub(2 * i) });
            let first = SplatStep { z_max_m: 1.0, radius };
            let schedule = SplatSchedule::new(std::iter::once(first).chain(steps).collect()).unwrap();
            let passes = passes(&schedule);
            for pass in &passes {
                assert!(pass.step <= 2 * pass.radius + 1, "{pass:?} has gaps");
            }
            let ends: Vec<u32> = passes.iter().map(|pass| pass.radius + pass.step).collect();
            assert!(schedule.steps().iter().all(|s| s.radius == 0 || ends.contains(&s.radius)));
            assert_eq!(ends.last(), Some(&radius));
        }
    }

    #[test]
    fn few_points_draw_their_squares_and_many_are_spread() {
        let item = |points, nearest_m| PlannedItem {
            draw: 0,
            cloud: 0,
            chunk: 0,
            points: [0, points],
            crop: false,
            nearest_m,
        };
        let choose = |schedule: &str, items: &[PlannedItem]| {
            Coverage::choose(&schedule.parse().unwrap(), items, 1_000_000)
        };
        let many = vec![item(4096, 1.0); 1000];
        assert_eq!(choose("9:2", &many), Coverage::LookedFor);
        assert_eq!(choose("9:31", &many), Coverage::Spread);
        assert_eq!(choose("9:31", &[item(1000, 1.0)]), Coverage::Drawn);
        // Distant points have small squares.
        assert_eq!(choose("0.5:31,9:0", &many), Coverage::Drawn);
    }
}
