use glam::DVec3;

use crate::dataset::{Frame, Recording};
use crate::geometry::Cuboid;

/// Boxes of every track over time.
pub struct Trajectories(Vec<Vec<(i64, Cuboid)>>);

/// Maximum extrapolation of a track beyond its first and last box at constant velocity, microseconds: cameras
/// fire up to 100 ms before the LiDAR timestamp of the boxes.
const CARRY_ON_US: i64 = 150_000;

impl Trajectories {
    /// Collects a log's tracks from the boxes in some of its frames, in time order.
    pub fn new(log: &Recording, frames: &[&Frame]) -> Self {
        let mut tracks = vec![Vec::new(); log.tracks.len()];
        for frame in frames {
            for item in &frame.boxes {
                tracks[item.track].push((frame.t_us, item.cuboid));
            }
        }
        Self(tracks)
    }

    /// Returns a track's box at a time, interpolated between its boxes or extrapolated by at most 0.15 s; a
    /// single box does not move. `None` outside this range.
    pub fn at(&self, track: usize, t_us: i64) -> Option<Cuboid> {
        let boxes = &self.0[track];
        let next = boxes.partition_point(|(t, _)| *t < t_us);
        if let Some((_, cuboid)) = boxes.get(next).filter(|(t, _)| *t == t_us) {
            return Some(*cuboid);
        }
        let (first, last) = (boxes.first()?.0, boxes.last()?.0);
        if t_us < first - CARRY_ON_US || t_us > last + CARRY_ON_US {
            return None;
        }
        let Some([a, b]) = pair_around(boxes, next) else { return boxes.first().map(|(_, cuboid)| *cuboid) };
        let s = (t_us - a.0) as f64 / (b.0 - a.0) as f64;
        if (0.0..=1.0).contains(&s) {
            return Some(a.1.interpolate(&b.1, s));
        }
        // Only the position is extrapolated: rotation over so short a time is below the noise of the boxes.
        let mut cuboid = if s < 0.0 { a.1 } else { b.1 };
        cuboid.pose.translation = a.1.pose.translation.lerp(b.1.pose.translation, s);
        Some(cuboid)
    }

    /// Returns a track's velocity at a time, global m/s; zero for a track with one box.
    pub fn velocity(&self, track: usize, t_us: i64) -> DVec3 {
        let boxes = &self.0[track];
        let next = boxes.partition_point(|(t, _)| *t <= t_us);
        pair_around(boxes, next).map_or(DVec3::ZERO, |[a, b]| {
            (b.1.pose.translation - a.1.pose.translation) / ((b.0 - a.0) as f64 * 1e-6)
        })
    }

    /// Returns the median size of a track's boxes, meters; `None` without boxes.
    pub(crate) fn median_size(&self, track: usize) -> Option<DVec3> {
        let mut sides: [Vec<f64>; 3] = Default::default();
        for (_, cuboid) in &self.0[track] {
            (0..3).for_each(|axis| sides[axis].push(cuboid.size[axis]));
        }
        let [l, w, h] = sides.map(|mut side| {
            side.sort_by(f64::total_cmp);
            side.get(side.len() / 2).copied()
        });
        Some(DVec3::new(l?, w?, h?))
    }
}

/// Returns the two samples around index `next`, or the two nearest at an end.
fn pair_around(boxes: &[(i64, Cuboid)], next: usize) -> Option<[&(i64, Cuboid); 2]> {
    let after = next.clamp(1, boxes.len().saturating_sub(1).max(1));
    Some([boxes.get(after - 1)?, boxes.get(after)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    fn trajectory(xs: &[(i64, f64)]) -> Trajectories {
        let cuboid = |x| Cuboid::new(Pose::from_yaw(0.0, DVec3::new(x, 0.0, 0.0)), DVec3::ONE).unwrap();
        Trajectories(vec![xs.iter().map(|&(t, x)| (t, cuboid(x))).collect()])
    }

    #[test]
    fn positions_are_interpolated_and_briefly_extrapolated() {
        let t = trajectory(&[(0, 0.0), (200_000, 2.0), (400_000, 6.0)]);
        let x = |us| t.at(0, us).map(|c| c.pose.translation.x);
        assert_eq!([x(0), x(100_000), x(300_000), x(400_000)], [Some(0.0), Some(1.0), Some(4.0), Some(6.0)]);
        assert_eq!([x(-100_000), x(500_000)], [Some(-1.0), Some(8.0)]);
        assert_eq!([x(-200_000), x(600_000)], [None, None]);
        assert_eq!(t.velocity(0, 100_000).x, 10.0);
        assert_eq!(t.velocity(0, 400_000).x, 20.0);
    }

    #[test]
    fn a_single_box_is_static_for_a_short_time() {
        let t = trajectory(&[(0, 3.0)]);
        assert_eq!(t.velocity(0, 0), DVec3::ZERO);
        assert!(t.at(0, 0).is_some() && t.at(0, 0) == t.at(0, -100_000) && t.at(0, 200_000).is_none());
        assert_eq!(t.median_size(0), Some(DVec3::ONE));
    }
}
