use std::sync::Arc;

use super::SceneMap;
use crate::dataset::{Appearance, Class};
use crate::geometry::{Cuboid, Pose, View};

/// State of a recorded or simulated scene at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneState {
    /// Folder name of the maps: six digits, or a time.
    pub name: String,
    /// Absolute time, microseconds.
    pub t_us: i64,
    /// Ego pose; its origin is the center of the radius crop.
    pub global_from_ego: Pose,
    /// Cameras, in the log's order.
    pub cameras: Vec<SceneCamera>,
    /// Actors, sorted by track id; actor `i` has number `i + 1` in the instance map.
    pub actors: Vec<ActorState>,
    /// HD map of the surroundings; `None` if unavailable or not needed. All steps of a recording share one.
    pub map: Option<Arc<SceneMap>>,
}

/// Camera of a scene state.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneCamera {
    /// Image size, intrinsics and `camera_from_world`; the world is the global frame.
    pub view: View,
    /// Extrinsics; `None` for cameras that are not mounted on the ego.
    pub ego_from_camera: Option<Pose>,
    /// Ego pose at the camera's own timestamp.
    pub global_from_ego: Pose,
}

/// Actor of a scene state.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorState {
    /// Track id.
    pub track: String,
    /// Dotted category as in nuScenes, like `vehicle.car`, to which the reader maps the names of the data
    /// set. It determines class, color of the box, and template.
    pub category: String,
    /// Coarse class.
    pub class: Class,
    /// Bounding box in the global frame.
    pub cuboid: Cuboid,
    /// What the actor looks like; `None` for its own points.
    pub appearance: Option<Appearance>,
}

impl ActorState {
    /// Returns the track whose points in the skeleton show the actor; `None` for those of a template.
    pub fn asset(&self) -> Option<&str> {
        Appearance::asset(self.appearance.as_ref(), &self.track)
    }
}
