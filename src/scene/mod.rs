//! Scene state of one step (ego, cameras, actors) and the clouds that represent it: the input of the
//! rasterizer and the layout.

mod from_log;
mod ground_truth;
mod map;
mod selection;
mod sequence;
mod state;
mod substitutes;

pub use from_log::{
    EgoOffset, frame_rate_hz, name_of_frame, name_of_time, state_at, state_beside, state_of, state_of_frame,
    state_of_images, with_cameras,
};
pub use ground_truth::{GroundTruthError, GroundTruthImages};
pub use map::{MapEdge, MapLayer, SceneMap};
pub use selection::{SceneClouds, SceneInstances, SelectionOptions, TemplateFit};
pub use sequence::{LogTimes, RATES_HZ, SceneSequence, SequenceError};
pub use state::{ActorState, SceneCamera, SceneState};
pub use substitutes::{AugmentReport, SubstituteOptions, SubstituteReport, Substitutes, TemplateOrigin};
