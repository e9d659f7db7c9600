use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::Range;
use crate::EgoState;
use crate::time::seconds;

/// nuPlan's comfort bounds.
const LONGITUDINAL_MPS2: Range = Range { min: -4.05, max: 2.40 };
const LATERAL_MPS2: f64 = 4.89;
const JERK_MPS3: f64 = 8.37;
const YAW_RATE_RADPS: f64 = 0.95;

/// Comfort metrics of a rollout, at the center of the rear axle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Comfort {
    /// Whether all values are within nuPlan's bounds: longitudinal acceleration from -4.05 to 2.40 m/s²,
    /// lateral acceleration up to 4.89 m/s², jerk up to 8.37 m/s³, yaw rate up to 0.95 rad/s.
    pub comfortable: bool,
    /// Acceleration along the heading, m/s²; `None` before the first instant.
    pub longitudinal_mps2: Option<Range>,
    /// Acceleration to the left, m/s²: speed times yaw rate.
    pub lateral_mps2: Option<Range>,
    /// Yaw rate to the left, rad/s.
    pub yaw_rate_radps: Option<Range>,
    /// Maximum magnitude of the jerk from both accelerations between steps, m/s³.
    pub max_jerk_mps3: f64,
}

/// Accumulator of the comfort metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ComfortTally {
    longitudinal_mps2: Option<Range>,
    lateral_mps2: Option<Range>,
    yaw_rate_radps: Option<Range>,
    max_jerk_mps3: f64,
    /// Time and accelerations of the last instant.
    last: Option<(i64, [f64; 2])>,
}

impl ComfortTally {
    /// Adds an instant.
    pub(super) fn add(&mut self, ego: &EgoState, t_us: i64) {
        let (along, across) = (ego.acceleration_mps2, ego.speed_mps * ego.yaw_rate_radps);
        self.longitudinal_mps2 = Some(Range::with(self.longitudinal_mps2, along));
        self.lateral_mps2 = Some(Range::with(self.lateral_mps2, across));
        self.yaw_rate_radps = Some(Range::with(self.yaw_rate_radps, ego.yaw_rate_radps));
        if let Some((before_us, before)) = self.last {
            let change = DVec2::new(along, across) - DVec2::from_array(before);
            self.max_jerk_mps3 = self.max_jerk_mps3.max(change.length() / seconds(before_us, t_us));
        }
        self.last = Some((t_us, [along, across]));
    }

    pub(super) fn figures(&self) -> Comfort {
        let within =
            |range: Option<Range>, min: f64, max: f64| range.is_none_or(|r| r.min >= min && r.max <= max);
        let comfortable = within(self.longitudinal_mps2, LONGITUDINAL_MPS2.min, LONGITUDINAL_MPS2.max)
            && within(self.lateral_mps2, -LATERAL_MPS2, LATERAL_MPS2)
            && within(self.yaw_rate_radps, -YAW_RATE_RADPS, YAW_RATE_RADPS)
            && self.max_jerk_mps3 <= JERK_MPS3;
        Comfort {
            comfortable,
            longitudinal_mps2: self.longitudinal_mps2,
            lateral_mps2: self.lateral_mps2,
            yaw_rate_radps: self.yaw_rate_radps,
            max_jerk_mps3: self.max_jerk_mps3,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::geometry::Pose;

    fn figures(states: &[(f64, f64, f64)]) -> Comfort {
        let mut tally = ComfortTally::default();
        for (i, &(speed_mps, acceleration_mps2, yaw_rate_radps)) in states.iter().enumerate() {
            let pose = Pose::IDENTITY;
            let ego = EgoState { pose, speed_mps, acceleration_mps2, yaw_rate_radps, steering_rad: 0.0 };
            tally.add(&ego, i as i64 * 100_000);
        }
        tally.figures()
    }

    #[test]
    fn computes_comfort_ranges() {
        let found = figures(&[(10.0, 0.0, 0.0), (10.0, 0.3, 0.04), (10.0, -0.1, -0.02)]);
        assert_eq!(found.longitudinal_mps2, Some(Range { min: -0.1, max: 0.3 }));
        assert_eq!(found.lateral_mps2, Some(Range { min: -0.2, max: 0.4 }));
        assert_eq!(found.yaw_rate_radps, Some(Range { min: -0.02, max: 0.04 }));
        // From (0.3, 0.4) to (-0.1, -0.2) in a tenth of a second.
        assert!((found.max_jerk_mps3 - (16.0f64 + 36.0).sqrt()).abs() < 1e-9 && found.comfortable);
        assert_eq!(figures(&[]).longitudinal_mps2, None);
    }

    #[test]
    fn each_comfort_bound_applies() {
        for (state, comfortable) in [
            ((1.0, 2.40, 0.0), true),
            ((1.0, 2.41, 0.0), false),
            ((1.0, -4.05, 0.0), true),
            ((1.0, -4.06, 0.0), false),
            ((1.0, 0.0, 0.95), true),
            ((1.0, 0.0, -0.96), false),
            ((10.0, 0.0, 0.488), true),
            ((10.0, 0.0, -0.49), false),
        ] {
            assert_eq!(figures(&[state]).comfortable, comfortable, "{state:?}");
        }
        assert!(figures(&[(1.0, 0.0, 0.0), (1.0, 0.83, 0.0)]).comfortable);
        assert!(!figures(&[(1.0, 0.0, 0.0), (1.0, 0.84, 0.0)]).comfortable);
    }
}
