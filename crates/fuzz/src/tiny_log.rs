//! What the made-up logs of the library's suite take from its module of this name.

use glam::DQuat;

/// Of a camera on the ego that looks along `yaw`.
pub(crate) fn camera_rotation(yaw: f64) -> DQuat {
    DQuat::from_rotation_z(yaw) * crate::made::forward().rotation
}
