use std::sync::Arc;

use super::SceneMap;
use crate::dataset::Class;
use crate::geometry::{Cuboid, Pose, View};

/// One instant of a drive, recorded or simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneState {
    /// Folder name of its maps: six digits, or a time.
    pub name: String,
    /// Absolute microseconds.
    pub t_us: i64,
    /// Ego pose: the centre of the radius crop.
    pub global_from_ego: Pose,
    /// In the log's order.
    pub cameras: Vec<SceneCamera>,
    /// Sorted by track id; actor `i` has number `i + 1` in the instance map.
    pub actors: Vec<ActorState>,
    /// The HD map around; `None` where there is none or none is needed. All steps of a drive share one.
    pub map: Option<Arc<SceneMap>>,
}

/// A camera of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneCamera {
    /// Size, intrinsics, and `camera_from_world` with the world being the global frame.
    pub view: View,
    /// Extrinsics; `None` for cameras that no ego carries.
    pub ego_from_camera: Option<Pose>,
    /// Ego pose at the camera's own time.
    pub global_from_ego: Pose,
}

/// An actor of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorState {
    /// Track id.
    pub track: String,
    /// The data set's category name.
    pub category: String,
    /// Coarse class.
    pub class: Class,
    /// Where it stands, global.
    pub cuboid: Cuboid,
}
