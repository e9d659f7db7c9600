use glam::{DAffine3, DQuat, DVec3};

/// A rigid transform `target_from_source` in `f64`: rotation, then translation in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Metres, in the target frame.
    pub translation: DVec3,
}

/// Why four quaternion numbers and three coordinates are no pose.
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
        /// The first such number.
        value: f64,
    },
}

/// How far a quaternion's length may be from 1: files round to 6 or more digits.
const UNIT_TOLERANCE: f64 = 1e-3;

impl Pose {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// From a file's quaternion `w x y z` and translation in metres; the quaternion is normalized exactly.
    ///
    /// # Errors
    /// A number that is not finite, a quaternion whose length is not 1 within 10⁻³.
    pub fn from_wxyz([w, x, y, z]: [f64; 4], translation: [f64; 3]) -> Result<Self, PoseError> {
        if let Some(&value) = [w, x, y, z].iter().chain(&translation).find(|v| !v.is_finite()) {
            return Err(PoseError::NotFinite { value });
        }
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let length = rotation.length();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            return Err(PoseError::NotUnit { length });
        }
        Ok(Self { rotation: rotation.normalize(), translation: DVec3::from(translation) })
    }

    /// The quaternion as files write it, `w x y z`.
    pub fn wxyz(&self) -> [f64; 4] {
        let q = self.rotation;
        [q.w, q.x, q.y, q.z]
    }

    /// From a yaw to the left (radians, about z) and a translation in metres.
    pub fn from_yaw(yaw_rad: f64, translation: DVec3) -> Self {
        Self { rotation: DQuat::from_rotation_z(yaw_rad), translation }
    }

    /// Where the source frame's x axis points in the target's x and y, radians to the left of its x axis.
    pub fn yaw_rad(&self) -> f64 {
        let forward = self.rotation * DVec3::X;
        forward.y.atan2(forward.x)
    }

    /// The same place and tilt, turned about the target's z axis to another yaw.
    pub fn with_yaw(&self, yaw_rad: f64) -> Self {
        let turn = DQuat::from_rotation_z(yaw_rad - self.yaw_rad());
        Self { rotation: (turn * self.rotation).normalize(), translation: self.translation }
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Moves a point of the source frame into the target frame, metres.
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// The same as an affine matrix.
    pub fn affine(&self) -> DAffine3 {
        DAffine3::from_rotation_translation(self.rotation, self.translation)
    }

    /// Between `self` (`s = 0`) and `other` (`s = 1`): position linear, rotation by slerp the shorter way.
    pub fn interpolate(&self, other: &Self, s: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, s).normalize(),
            translation: self.translation.lerp(other.translation, s),
        }
    }
}

/// `a_from_b * b_from_c = a_from_c`.
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
    fn interpolation_goes_the_shorter_way() {
        let a = Pose::from_yaw(3.0, DVec3::ZERO);
        let b = Pose::from_yaw(-3.0, DVec3::X);
        let half = a.interpolate(&b, 0.5);
        let forward = half.rotation * DVec3::X;
        assert!((forward - DVec3::NEG_X).length() < 1e-9 && (half.translation.x - 0.5).abs() < 1e-12);
    }
}
