use std::ops::Range;

use glam::DVec2;
use rstar::RTree;
use rstar::primitives::{GeomWithData, Line};

use super::clock::seconds;
use super::pose_path::PosePath;
use crate::dataset::EgoTrack;
use crate::geometry::{Foot, Polyline, Pose};

/// Poses nearer than this to the one before are left out: they would tell the noise of a vehicle that stands.
const KNOT_STEP_M: f64 = 0.1;

/// The way that the ego drove in the log, with the ground under it.
pub(super) struct Route {
    first: Pose,
    /// When the ego came to the points of the way, absolute microseconds.
    times_us: Vec<i64>,
    /// `None` where the ego stood all the time.
    way: Option<Way>,
}

struct Way {
    path: PosePath,
    /// Pieces of the path by place.
    pieces: RTree<GeomWithData<Line<[f64; 2]>, usize>>,
}

impl Route {
    /// Of a drive.
    pub(super) fn new(track: &EgoTrack) -> Self {
        let (mut times_us, mut kept): (Vec<i64>, Vec<Pose>) = Default::default();
        let place = |pose: &Pose| pose.translation.truncate();
        for (t_us, pose) in track.poses().iter().filter(|(_, pose)| pose.translation.is_finite()) {
            if kept.last().is_none_or(|last| place(last).distance(place(pose)) >= KNOT_STEP_M) {
                times_us.push(*t_us);
                kept.push(*pose);
            }
        }
        let first = kept.first().copied().unwrap_or(Pose::IDENTITY);
        let way = PosePath::new(kept).map(|path| {
            let piece = |(i, ends): (usize, &[DVec2])| {
                GeomWithData::new(Line::new(ends[0].to_array(), ends[1].to_array()), i)
            };
            let pieces = RTree::bulk_load(path.line().points().windows(2).enumerate().map(piece).collect());
            Way { path, pieces }
        });
        Self { first, times_us, way }
    }

    /// The station (metres) where the ego was at a time, microseconds.
    pub(super) fn station_at(&self, t_us: i64) -> f64 {
        let Some(way) = &self.way else { return 0.0 };
        let stations = way.path.line().stations_m();
        let next = self.times_us.partition_point(|at| *at <= t_us);
        let (Some(before), true) = (next.checked_sub(1), next < stations.len()) else {
            return if next == 0 { 0.0 } else { way.path.line().length_m() };
        };
        let s = seconds(self.times_us[before], t_us) / seconds(self.times_us[before], self.times_us[next]);
        stations[before] + s * (stations[next] - stations[before])
    }

    /// The way seen from above; `None` where the ego stood all the time.
    pub(super) fn line(&self) -> Option<&Polyline> {
        self.way.as_ref().map(|way| way.path.line())
    }

    /// A pose at a place (global, metres) with a yaw (radians), on the ground of the nearest place of the way and tilted
    /// as the ego was there.
    pub(super) fn pose_at(&self, place: DVec2, yaw_rad: f64) -> Pose {
        let ground = self.ground(place);
        let mut pose = ground.with_yaw(yaw_rad);
        pose.translation = place.extend(ground.translation.z);
        pose
    }

    /// The foot of a place (global, metres) on the way within some stations, and the yaw that the ego had there.
    pub(super) fn foot(&self, place: DVec2, stations_m: Range<f64>) -> (Foot, f64) {
        if let Some(way) = &self.way {
            let foot = way.path.line().foot(place, stations_m);
            return (foot, way.path.at(foot.station_m).yaw_rad());
        }
        let yaw_rad = self.first.yaw_rad();
        let (forward, arm) = (DVec2::from_angle(yaw_rad), place - self.first.translation.truncate());
        (Foot { station_m: forward.dot(arm), offset_m: forward.perp_dot(arm) }, yaw_rad)
    }

    fn ground(&self, place: DVec2) -> Pose {
        let nearest = |way: &Way| {
            let piece = way.pieces.nearest_neighbor(place.to_array())?.data;
            let station_m = way.path.line().stations_m()[piece];
            let foot = way.path.line().foot(place, station_m..station_m);
            Some(way.path.at(foot.station_m))
        };
        self.way.as_ref().and_then(nearest).unwrap_or(self.first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Frame, Log};
    use glam::{DQuat, DVec3};

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
        Route::new(&EgoTrack::new(&Log { frames, ..Log::default() }))
    }

    #[test]
    fn the_ground_is_that_of_the_way() {
        // Uphill at 10 % with the nose up.
        let nose_up = DQuat::from_rotation_y(-0.1f64.atan());
        let pose = |x: f64| Pose { rotation: nose_up, translation: DVec3::new(x, 0.0, x / 10.0) };
        let route = route(&[pose(0.0), pose(10.0), pose(20.0)]);
        let found = route.pose_at(DVec2::new(12.0, 3.0), 0.4);
        assert!((found.translation - DVec3::new(12.0, 3.0, 1.2)).length() < 1e-12, "{found:?}");
        assert!((found.yaw_rad() - 0.4).abs() < 1e-12);
        let forward = found.rotation * DVec3::X;
        assert!((forward.z - 0.1f64.atan().sin()).abs() < 1e-12, "the nose stays up: {forward}");
        assert_eq!([-1, 0, 1, 2, 9].map(|t| route.station_at(t)), [0.0, 0.0, 10.0, 20.0, 20.0]);
        let (foot, yaw_rad) = route.foot(DVec2::new(12.0, 3.0), 0.0..20.0);
        assert!(
            (foot.station_m - 12.0).abs() < 1e-12 && (foot.offset_m - 3.0).abs() < 1e-12 && yaw_rad == 0.0
        );
    }

    #[test]
    fn an_ego_that_stands_has_a_ground_too() {
        let pose = Pose::from_yaw(std::f64::consts::FRAC_PI_2, DVec3::new(5.0, 6.0, 7.0));
        let route = route(&[pose; 3]);
        assert!(route.line().is_none());
        assert_eq!(route.pose_at(DVec2::new(5.0, 9.0), 0.0).translation, DVec3::new(5.0, 9.0, 7.0));
        let (foot, _) = route.foot(DVec2::new(4.0, 9.0), 0.0..0.0);
        assert!((foot.station_m - 3.0).abs() < 1e-12 && (foot.offset_m - 1.0).abs() < 1e-12);
    }
}
