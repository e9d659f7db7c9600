//! LiDAR sweeps against true ones: beams cast through a town (`town`), or recorded sweeps (`recorded`).

mod compare;
mod recorded;
mod town;

use point_skeleton::Renderer;
use point_skeleton::dataset::{EgoTrack, Recording};
use point_skeleton::lidar::LidarSpec;
use point_skeleton::scene::{EgoOffset, SceneState, state_at, state_beside};

pub use self::compare::SweepRow;
use super::error::FidelityError;
use super::{FidelityFrames, FidelitySource};

/// Number of poses in a town.
pub(super) const TOWN_POSES: usize = town::POSES.len();

/// Compares the sweeps of frames. Devices of the spec have a mount.
pub(super) fn measure(
    source: FidelitySource<'_>,
    renderer: &mut Renderer<'_>,
    frames: &FidelityFrames,
    spec: &LidarSpec,
    on_step: &mut dyn FnMut(&str),
) -> Result<Vec<SweepRow>, FidelityError> {
    match source {
        FidelitySource::Town(town) => town::measure(town, renderer, frames, spec, on_step),
        FidelitySource::Log(log) => recorded::measure(log, renderer, frames, spec, on_step),
    }
}

/// Returns the state of a log at a time, and another one from which it moves, at the other end of a sweep.
fn states(
    log: &Recording,
    track: &EgoTrack,
    t_us: i64,
    offset: EgoOffset,
    sweep_s: f64,
) -> Option<(SceneState, Option<SceneState>)> {
    let state = state_at(log, track, t_us, offset)?;
    Some((state, state_beside(log, track, t_us, sweep_s, offset)))
}
