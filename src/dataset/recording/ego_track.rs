use crate::dataset::Recording;
use crate::geometry::Pose;

/// Ego poses over time: the recorded poses of frames and sweeps, in time order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EgoTrack(Vec<(i64, Pose)>);

impl EgoTrack {
    /// Collects the poses of a log.
    pub fn new(log: &Recording) -> Self {
        let frames = log.frames.iter().map(|f| (f.t_us, f.global_from_ego));
        let sweeps = log.frames.iter().flat_map(|f| &f.sweeps).map(|s| (s.t_us, s.global_from_ego));
        // The sort is stable: of two poses at the same time, the frame's comes first.
        Self::of_poses(frames.chain(sweeps).collect())
    }

    /// Collects poses of any order, with absolute microseconds. Of two at the same time, the first one
    /// counts.
    pub(in crate::dataset) fn of_poses(mut poses: Vec<(i64, Pose)>) -> Self {
        poses.sort_by_key(|(t_us, _)| *t_us);
        Self(poses)
    }

    /// Returns all recorded poses, `global_from_ego`, with absolute microseconds, in time order. Times may
    /// repeat.
    pub fn poses(&self) -> &[(i64, Pose)] {
        &self.0
    }

    /// Returns `global_from_ego` at any time (microseconds) within the recording, interpolated between
    /// recorded poses (linear position, slerp rotation). `None` outside.
    pub fn at(&self, t_us: i64) -> Option<Pose> {
        let next = self.0.partition_point(|(at, _)| *at < t_us);
        let (t1, after) = self.0.get(next)?;
        if *t1 == t_us {
            return Some(*after);
        }
        let (t0, before) = self.0.get(next.checked_sub(1)?)?;
        Some(before.interpolate(after, (t_us - t0) as f64 / (t1 - t0) as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Frame, SweepRecord};
    use glam::DVec3;

    #[test]
    fn interpolates_between_poses_of_frames_and_sweeps() {
        let pose = |x: f64| Pose::from_yaw(0.0, DVec3::new(x, 0.0, 0.0));
        let sweep = |t_us: i64, x: f64| SweepRecord {
            path: "s".into(),
            row: None,
            t_us,
            global_from_ego: pose(x),
            ego_from_lidar: Pose::IDENTITY,
            is_key: false,
        };
        let frame = |t_us: i64, x: f64, sweeps: Vec<SweepRecord>| Frame {
            t_us,
            global_from_ego: pose(x),
            sweeps,
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        // The frame's own sweep comes first, then the earlier one.
        let later = frame(100, 10.0, vec![sweep(100, 10.0), sweep(60, 9.0)]);
        let log = Recording { frames: vec![frame(0, 0.0, Vec::new()), later], ..Recording::default() };
        let ego = EgoTrack::new(&log);
        let x = |t_us: i64| ego.at(t_us).map(|pose| pose.translation.x);
        assert_eq!([0, 20, 60, 80, 100].map(x), [0.0, 3.0, 9.0, 9.5, 10.0].map(Some));
        assert_eq!([-1, 101].map(x), [None; 2]);
        assert_eq!(EgoTrack::new(&Recording::default()).at(0), None);
    }
}
