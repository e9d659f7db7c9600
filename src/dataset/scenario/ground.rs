use glam::{DVec2, DVec3};

use crate::dataset::Recording;

/// Ground heights along the recorded ego path.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Ground(Vec<DVec3>);

impl Ground {
    /// Collects the ego origins of all frames, which are on the ground.
    pub(super) fn of(log: &Recording) -> Self {
        Self(log.frames.iter().map(|frame| frame.global_from_ego.translation).collect())
    }

    /// Returns the height (meters) of the nearest place of the path, interpolated between two origins. Ties
    /// go to the earlier one; 0 without a path.
    pub(super) fn height_m(&self, at: DVec2) -> f64 {
        let mut best = (f64::INFINITY, self.0.first().map_or(0.0, |origin| origin.z));
        for ends in self.0.windows(2) {
            let (from, step) = (ends[0], ends[1] - ends[0]);
            let length_2 = step.truncate().length_squared();
            let along =
                if length_2 > 0.0 { (at - from.truncate()).dot(step.truncate()) / length_2 } else { 0.0 };
            let foot = from + step * along.clamp(0.0, 1.0);
            let distance_m = foot.truncate().distance(at);
            if distance_m < best.0 {
                best = (distance_m, foot.z);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Frame;
    use crate::geometry::Pose;

    #[test]
    fn heights_are_interpolated_along_the_path() {
        let frame = |x: f64| {
            let (sweeps, images, between_images, boxes) = Default::default();
            let global_from_ego = Pose::from_yaw(0.0, DVec3::new(x, 0.0, x / 10.0));
            Frame { t_us: x as i64, global_from_ego, sweeps, images, between_images, boxes }
        };
        let log = Recording { frames: [0.0, 10.0, 20.0].map(frame).to_vec(), ..Recording::default() };
        let height = |x: f64| (Ground::of(&log).height_m(DVec2::new(x, 3.0)) * 1e9).round() / 1e9;
        assert_eq!([-5.0, 0.0, 4.0, 13.0, 25.0].map(height), [0.0, 0.0, 0.4, 1.3, 2.0]);
        assert_eq!(Ground::default().height_m(DVec2::ONE), 0.0);
    }
}
