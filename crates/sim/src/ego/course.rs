use glam::DVec2;
use point_skeleton::geometry::{Polyline, wrap_angle};

use super::profile::Profile;
use crate::Waypoint;
use crate::time::seconds;

/// Time-parameterized path of the ego from the takeover on; it continues straight beyond its end.
#[derive(Clone, Debug)]
pub(crate) struct Course {
    pub(super) start_us: i64,
    pub(super) path: Polyline,
    /// Global yaws at the points of the path, radians; interpolated in between.
    pub(super) headings_rad: Vec<f64>,
    pub(super) profile: Profile,
}

impl Course {
    /// Returns the planned waypoint at a time, microseconds.
    pub(super) fn at(&self, t_us: i64) -> Waypoint {
        let drive = self.profile.at(seconds(self.start_us, t_us).max(0.0));
        let (place, _) = self.path.at(drive.travelled_m);
        let piece = self.path.piece(drive.travelled_m);
        let (from_m, to_m) = (self.path.stations_m()[piece], self.path.stations_m()[piece + 1]);
        let (from_rad, to_rad) = (self.headings_rad[piece], self.headings_rad[piece + 1]);
        let s = ((drive.travelled_m - from_m) / (to_m - from_m)).clamp(0.0, 1.0);
        let heading_rad = wrap_angle(from_rad + s * wrap_angle(to_rad - from_rad));
        Waypoint { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps: drive.speed_mps }
    }

    /// Returns the yaws (radians) at the points of a path: the bisector of the adjacent segments, or the
    /// segment's yaw at an end.
    pub(super) fn headings_of(path: &Polyline) -> Vec<f64> {
        let pieces: Vec<f64> = path.points().windows(2).map(|w| (w[1] - w[0]).to_angle()).collect();
        let at = |i: usize| {
            let (before, after) = (pieces[i.saturating_sub(1)], pieces[i.min(pieces.len() - 1)]);
            wrap_angle(before + wrap_angle(after - before) / 2.0)
        };
        (0..path.points().len()).map(at).collect()
    }
}

/// Returns a straight path of two points from a position (meters) along a yaw (radians).
pub(super) fn straight(from: DVec2, yaw_rad: f64) -> Option<Polyline> {
    Polyline::new([from, from + DVec2::from_angle(yaw_rad)])
}
