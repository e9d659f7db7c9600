use point_skeleton::conditions::FrameCaptions;
use point_skeleton::scene::GroundTruthImages;

/// Scene whose images are generated.
#[derive(Clone)]
pub struct GenerationScene<'a> {
    /// Whether the states have an HD map.
    pub has_map: bool,
    /// Prompt of the log; empty without one.
    pub prompt: String,
    /// Captions by time, in place of the prompt.
    pub captions: Option<FrameCaptions>,
    /// Source of the reference images; `None` if references are given.
    pub truth: Option<GroundTruthImages<'a>>,
    /// Whether the ego follows the log in the whole rollout.
    pub ego_follows_log: bool,
    /// Whether the other actors follow the log in the whole rollout.
    pub actors_follow_log: bool,
}
