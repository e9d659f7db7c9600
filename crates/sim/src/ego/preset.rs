use glam::DVec2;
use point_skeleton::geometry::wrap_angle;

use super::profile::Profile;
use crate::{EgoState, Trajectory, Waypoint};

/// Minimum speed of presets, meters per second.
const MIN_SPEED_MPS: f64 = 3.0;
/// Maximum speed to which presets accelerate, meters per second.
const MAX_SPEED_MPS: f64 = 6.0;
const ACCELERATION_MPS2: f64 = 0.6;
const WAYPOINTS: usize = 22;
const STEP_US: i64 = 100_000;
/// Lateral offset to the left between start and end of the cosine, meters.
const COSINE_OFFSET_M: f64 = -1.5;
/// Lateral offset to the left of the first waypoint at the full aim to the right, meters.
const RIGHT_OFFSET_M: f64 = -0.06;

/// Preset plan shapes in the ego's own frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Preset {
    Straight,
    RightThenBack,
    Cosine,
}

/// Returns the speed profile of a preset for an initial speed, meters per second.
pub(super) fn profile(speed_mps: f64) -> Profile {
    Profile::steady(speed_mps.max(MIN_SPEED_MPS), speed_mps.max(MAX_SPEED_MPS), ACCELERATION_MPS2)
}

impl Preset {
    /// Returns the plan with index `plans` since the takeover (0 for the first): 22 waypoints at 0.1 s.
    pub(super) fn plan(self, ego: &EgoState, t_us: i64, plans: usize) -> Trajectory {
        let now = Waypoint::of(ego, t_us);
        let profile = profile(ego.speed_mps);
        let time_s = |i: usize| (i as i64 * STEP_US) as f64 / 1e6;
        let travelled_m = |i: usize| profile.at(time_s(i)).travelled_m;
        let (first_m, last_m) = (travelled_m(1), travelled_m(WAYPOINTS));
        let forward = DVec2::from_angle(now.heading_rad);
        let next = (1..=WAYPOINTS).map(|i| {
            let (y_m, slope) = self.shape(travelled_m(i), first_m, last_m, plans);
            let place = now.position_m() + forward * travelled_m(i) + forward.perp() * y_m;
            Waypoint {
                t_us: t_us + i as i64 * STEP_US,
                x_m: place.x,
                y_m: place.y,
                heading_rad: wrap_angle(now.heading_rad + slope.atan()),
                speed_mps: profile.at(time_s(i)).speed_mps,
            }
        });
        Trajectory::new(now, next)
    }

    /// Returns the lateral offset to the left (meters) and its slope at a distance of `x_m` ahead.
    fn shape(self, x_m: f64, first_m: f64, last_m: f64, plans: usize) -> (f64, f64) {
        match self {
            Self::Straight => (0.0, 0.0),
            Self::RightThenBack => {
                let share = ((plans as f64 - 6.0) / 10.0).clamp(0.0, 1.0);
                let slope = RIGHT_OFFSET_M * share / first_m;
                (slope * x_m, slope)
            }
            Self::Cosine => {
                let phase = std::f64::consts::PI / last_m;
                let y_m = COSINE_OFFSET_M * (1.0 - (phase * x_m).cos()) / 2.0;
                (y_m, COSINE_OFFSET_M * phase * (phase * x_m).sin() / 2.0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use point_skeleton::geometry::Pose;

    /// Returns the plan of an ego at (100, 50) heading north.
    fn plan(preset: Preset, speed_mps: f64, plans: usize) -> Vec<(f64, DVec2, f64, f64)> {
        let pose = Pose::from_yaw(std::f64::consts::FRAC_PI_2, DVec3::new(100.0, 50.0, 3.0));
        let ego =
            EgoState { pose, speed_mps, acceleration_mps2: 0.0, yaw_rate_radps: 0.0, steering_rad: 0.0 };
        let plan = preset.plan(&ego, 5_000_000, plans);
        let local = |w: &Waypoint| {
            let place = pose.inverse().transform_point(w.position_m().extend(3.0));
            let heading = wrap_angle(w.heading_rad - std::f64::consts::FRAC_PI_2);
            ((w.t_us - 5_000_000) as f64 / 1e6, place.truncate(), heading, w.speed_mps)
        };
        plan.waypoints()[1..].iter().map(local).collect()
    }

    #[test]
    fn speeds_rise_from_3_to_6() {
        let waypoints = plan(Preset::Straight, 1.0, 0);
        assert_eq!(waypoints.len(), 22);
        for (t, place, heading, speed) in &waypoints {
            assert!((place.x - (3.0 * t + 0.3 * t * t)).abs() < 1e-9 && place.y.abs() < 1e-9);
            assert!((speed - (3.0 + 0.6 * t)).abs() < 1e-12 && heading.abs() < 1e-12);
        }
        assert_eq!(waypoints[21].0, 2.2);
        // From 5.4 m/s the limit is reached after 1 s, from 9 m/s immediately.
        assert!((plan(Preset::Straight, 5.4, 0)[21].3 - 6.0).abs() < 1e-12);
        assert!((plan(Preset::Straight, 9.0, 0)[21].1.x - 19.8).abs() < 1e-9);
    }

    #[test]
    fn the_cosine_ends_to_the_right() {
        let waypoints = plan(Preset::Cosine, 10.0, 3);
        let (_, end, heading, _) = waypoints[21];
        assert!((end.y + 1.5).abs() < 1e-9 && heading.abs() < 1e-9 && (end.x - 22.0).abs() < 1e-9);
        // At half the length the offset is half and the heading deviates most.
        assert!((waypoints[10].1.y + 0.75).abs() < 1e-9);
        assert!((waypoints[10].2.tan() + 0.75 * std::f64::consts::PI / 22.0).abs() < 1e-9);
    }

    #[test]
    fn the_first_waypoint_moves_to_the_right_with_the_plans() {
        let first_y = |plans: usize| plan(Preset::RightThenBack, 10.0, plans)[0].1.y;
        for (plans, y) in [(0, 0.0), (6, 0.0), (7, -0.006), (11, -0.03), (16, -0.06), (90, -0.06)] {
            assert!((first_y(plans) - y).abs() < 1e-9, "{plans}: {}", first_y(plans));
        }
        let all = plan(Preset::RightThenBack, 10.0, 16);
        assert!(
            all.iter().all(|(_, p, h, _)| (p.y + 0.06 * p.x).abs() < 1e-9 && (h.tan() + 0.06).abs() < 1e-9)
        );
    }
}
