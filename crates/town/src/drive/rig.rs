//! Sensors on the ego, mounted as in nuScenes.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DQuat, DVec3};
use point_skeleton::dataset::RigCamera;
use point_skeleton::geometry::{Camera, CameraError, Pose};

/// Camera of the ring.
pub(super) struct Mount {
    pub(super) channel: &'static str,
    /// Yaw to the left, degrees.
    yaw_deg: f64,
    /// Position, meters, ego frame.
    at: [f64; 3],
    /// Focal length in image widths.
    focal: f64,
    /// Time that it fires before the LiDAR's time stamp, microseconds: when a LiDAR at 20 Hz scans its
    /// direction.
    pub(super) before_us: i64,
}

/// Cameras in the ring order of nuScenes logs.
pub(super) const CAMERAS: [Mount; 6] = [
    mount("CAM_FRONT", 0.0, [1.70, 0.0, 1.51], NARROW, 25_000),
    mount("CAM_FRONT_RIGHT", -55.0, [1.55, -0.49, 1.50], NARROW, 17_000),
    mount("CAM_BACK_RIGHT", -110.0, [1.01, -0.48, 1.56], NARROW, 10_000),
    mount("CAM_BACK", 180.0, [0.03, 0.0, 1.58], WIDE, 0),
    mount("CAM_BACK_LEFT", 110.0, [1.03, 0.48, 1.56], NARROW, 40_000),
    mount("CAM_FRONT_LEFT", 55.0, [1.52, 0.49, 1.50], NARROW, 33_000),
];

/// Focal lengths of nuScenes: about 1262 and 809 pixels at a width of 1600.
const NARROW: f64 = 1262.0 / 1600.0;
const WIDE: f64 = 809.0 / 1600.0;

const fn mount(channel: &'static str, yaw_deg: f64, at: [f64; 3], focal: f64, before_us: i64) -> Mount {
    Mount { channel, yaw_deg, at, focal, before_us }
}

/// Returns the pose of the LiDAR on the roof: x to the right, y forward.
pub(super) fn ego_from_lidar() -> Pose {
    Pose::from_yaw(-FRAC_PI_2, DVec3::new(0.94, 0.0, 1.84))
}

/// Creates all cameras, with images of a height and a width.
///
/// # Errors
/// Returns an error if no camera can have the size.
pub(super) fn cameras([height, width]: [u32; 2]) -> Result<Vec<RigCamera>, CameraError> {
    let (w, h) = (f64::from(width), f64::from(height));
    let camera = |(channel, mount): (usize, &Mount)| {
        let focal = mount.focal * w;
        let rows = [[focal, 0.0, w / 2.0], [0.0, focal, h / 2.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new(mount.channel, width, height, rows)?;
        Ok(RigCamera { channel, ego_from_camera: mount.ego_from_camera(), camera })
    };
    CAMERAS.iter().enumerate().map(camera).collect()
}

impl Mount {
    fn ego_from_camera(&self) -> Pose {
        // Axes of a camera that looks forward: x right, y down, z forward.
        let level = DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X));
        let rotation = DQuat::from_rotation_z(self.yaw_deg.to_radians()) * level;
        Pose { rotation, translation: DVec3::from(self.at) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_directions_match_their_mounts() {
        let rig = cameras([900, 1600]).unwrap();
        let forward = |i: usize| rig[i].ego_from_camera.rotation * DVec3::Z;
        assert!(forward(0).distance(DVec3::X) < 1e-12 && forward(3).distance(DVec3::NEG_X) < 1e-12);
        assert!(forward(1).y < 0.0 && forward(2).y < 0.0 && forward(4).y > 0.0 && forward(5).y > 0.0);
        assert!(rig.iter().all(|c| (c.ego_from_camera.rotation * DVec3::Y).distance(DVec3::NEG_Z) < 1e-12));
        let field_deg = |i: usize| 2.0 * (800.0 / rig[i].camera.intrinsics.x_axis.x).atan().to_degrees();
        assert!((field_deg(0) - 64.7).abs() < 0.1 && (field_deg(3) - 89.4).abs() < 0.1);
        assert!(cameras([0, 10]).is_err());
    }

    /// The field of view does not depend on the image size.
    #[test]
    fn intrinsics_scale_with_image_size() {
        let (large, small) = (cameras([900, 1600]).unwrap(), cameras([225, 400]).unwrap());
        assert!(large.iter().zip(&small).all(|(a, b)| a.camera.resized(225, 400) == b.camera));
    }
}
