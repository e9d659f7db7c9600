use std::sync::Arc;

use point_skeleton::dataset::Recording;
use point_skeleton::scene::{SceneMap, SceneState, state_of};

use super::{Instant, Rates, SimActor};

/// Input of a rollout.
#[derive(Clone, Debug)]
pub struct Scenario<'a> {
    /// Recorded or synthetic log.
    pub log: &'a Recording,
    /// HD map of the log; off-road metrics require it.
    pub map: Option<Arc<SceneMap>>,
    /// Default rates ([`Rates::of`]), which the options can override.
    pub rates: Rates,
}

/// Returns the scene state for an instant of a rollout, as the input of condition rendering. All cameras
/// share its time and the ego's pose. The name is the step in six digits.
pub fn scene_state(log: &Recording, instant: &Instant, map: Option<Arc<SceneMap>>) -> SceneState {
    let boxes: Vec<_> = instant.actors.iter().map(SimActor::track_box).collect();
    let state = state_of(log, instant.t_us, instant.ego.pose, &boxes);
    SceneState { name: format!("{:06}", instant.step), map, ..state }
}
