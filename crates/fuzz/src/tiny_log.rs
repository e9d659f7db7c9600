//! Items of the suite's `tiny_log` module that the shared synthetic logs use.

use glam::DQuat;

/// Returns the rotation of a camera on the ego that looks along `yaw`.
pub(crate) fn camera_rotation(yaw: f64) -> DQuat {
    DQuat::from_rotation_z(yaw) * crate::made::forward().rotation
}
