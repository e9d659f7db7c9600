//! Splat schedule in the layout of the shaders.

use bytemuck::{Pod, Zeroable};

use super::SplatSchedule;
use crate::gpu::{assert_layout, shaders};

/// One entry of the schedule.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct Step {
    z_max_m: f32,
    radius: u32,
    pad_0: u32,
    pad_1: u32,
}
assert_layout!(Step, shaders::splat_vert::step, [z_max_m: Z_MAX_M, radius: RADIUS, pad_0: PAD_0,
pad_1: PAD_1]);
assert_layout!(Step, shaders::project_wgsl_pixel::step, [z_max_m: Z_MAX_M, radius: RADIUS, pad_0: PAD_0,
pad_1: PAD_1]);

/// Returns all entries, padded with zeros.
pub(super) fn steps(schedule: &SplatSchedule) -> [Step; SplatSchedule::MAX_STEPS] {
    let mut steps = [Step::default(); SplatSchedule::MAX_STEPS];
    for (to, from) in steps.iter_mut().zip(schedule.steps()) {
        *to = Step { z_max_m: from.z_max_m, radius: from.radius, ..Step::default() };
    }
    steps
}
