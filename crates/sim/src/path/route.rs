use glam::DVec2;
use point_skeleton::dataset::EgoTrack;
use point_skeleton::geometry::{LineProjection, Polyline, Pose};

use super::pose_path::PosePath;
use crate::time::seconds;

/// Minimum distance between poses of a route, meters: smaller motion is the noise of a standing vehicle.
const KNOT_STEP_M: f64 = 0.1;
/// Search window along the route before and after the ego's last station, meters. The distance driven since
/// is added to it.
const WINDOW_M: f64 = 25.0;
/// Distance ahead and offset of turns in driving commands, meters. Source: OpenScene.
const COMMAND_AHEAD_M: f64 = 20.0;
const COMMAND_BESIDE_M: f64 = 2.0;

/// Recorded route of the ego in a log, with ground poses.
pub(crate) struct Route {
    first: Pose,
    /// Times at which the ego reached the points of the route, absolute microseconds.
    times_us: Vec<i64>,
    /// `None` if the ego never moved.
    path: Option<PosePath>,
}

/// Part of a route around the ego's last position. Projections are restricted to it: a route can cross itself
/// or return beside itself, so the nearest point of the whole route may belong to a much later time.
#[derive(Clone, Copy)]
pub(crate) struct RouteWindow<'a> {
    route: &'a Route,
    station_m: f64,
    place_m: DVec2,
}

impl Route {
    /// Builds the route from the ego's recorded poses.
    pub(crate) fn new(track: &EgoTrack) -> Self {
        let (mut times_us, mut retained): (Vec<i64>, Vec<Pose>) = Default::default();
        let place = |pose: &Pose| pose.translation.truncate();
        for (t_us, pose) in track.poses().iter().filter(|(_, pose)| pose.translation.is_finite()) {
            if retained.last().is_none_or(|last| place(last).distance(place(pose)) >= KNOT_STEP_M) {
                times_us.push(*t_us);
                retained.push(*pose);
            }
        }
        let first = retained.first().copied().unwrap_or(Pose::IDENTITY);
        let path = PosePath::new(retained);
        Self { first, times_us, path }
    }

    /// Returns the station (meters) of the ego at a time, microseconds.
    pub(crate) fn station_at(&self, t_us: i64) -> f64 {
        let Some(path) = &self.path else { return 0.0 };
        let stations = path.line().stations_m();
        let next = self.times_us.partition_point(|at| *at <= t_us);
        let (Some(before), true) = (next.checked_sub(1), next < stations.len()) else {
            return if next == 0 { 0.0 } else { path.line().length_m() };
        };
        let s = seconds(self.times_us[before], t_us) / seconds(self.times_us[before], self.times_us[next]);
        stations[before] + s * (stations[next] - stations[before])
    }

    /// Returns the route in x and y; `None` if the ego never moved.
    pub(crate) fn line(&self) -> Option<&Polyline> {
        self.path.as_ref().map(PosePath::line)
    }

    /// Returns the recorded yaw (radians) at a station, meters.
    pub(crate) fn yaw_at(&self, station_m: f64) -> f64 {
        self.ground(station_m).yaw_rad()
    }

    /// Returns the driving command at a projection of the ego: `left` or `right` if the route, 20 m ahead or
    /// at its end, is at least 2 m beside its direction here, else `straight`; `unknown` past its end.
    /// Source: OpenScene, which does so with the center line of the map's route.
    pub(crate) fn command(&self, ego: LineProjection) -> &'static str {
        let Some(line) = self.line().filter(|line| ego.station_m < line.length_m()) else { return "unknown" };
        let from_m = ego.station_m.max(0.0);
        let arm = line.at((from_m + COMMAND_AHEAD_M).min(line.length_m())).0 - line.at(from_m).0;
        match DVec2::from_angle(self.yaw_at(from_m)).perp_dot(arm) {
            left_m if left_m >= COMMAND_BESIDE_M => "left",
            left_m if left_m <= -COMMAND_BESIDE_M => "right",
            _ => "straight",
        }
    }

    /// Returns the part of the route around an ego position, given as station and global position, meters.
    pub(crate) fn around(&self, station_m: f64, place_m: DVec2) -> RouteWindow<'_> {
        RouteWindow { route: self, station_m, place_m }
    }

    fn ground(&self, station_m: f64) -> Pose {
        self.path.as_ref().map_or(self.first, |path| path.at(station_m))
    }
}

impl RouteWindow<'_> {
    /// Projects a position (global, meters) onto the route.
    pub(crate) fn project(&self, place: DVec2) -> LineProjection {
        if let Some(path) = &self.route.path {
            let reach_m = WINDOW_M + self.place_m.distance(place);
            return path.line().project(place, self.station_m - reach_m..self.station_m + reach_m);
        }
        let first = &self.route.first;
        let (forward, arm) = (DVec2::from_angle(first.yaw_rad()), place - first.translation.truncate());
        LineProjection { station_m: forward.dot(arm), offset_m: forward.perp_dot(arm) }
    }

    /// Returns a pose at a position (global, meters) with a yaw (radians). Height and tilt come from the
    /// recorded ego at the nearest position on the route.
    pub(crate) fn pose_at(&self, place: DVec2, yaw_rad: f64) -> Pose {
        let ground = self.route.ground(self.project(place).station_m);
        let mut pose = ground.with_yaw(yaw_rad);
        pose.translation = place.extend(ground.translation.z);
        pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use point_skeleton::dataset::{Frame, Recording};

    fn route(poses: &[Pose]) -> Route {
        let frame = |(i, pose): (usize, &Pose)| Frame {
            t_us: i as i64,
            global_from_ego: *pose,
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        let frames = poses.iter().enumerate().map(frame).collect();
        Route::new(&EgoTrack::new(&Recording { frames, ..Recording::default() }))
    }

    #[test]
    fn driving_commands_look_20_m_ahead() {
        let straight = route(&[0.0, 10.0, 20.0, 30.0].map(|x| Pose::from_yaw(0.0, DVec3::X * x)));
        let command =
            |route: &Route, station_m: f64| route.command(LineProjection { station_m, offset_m: 1.0 });
        assert_eq!(
            [-5.0, 0.0, 29.0, 30.0].map(|s| command(&straight, s)),
            ["straight", "straight", "straight", "unknown"]
        );
        // On a circle of radius r, the point after an arc s is r (1 - cos(s / r)) beside the tangent.
        for (radius, expected) in [(90.0, ["left", "right"]), (110.0, ["straight", "straight"])] {
            for (sign, expected) in [1.0, -1.0].into_iter().zip(expected) {
                let at = |i: i32| {
                    let angle = f64::from(i) * 0.5 / radius;
                    let (sin, cos) = angle.sin_cos();
                    Pose::from_yaw(sign * angle, DVec3::new(radius * sin, sign * radius * (1.0 - cos), 0.0))
                };
                let route = route(&(0..100).map(at).collect::<Vec<_>>());
                assert_eq!(command(&route, 0.0), expected, "{radius} {sign}");
                assert_eq!(command(&route, 7.3), expected, "{radius} {sign}");
            }
        }
        assert_eq!(command(&route(&[]), 0.0), "unknown");
    }

    #[test]
    fn poses_follow_the_route_ground() {
        // A 10 % climb with the nose up.
        let nose_up = DQuat::from_rotation_y(-0.1f64.atan());
        let pose = |x: f64| Pose { rotation: nose_up, translation: DVec3::new(x, 0.0, x / 10.0) };
        let route = route(&[pose(0.0), pose(10.0), pose(20.0)]);
        let stretch = route.around(10.0, DVec2::new(10.0, 3.0));
        let found = stretch.pose_at(DVec2::new(12.0, 3.0), 0.4);
        assert!((found.translation - DVec3::new(12.0, 3.0, 1.2)).length() < 1e-12, "{found:?}");
        assert!((found.yaw_rad() - 0.4).abs() < 1e-12);
        let forward = found.rotation * DVec3::X;
        assert!((forward.z - 0.1f64.atan().sin()).abs() < 1e-12, "the nose stays up: {forward}");
        assert_eq!([-1, 0, 1, 2, 9].map(|t| route.station_at(t)), [0.0, 0.0, 10.0, 20.0, 20.0]);
        let projection = stretch.project(DVec2::new(12.0, 3.0));
        assert!((projection.station_m - 12.0).abs() < 1e-12 && (projection.offset_m - 3.0).abs() < 1e-12);
        assert_eq!(route.yaw_at(12.0), 0.0);
    }

    /// East over a bridge, around to the left, and south below it.
    #[test]
    fn self_crossing_route_is_followed_in_order() {
        let corners =
            [(0.0, 0.0, 8.0), (100.0, 0.0, 8.0), (100.0, 50.0, 4.0), (50.0, 50.0, 0.0), (50.0, -50.0, 0.0)];
        let route = route(&corners.map(|(x, y, z)| Pose::from_yaw(0.0, DVec3::new(x, y, z))));
        // One position on the bridge and below it: 1 m off the lower path and 2 m off the upper one.
        let crossing = DVec2::new(51.0, 2.0);
        for (station_m, before, expected_m, height_m) in
            [(45.0, DVec2::new(45.0, 0.0), 51.0, 8.0), (245.0, DVec2::new(50.0, 5.0), 248.0, 0.0)]
        {
            let stretch = route.around(station_m, before);
            assert!((stretch.project(crossing).station_m - expected_m).abs() < 1e-9, "{station_m}");
            assert!((stretch.pose_at(crossing, 0.0).translation.z - height_m).abs() < 1e-9, "{station_m}");
        }
        // A long step widens the search window by its length.
        let far = route.around(20.0, DVec2::new(20.0, 0.0)).project(DVec2::new(100.0, 40.0));
        assert!((far.station_m - 140.0).abs() < 1e-9 && far.offset_m.abs() < 1e-9);
    }

    #[test]
    fn stationary_ego_has_a_ground_pose() {
        let pose = Pose::from_yaw(std::f64::consts::FRAC_PI_2, DVec3::new(5.0, 6.0, 7.0));
        let route = route(&[pose; 3]);
        assert!(route.line().is_none());
        let stretch = route.around(0.0, DVec2::new(5.0, 6.0));
        assert_eq!(stretch.pose_at(DVec2::new(5.0, 9.0), 0.0).translation, DVec3::new(5.0, 9.0, 7.0));
        let projection = stretch.project(DVec2::new(4.0, 9.0));
        assert!((projection.station_m - 3.0).abs() < 1e-12 && (projection.offset_m - 1.0).abs() < 1e-12);
    }
}
