//! Resolve of keys into maps (`glsl/resolve_full.wgsl`, `glsl/resolve_reduced.wgsl`).

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::tables::ResolveBand;
use crate::gpu::{ComputePipeline, Device, GpuError, PipelineLayout, Shader, assert_layout, shaders};
use crate::raster::{MapKind, MapSet, SplatSchedule};

/// Maximum radius that the resolve shaders gather.
pub(super) const MAX_GATHERED_RADIUS: u32 = 2;
/// Columns per invocation of the full-size shader.
const COLUMNS_EACH: u32 = 4;
const GROUP: u32 = 64;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct ResolvePush {
    reach_1: u32,
    reach_2: u32,
    rows: u32,
    wants: u32,
    key_rows: u32,
}
assert_layout!(ResolvePush, shaders::resolve_full_wgsl_both::resolve_push, [
    reach_1: REACH_1,
    reach_2: REACH_2,
    rows: ROWS,
    wants: WANTS,
    key_rows: KEY_ROWS,
]);
assert_layout!(ResolvePush, shaders::resolve_reduced_wgsl_both::resolve_push, [
    reach_1: REACH_1,
    reach_2: REACH_2,
    rows: ROWS,
    wants: WANTS,
    key_rows: KEY_ROWS,
]);

impl ResolvePush {
    /// Creates the constants. `rows`: result rows per invocation; `maps`: maps to write; `key_rows`: rows of
    /// a key tile.
    pub(super) fn new(schedule: &SplatSchedule, rows: u32, maps: MapSet, key_rows: u32) -> Self {
        // Squares of larger radii are already drawn or spread: only the own pixel is read.
        let gathered = schedule.max_radius() <= MAX_GATHERED_RADIUS;
        let reach = |radius: u32| if gathered { schedule.reach_m(radius).to_bits() } else { 0 };
        Self { reach_1: reach(1), reach_2: reach(2), rows, wants: maps.bits(), key_rows }
    }
}

/// Pipelines of one shader; pairs are without and with points.
pub(super) struct ResolveStage {
    both: [ComputePipeline; 2],
    color: ComputePipeline,
    geometry: [ComputePipeline; 2],
    reduced: bool,
}

impl ResolveStage {
    pub(super) fn full(device: &Arc<Device>) -> Result<Self, GpuError> {
        use shaders as s;
        let both = [&s::resolve_full_wgsl_both::SHADER, &s::resolve_full_wgsl_both_point::SHADER];
        let geometry = [&s::resolve_full_wgsl_geometry::SHADER, &s::resolve_full_wgsl_geometry_point::SHADER];
        Self::new(device, both, &s::resolve_full_wgsl_color::SHADER, geometry, false)
    }

    pub(super) fn reduced(device: &Arc<Device>) -> Result<Self, GpuError> {
        use shaders as s;
        let both = [&s::resolve_reduced_wgsl_both::SHADER, &s::resolve_reduced_wgsl_both_point::SHADER];
        let geometry =
            [&s::resolve_reduced_wgsl_geometry::SHADER, &s::resolve_reduced_wgsl_geometry_point::SHADER];
        Self::new(device, both, &s::resolve_reduced_wgsl_color::SHADER, geometry, true)
    }

    /// Compiles the pipelines; pairs are without and with points.
    fn new(
        device: &Arc<Device>,
        both: [&'static Shader; 2],
        color: &'static Shader,
        geometry: [&'static Shader; 2],
        reduced: bool,
    ) -> Result<Self, GpuError> {
        let pipeline = |shader| ComputePipeline::new(device, shader);
        let pair = |[a, b]: [&'static Shader; 2]| Ok::<_, GpuError>([pipeline(a)?, pipeline(b)?]);
        Ok(Self { both: pair(both)?, color: pipeline(color)?, geometry: pair(geometry)?, reduced })
    }

    /// Returns the pipeline that writes these maps.
    pub(super) fn pipeline(&self, maps: MapSet) -> &ComputePipeline {
        let point = usize::from(maps.contains(MapKind::Point));
        if maps == MapSet::COLOR {
            &self.color
        } else if maps.contains(MapKind::Color) {
            &self.both[point]
        } else {
            &self.geometry[point]
        }
    }

    /// Returns the layout shared by all pipelines.
    pub(super) fn layout(&self) -> &PipelineLayout {
        self.color.layout()
    }

    /// Returns the number of result rows that an invocation walks down. Each walk reads four extra rows of
    /// keys before its first result, and each walk is one invocation: a CPU prefers long walks, a GPU prefers
    /// many.
    pub(super) fn rows_each(&self, device: &Device) -> u32 {
        match (self.reduced, device.is_cpu()) {
            (true, true) => 32,
            (true, false) => 4,
            (false, true) => 64,
            (false, false) => 16,
        }
    }

    /// Returns the workgroup counts for these strips.
    pub(super) fn groups(&self, bands: &[ResolveBand], rows_each: u32) -> [u32; 3] {
        let width = bands.iter().map(|band| band.width).max().unwrap_or(0);
        let height = bands.iter().map(|band| band.height).max().unwrap_or(0);
        let columns = if self.reduced { GROUP } else { GROUP * COLUMNS_EACH };
        [width.div_ceil(columns), height.div_ceil(rows_each), bands.len() as u32]
    }
}
