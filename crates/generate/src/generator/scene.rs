use std::sync::Arc;

use point_skeleton::conditions::FrameCaptions;
use point_skeleton::dataset::Recording;
use point_skeleton::scene::{GroundTruthImages, SceneMap};

/// Scene whose images are generated.
pub struct GenerationScene<'a> {
    /// Recorded or synthetic log.
    pub log: &'a Recording,
    /// HD map of the log.
    pub map: Option<Arc<SceneMap>>,
    /// Prompt of the log; empty without one.
    pub prompt: String,
    /// Captions by time, in place of the prompt.
    pub captions: Option<FrameCaptions>,
    /// Source of the reference images.
    pub truth: GroundTruthImages<'a>,
    /// Whether the ego follows the log in the whole rollout.
    pub ego_follows_log: bool,
    /// Whether the other actors follow the log in the whole rollout.
    pub actors_follow_log: bool,
}
