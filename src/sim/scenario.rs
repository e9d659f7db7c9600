use std::sync::Arc;

use super::{Instant, Rates, SimActor};
use crate::dataset::{Log, LogFormat};
use crate::scene::{SceneMap, SceneState, state_of};

/// What a rollout is made on.
#[derive(Clone, Debug)]
pub struct Scenario<'a> {
    /// The drive.
    pub log: &'a Log,
    /// Its HD map; without one nobody is off the road.
    pub map: Option<Arc<SceneMap>>,
    /// What its format is simulated at, unless the options say otherwise.
    pub rates: Rates,
}

impl<'a> Scenario<'a> {
    /// Of a log of a format.
    pub fn new(log: &'a Log, map: Option<Arc<SceneMap>>, format: LogFormat) -> Self {
        let rates = match format {
            LogFormat::NuScenes => Rates::NUSCENES,
            LogFormat::Argoverse | LogFormat::NuPlan | LogFormat::NuPlanSimgen | LogFormat::Town => {
                Rates::default()
            }
        };
        Self { log, map, rates }
    }
}

/// What conditions are made of, for an instant of a rollout on a log: all cameras share its time and the ego's pose.
/// Its name is the step in six digits.
pub fn scene_state(log: &Log, instant: &Instant, map: Option<Arc<SceneMap>>) -> SceneState {
    let boxes: Vec<_> = instant.actors.iter().map(SimActor::track_box).collect();
    let state = state_of(log, instant.t_us, instant.ego.pose, &boxes);
    SceneState { name: format!("{:06}", instant.step), map, ..state }
}
