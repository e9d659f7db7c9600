//! Linear quadratic regulator that tracks a plan: what NAVSIM drives instead of the plan itself.

use glam::{DVec2, DVec3};

use super::SAMPLES;
use super::profile::Profile;
use super::state::{Command, PdmState, STEP_S};
use crate::WHEELBASE_M;

/// Number of steps that the controller looks ahead.
const HORIZON: usize = 10;
/// Speed below which the ego is stopped by a proportional controller with this gain, meters per second.
const STOPPING_MPS: f64 = 0.2;
const STOPPING_GAIN: f64 = 0.5;
/// Weight of the speed error; the acceleration has 1.
const SPEED_WEIGHT: f64 = 10.0;
/// Weights of lateral error, heading error and steering angle; the steering rate has 1.
const LATERAL_WEIGHTS: DVec3 = DVec3::new(1.0, 10.0, 0.0);

/// Returns the states of the ego, [`SAMPLES`] from the first one, while it tracks as many poses. Source:
/// NAVSIM's `BatchLQRTracker` and `PDMSimulator`.
pub(super) fn track(first: PdmState, poses: &[(DVec2, f64)]) -> Vec<PdmState> {
    let profile = Profile::of(&poses[..SAMPLES.min(poses.len())]);
    let mut states = vec![first];
    for index in 0..profile.speeds_mps.len() {
        let now = states[index];
        states.push(now.moved(command(&now, poses[index], &profile, index)));
    }
    states
}

fn command(now: &PdmState, pose: (DVec2, f64), profile: &Profile, index: usize) -> Command {
    let last = profile.speeds_mps.len() - 1;
    let ahead = (index + HORIZON).min(last);
    let (speed, wanted) = (now.velocity_mps.x, profile.speeds_mps[ahead]);
    if speed.max(wanted) <= STOPPING_MPS {
        return Command { acceleration_mps2: -STOPPING_GAIN * (speed - wanted), steering_rate_radps: 0.0 };
    }
    let reach_s = HORIZON as f64 * STEP_S;
    let inverse = -1.0 / (reach_s * SPEED_WEIGHT * reach_s + 1.0);
    let acceleration_mps2 = inverse * reach_s * SPEED_WEIGHT * (speed - wanted);
    let (place, heading_rad) = pose;
    let away = now.place_m - place;
    let turned = wrapped(now.heading_rad - heading_rad);
    let errors = DVec3::new(DVec2::from_angle(heading_rad).perp_dot(away), turned, now.steering_rad);
    // The linear system over all steps: errors = free + gain · steering rate.
    let (mut free, mut gain) = (errors, DVec3::ZERO);
    for step in 0..HORIZON {
        let speed = speed + acceleration_mps2 * STEP_S * step as f64;
        let curvature = profile.curvatures[(index + step).min(ahead)];
        let next =
            |v: DVec3| DVec3::new(v.x + speed * STEP_S * v.y, v.y + speed * STEP_S / WHEELBASE_M * v.z, v.z);
        free = next(free) - DVec3::Y * (speed * curvature * STEP_S);
        gain = next(gain) + DVec3::Z * STEP_S;
    }
    let free = DVec3::new(free.x, wrapped(free.y), wrapped(free.z));
    let weighted = gain * LATERAL_WEIGHTS;
    let steering_rate_radps = -weighted.dot(free) / (weighted.dot(gain) + 1.0);
    Command { acceleration_mps2, steering_rate_radps }
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_beside_the_ego_is_reached() {
        let first = PdmState { velocity_mps: DVec2::new(8.0, 0.0), ..PdmState::default() };
        let poses: Vec<_> = (0..41).map(|i| (DVec2::new(0.8 * f64::from(i), 0.5), 0.0)).collect();
        let states = track(first, &poses);
        assert_eq!((states.len(), states[0]), (SAMPLES, first));
        let last = states[40];
        assert!((last.place_m - DVec2::new(32.0, 0.5)).length() < 0.15, "{last:?}");
        assert!((last.velocity_mps.x - 8.0).abs() < 1e-6, "{last:?}");
    }

    #[test]
    fn a_standing_ego_stays() {
        let states = track(PdmState::default(), &[(DVec2::ZERO, 0.0); 41]);
        assert!(states.iter().all(|state| *state == PdmState::default()));
    }
}
