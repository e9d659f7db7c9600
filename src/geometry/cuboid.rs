use glam::DVec3;

use super::{MAX_COORDINATE_M, MAX_SIDE_M, MIN_SIDE_M, Pose, is_position, is_size};

/// Oriented 3D box: x along its length (forward), y along its width (left), z along its height (up).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cuboid {
    /// `global_from_box`; the origin is the center of the box.
    pub pose: Pose,
    /// Length, width, height in meters, all positive.
    pub size: DVec3,
}

/// Reason why a box is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CuboidError {
    /// A side is zero, negative or not finite.
    #[error("expected a box of positive length, width and height, found {0} x {1} x {2} m")]
    Size(f64, f64, f64),
    /// A side is shorter or longer than any object's.
    #[error("expected a box with sides of {MIN_SIDE_M} to {MAX_SIDE_M} m, found {0:?} x {1:?} x {2:?} m")]
    Extent(f64, f64, f64),
    /// The center is not on Earth.
    #[error("expected a box within {MAX_COORDINATE_M} m of the origin, found one at {0:?}")]
    Position([f64; 3]),
}

impl Cuboid {
    /// Creates a box after validating its size (length, width, height in meters) and its center.
    ///
    /// # Errors
    /// Fails if a side is zero, negative, not finite, or outside [`MIN_SIDE_M`] to [`MAX_SIDE_M`], or if a
    /// coordinate of the center exceeds [`MAX_COORDINATE_M`].
    pub fn new(pose: Pose, size: DVec3) -> Result<Self, CuboidError> {
        if !(size.is_finite() && size.min_element() > 0.0) {
            return Err(CuboidError::Size(size.x, size.y, size.z));
        }
        if !is_size(size) {
            return Err(CuboidError::Extent(size.x, size.y, size.z));
        }
        if !is_position(pose.translation) {
            return Err(CuboidError::Position(pose.translation.to_array()));
        }
        Ok(Self { pose, size })
    }

    /// Creates a box, or `None` if a side is zero, negative or below [`MIN_SIDE_M`]: data sets have such
    /// boxes of objects without a size.
    ///
    /// # Errors
    /// Fails if a side is not finite or above [`MAX_SIDE_M`], or if a coordinate exceeds
    /// [`MAX_COORDINATE_M`].
    pub fn unless_flat(pose: Pose, size: DVec3) -> Result<Option<Self>, CuboidError> {
        let is_flat = size.is_finite() && size.min_element() < MIN_SIDE_M;
        if is_flat { Ok(None) } else { Self::new(pose, size).map(Some) }
    }

    /// Returns the eight corners in the global frame, meters. Bit 0 of the index is front, bit 1 left, bit 2
    /// up.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let side = |bit: usize| if i >> bit & 1 == 1 { 0.5 } else { -0.5 };
            self.pose.transform_point(self.size * DVec3::new(side(0), side(1), side(2)))
        })
    }

    /// Returns whether a point in box coordinates (meters) lies inside the box grown by `margin_m` on every
    /// side.
    pub fn contains_local(&self, local: DVec3, margin_m: f64) -> bool {
        let half = self.size / 2.0 + margin_m;
        local.abs().cmple(half).all()
    }

    /// Returns the box with another size (length, width, height in meters) on the same ground: its lower face
    /// stays where it is.
    #[must_use]
    pub fn resized(&self, size: DVec3) -> Self {
        let up = self.pose.rotation * (DVec3::Z * ((size.z - self.size.z) / 2.0));
        Self { pose: Pose { translation: self.pose.translation + up, ..self.pose }, size }
    }

    /// Interpolates between two boxes: linear position and size, slerp rotation.
    pub fn interpolate(&self, other: &Self, s: f64) -> Self {
        // A weighted mean of equal sizes could differ in the last bit.
        let size = if self.size == other.size { self.size } else { self.size.lerp(other.size, s) };
        Self { pose: self.pose.interpolate(&other.pose, s), size }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_interpolated_linearly_and_equal_sizes_are_kept() {
        let of = |height_m: f64| Cuboid { pose: Pose::IDENTITY, size: DVec3::new(4.0, 2.0, height_m) };
        for step in 0..=100 {
            let s = f64::from(step) / 100.0;
            assert_eq!(of(1.777).interpolate(&of(1.777), s).size, of(1.777).size);
            assert!((of(1.0).interpolate(&of(3.0), s).size.z - (1.0 + 2.0 * s)).abs() < 1e-15);
        }
    }

    #[test]
    fn sizes_must_be_positive() {
        for size in [DVec3::new(0.0, 1.0, 1.0), DVec3::new(1.0, -2.0, 1.0), DVec3::new(1.0, 1.0, f64::NAN)] {
            assert!(Cuboid::new(Pose::IDENTITY, size).is_err(), "{size}");
        }
    }

    #[test]
    fn sizes_and_positions_have_limits() {
        let error =
            |at: DVec3, size: DVec3| Cuboid::new(Pose::from_yaw(0.0, at), size).unwrap_err().to_string();
        let found = error(DVec3::ZERO, DVec3::new(4.0, 1e308, 1.5));
        assert!(
            found.starts_with("expected a box with sides of 0.0001 to 100000 m, found 4.0 x 1e308 x 1.5 m"),
            "{found}"
        );
        assert!(error(DVec3::ZERO, DVec3::splat(1e-300)).contains("sides of 0.0001"));
        let found = error(DVec3::new(0.0, -3e38, 0.0), DVec3::ONE);
        assert!(found.starts_with("expected a box within 100000000 m of the origin, found"), "{found}");
    }

    #[test]
    fn corners_are_on_the_surface() {
        let pose = Pose::from_yaw(0.7, DVec3::new(100.0, 200.0, 3.0));
        let cuboid = Cuboid::new(pose, DVec3::new(4.0, 2.0, 1.5)).unwrap();
        for corner in cuboid.corners() {
            let local = pose.inverse().transform_point(corner);
            assert!((local.abs() - cuboid.size / 2.0).length() < 1e-9);
            assert!(cuboid.contains_local(local, 1e-6) && !cuboid.contains_local(local, -1e-6));
        }
        let front_left_up = pose.inverse().transform_point(cuboid.corners()[7]);
        assert!((front_left_up - cuboid.size / 2.0).length() < 1e-9);
    }
}
