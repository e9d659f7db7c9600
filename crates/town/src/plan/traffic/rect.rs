use glam::DVec2;
use point_skeleton::geometry::{Polyline, Pose};

/// Oriented rectangle on the ground: an upright box seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rect {
    pub(super) centre: DVec2,
    /// Unit forward direction.
    pub(super) ahead: DVec2,
    /// Half its length and half its width, meters.
    pub(super) half_m: DVec2,
}

impl Rect {
    /// Rectangle with its middle on a path at `along_m` meters, oriented as if axles `base_m` apart were on the path,
    /// too.
    pub(super) fn on(path: &Polyline, along_m: f64, base_m: f64, size_m: DVec2) -> Self {
        let [rear, front] = [-0.5, 0.5].map(|share| path.at(along_m + share * base_m).0);
        let ahead = (front - rear).normalize_or(path.at(along_m).1);
        Self { centre: path.at(along_m).0, ahead, half_m: size_m / 2.0 }
    }

    /// Rectangle of a pose on the ground below its middle.
    pub(super) fn at(pose: &Pose, size_m: DVec2) -> Self {
        let ahead = (pose.rotation * glam::DVec3::X).truncate().normalize_or(DVec2::X);
        Self { centre: pose.translation.truncate(), ahead, half_m: size_m / 2.0 }
    }

    /// Returns the rectangle enlarged by `by_m` meters on all sides.
    pub(super) fn grown(self, by_m: f64) -> Self {
        Self { half_m: self.half_m + by_m, ..self }
    }

    /// Returns whether two rectangles overlap (separating axis test).
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        let apart = other.centre - self.centre;
        if apart.length_squared() > (self.half_m.length() + other.half_m.length()).powi(2) {
            return false;
        }
        let reach = |rect: &Self, axis: DVec2| {
            rect.half_m.x * rect.ahead.dot(axis).abs() + rect.half_m.y * rect.ahead.perp().dot(axis).abs()
        };
        let axes = [self.ahead, self.ahead.perp(), other.ahead, other.ahead.perp()];
        axes.into_iter().all(|axis| apart.dot(axis).abs() <= reach(self, axis) + reach(other, axis))
    }
}
