use glam::{DAffine3, DQuat, DVec3};

use super::{MAX_COORDINATE_M, is_position};

/// Rigid transform `target_from_source` in `f64`: rotation, then translation in meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Meters, in the target frame.
    pub translation: DVec3,
}

/// Reason why four quaternion numbers and three coordinates are not a pose.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// The quaternion's length is not 1.
    #[error("expected a unit quaternion (w x y z), found length {length}")]
    NotUnit {
        /// Its length.
        length: f64,
    },
    /// A number is NaN or infinite.
    #[error("expected finite numbers in a pose, found {value}")]
    NotFinite {
        /// First such number.
        value: f64,
    },
    /// A coordinate is larger than any on Earth.
    #[error("expected coordinates of at most {MAX_COORDINATE_M} m in a pose, found {translation:?}")]
    TooFar {
        /// The translation, meters.
        translation: [f64; 3],
    },
}

/// Tolerance of a quaternion's length around 1: files round to 6 or more digits.
const UNIT_TOLERANCE: f64 = 1e-3;

impl Pose {
    /// Identity transform.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Creates a pose from a quaternion `w x y z` and a translation in meters, as stored in files. Normalizes
    /// the quaternion.
    ///
    /// # Errors
    /// Fails if a number is not finite, the length of the quaternion differs from 1 by more than 10⁻³, or a
    /// coordinate exceeds [`MAX_COORDINATE_M`].
    pub fn from_wxyz([w, x, y, z]: [f64; 4], translation: [f64; 3]) -> Result<Self, PoseError> {
        if let Some(&value) = [w, x, y, z].iter().chain(&translation).find(|v| !v.is_finite()) {
            return Err(PoseError::NotFinite { value });
        }
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let length = rotation.length();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            return Err(PoseError::NotUnit { length });
        }
        if !is_position(DVec3::from(translation)) {
            return Err(PoseError::TooFar { translation });
        }
        Ok(Self { rotation: rotation.normalize(), translation: DVec3::from(translation) })
    }

    /// Returns the quaternion in file order, `w x y z`.
    pub fn wxyz(&self) -> [f64; 4] {
        let q = self.rotation;
        [q.w, q.x, q.y, q.z]
    }

    /// Creates a pose from a yaw (radians about z, positive to the left) and a translation in meters.
    pub fn from_yaw(yaw_rad: f64, translation: DVec3) -> Self {
        Self { rotation: DQuat::from_rotation_z(yaw_rad), translation }
    }

    /// Returns the heading of the source frame's x axis in the target's xy plane, radians to the left of its
    /// x axis.
    pub fn yaw_rad(&self) -> f64 {
        let forward = self.rotation * DVec3::X;
        forward.y.atan2(forward.x)
    }

    /// Returns the same position and tilt, rotated about the target's z axis to another yaw.
    pub fn with_yaw(&self, yaw_rad: f64) -> Self {
        let turn = DQuat::from_rotation_z(yaw_rad - self.yaw_rad());
        Self { rotation: (turn * self.rotation).normalize(), translation: self.translation }
    }

    /// Returns `source_from_target`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Transforms a point from the source frame to the target frame, meters.
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// Returns the pose as an affine matrix.
    pub fn affine(&self) -> DAffine3 {
        DAffine3::from_rotation_translation(self.rotation, self.translation)
    }

    /// Interpolates between `self` (`s = 0`) and `other` (`s = 1`): linear position, slerp rotation along the
    /// shorter arc.
    pub fn interpolate(&self, other: &Self, s: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, s).normalize(),
            translation: self.translation.lerp(other.translation, s),
        }
    }
}

/// Composes poses: `a_from_b * b_from_c = a_from_c`.
impl std::ops::Mul for Pose {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self {
            rotation: (self.rotation * other.rotation).normalize(),
            translation: self.transform_point(other.translation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_a_pose_at_utm_coordinates() {
        let pose = Pose::from_wxyz([0.8, 0.0, 0.6, 0.0], [664_430.25, 3_997_650.75, 606.5]).unwrap();
        let point = DVec3::new(664_400.0, 3_997_600.0, 600.0);
        let back = pose.transform_point(pose.inverse().transform_point(point));
        assert!((back - point).length() < 1e-8, "{back}");
    }

    #[test]
    fn product_is_composition() {
        let a = Pose::from_yaw(0.3, DVec3::new(1.0, 2.0, 3.0));
        let b = Pose::from_wxyz([0.6, 0.8, 0.0, 0.0], [-4.0, 5.0, 6.0]).unwrap();
        let p = DVec3::new(0.1, 0.2, 0.3);
        assert!(((a * b).transform_point(p) - a.transform_point(b.transform_point(p))).length() < 1e-12);
    }

    #[test]
    fn bad_numbers_are_refused() {
        assert!(matches!(Pose::from_wxyz([1.0, 1.0, 0.0, 0.0], [0.0; 3]), Err(PoseError::NotUnit { .. })));
        assert!(matches!(Pose::from_wxyz([0.0; 4], [0.0; 3]), Err(PoseError::NotUnit { .. })));
        let nan = Pose::from_wxyz([1.0, 0.0, 0.0, 0.0], [0.0, f64::NAN, 0.0]);
        assert!(matches!(nan, Err(PoseError::NotFinite { .. })));
    }

    #[test]
    fn interpolation_takes_the_shorter_arc() {
        let a = Pose::from_yaw(3.0, DVec3::ZERO);
        let b = Pose::from_yaw(-3.0, DVec3::X);
        let half = a.interpolate(&b, 0.5);
        let forward = half.rotation * DVec3::X;
        assert!((forward - DVec3::NEG_X).length() < 1e-9 && (half.translation.x - 0.5).abs() < 1e-12);
    }
}
