use std::sync::Arc;

use point_skeleton::Log;
use point_skeleton::conditions::MapSet;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::scene::SceneMap;
use point_skeleton::skeleton::Skeleton;

/// Inputs that are read before the simulation starts.
pub(crate) struct Inputs {
    pub(crate) log: Log,
    pub(crate) skeleton: Skeleton,
    pub(crate) prompt: PromptParts,
    pub(crate) map: Option<Arc<SceneMap>>,
    /// Kinds of maps to render.
    pub(crate) maps: MapSet,
}
