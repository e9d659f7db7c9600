//! Ego poses that lie kilometers away from the others, as those that a recorder had before its first fix.

use glam::DVec3;

use crate::cloud::PRECISE_WITHIN_M;
use crate::dataset::{Frame, Recording};

/// Kind of the note on jumps.
pub(in super::super) const JUMPS: &str = "jumps of the ego by more than 1 km from one pose to the next";
/// Minimum length of a jump, meters: shorter fast movements are none.
const JUMP_M: f64 = 1000.0;
/// Speed above which a long movement is a jump, meters per second.
const JUMP_MPS: f64 = 200.0;

/// Counts the jumps of the ego from one pose to the next, among all poses of frames, sweeps and images in
/// time order. Long times without a pose are none.
pub(in super::super) fn count_jumps(log: &Recording) -> usize {
    let mut poses: Vec<(i64, DVec3)> = log.frames.iter().flat_map(poses).collect();
    poses.sort_by_key(|(t_us, _)| *t_us);
    let is_jump = |pair: &&[(i64, DVec3)]| {
        let [(t0, from), (t1, to)] = [pair[0], pair[1]];
        let seconds = t1.abs_diff(t0) as f64 * 1e-6;
        from.distance(to) > JUMP_M.max(JUMP_MPS * seconds)
    };
    poses.windows(2).filter(is_jump).count()
}

fn poses(frame: &Frame) -> impl Iterator<Item = (i64, DVec3)> {
    let own = std::iter::once((frame.t_us, &frame.global_from_ego));
    let sweeps = frame.sweeps.iter().map(|sweep| (sweep.t_us, &sweep.global_from_ego));
    let images = frame.images.iter().chain(&frame.between_images);
    let images = images.map(|image| (image.t_us, &image.global_from_ego));
    own.chain(sweeps).chain(images).map(|(t_us, pose)| (t_us, pose.translation))
}

impl Frame {
    /// Returns the first of some frames whose ego is near the median of all ego positions, within
    /// [`PRECISE_WITHIN_M`]: the frame whose ego is the origin of other coordinates. The first frame if there
    /// is none; `None` without frames.
    pub fn origin_of(frames: &[Self]) -> Option<&Self> {
        let median = |axis: usize| {
            let mut values: Vec<f64> =
                frames.iter().map(|frame| frame.global_from_ego.translation[axis]).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or_default()
        };
        let median = DVec3::new(median(0), median(1), median(2));
        let offset = |frame: &Self| (frame.global_from_ego.translation - median).abs().max_element();
        frames.iter().find(|frame| offset(frame) <= PRECISE_WITHIN_M).or(frames.first())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    fn log(xs: &[f64]) -> Recording {
        let frame = |(i, x): (i64, &f64)| Frame {
            t_us: i * 500_000,
            global_from_ego: Pose::from_yaw(0.0, DVec3::new(*x, 5e6, 0.0)),
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        Recording { frames: (0..).zip(xs).map(frame).collect(), ..Recording::default() }
    }

    #[test]
    fn distant_poses_are_counted_and_never_the_origin() {
        for (xs, jumps, origin) in [
            (&[7e5, 7e5 + 10.0, 7e5 + 20.0][..], 0, 0),
            (&[0.0, 7e5, 7e5 + 10.0, 7e5 + 20.0], 1, 1),
            (&[7e5, 7e5 + 10.0, 0.0], 1, 0),
            (&[7e5, 0.0, 7e5 + 10.0, 7e5 + 20.0], 2, 0),
            (&[0.0, 0.0, 7e5, 7e5, 7e5], 1, 2),
            (&[0.0, 999.0], 0, 0),
            (&[7e5], 0, 0),
        ] {
            let log = log(xs);
            assert_eq!(count_jumps(&log), jumps, "{xs:?}");
            let found = Frame::origin_of(&log.frames).map(|frame| frame.t_us / 500_000);
            assert_eq!(found, Some(origin), "{xs:?}");
        }
        assert_eq!((count_jumps(&log(&[])), Frame::origin_of(&[])), (0, None));
    }

    #[test]
    fn movement_in_a_long_gap_is_not_a_jump() {
        let mut log = log(&[0.0, 9000.0]);
        log.frames[1].t_us = 600_000_000;
        assert_eq!(count_jumps(&log), 0);
    }
}
