use glam::{DVec2, DVec3};

use super::change::Place;
use super::ground::Ground;
use crate::geometry::{Cuboid, Pose};

/// Origin and heading (radians) of a frame in x and y, global meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axes {
    pub(super) origin: DVec2,
    pub(super) yaw_rad: f64,
}

impl Axes {
    /// The global frame.
    pub(super) const GLOBAL: Self = Self { origin: DVec2::ZERO, yaw_rad: 0.0 };

    /// Returns the axes of a pose without its tilt.
    pub(super) fn of(pose: &Pose) -> Self {
        Self { origin: pose.translation.truncate(), yaw_rad: pose.yaw_rad() }
    }

    /// Transforms a point to the global frame, meters.
    pub(super) fn point(&self, x_m: f64, y_m: f64) -> DVec2 {
        self.origin + DVec2::from_angle(self.yaw_rad).rotate(DVec2::new(x_m, y_m))
    }

    /// Returns the center (global x and y, meters) and heading (radians) of a place.
    pub(super) fn place(&self, place: &Place) -> (DVec2, f64) {
        (self.point(place.x_m, place.y_m), self.yaw_rad + place.yaw_deg.to_radians())
    }
}

/// Returns a box of a size (meters) that stands on the ground.
pub(super) fn standing(center: DVec2, yaw_rad: f64, size: DVec3, ground: &Ground) -> Cuboid {
    let height_m = ground.height_m(center) + size.z / 2.0;
    Cuboid { pose: Pose::from_yaw(yaw_rad, center.extend(height_m)), size }
}
