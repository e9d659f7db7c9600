//! State of the ego in NAVSIM's simulation, and the kinematic bicycle that moves it.

use std::f64::consts::{FRAC_PI_3, PI, TAU};

use glam::{DVec2, DVec3};
use point_skeleton::geometry::Footprint;

use crate::{EGO_SIZE_M, EgoState, REAR_AXLE_TO_CENTER_M, WHEELBASE_M};

/// Time between two states, seconds.
pub(super) const STEP_S: f64 = 0.1;
/// Maximum steering angle, radians.
const MAX_STEERING_RAD: f64 = FRAC_PI_3;
/// Time constants of the low-pass filters of acceleration and steering angle, seconds.
const ACCELERATION_LAG_S: f64 = 0.2;
const STEERING_LAG_S: f64 = 0.05;

/// State of the ego at the center of its rear axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PdmState {
    /// Global x and y, meters.
    pub place_m: DVec2,
    /// Global yaw, radians.
    pub heading_rad: f64,
    /// Velocity along the heading and to the left, meters per second.
    pub velocity_mps: DVec2,
    /// Acceleration along the heading and to the left, meters per second squared.
    pub acceleration_mps2: DVec2,
    /// Steering angle of the front wheels to the left, radians.
    pub steering_rad: f64,
    /// Yaw rate to the left, radians per second.
    pub yaw_rate_radps: f64,
    /// Yaw acceleration to the left, radians per second squared.
    pub yaw_acceleration_radps2: f64,
}

/// Command of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Command {
    pub(super) acceleration_mps2: f64,
    pub(super) steering_rate_radps: f64,
}

impl PdmState {
    /// Returns a logged state as NAVSIM reads one: steering angle and yaw rate are 0.
    pub(super) fn logged(ego: &EgoState) -> Self {
        Self { steering_rad: 0.0, yaw_rate_radps: 0.0, ..Self::driven(ego) }
    }

    /// Returns a state of a simulation.
    pub(super) fn driven(ego: &EgoState) -> Self {
        Self {
            place_m: ego.position_m(),
            heading_rad: ego.heading_rad(),
            velocity_mps: DVec2::new(ego.speed_mps, 0.0),
            acceleration_mps2: DVec2::new(ego.acceleration_mps2, ego.speed_mps * ego.yaw_rate_radps),
            steering_rad: ego.steering_rad,
            yaw_rate_radps: ego.yaw_rate_radps,
            yaw_acceleration_radps2: 0.0,
        }
    }

    /// Returns the rectangle of the vehicle.
    pub(crate) fn body(&self) -> Footprint {
        let forward = self.forward();
        let half_m = EGO_SIZE_M.truncate() / 2.0;
        Footprint { center: self.place_m + forward * REAR_AXLE_TO_CENTER_M, forward, half_m }
    }

    /// Returns the unit vector of the heading.
    pub(super) fn forward(&self) -> DVec2 {
        DVec2::from_angle(self.heading_rad)
    }

    /// Returns the state a step later. Both low-pass filters act on the command first; the yaw rate of the
    /// step has the steering angle before it. Source: NAVSIM's `BatchKinematicBicycleModel`.
    pub(super) fn moved(&self, command: Command) -> Self {
        let filtered = |from: f64, to: f64, lag_s: f64| STEP_S / (STEP_S + lag_s) * (to - from) + from;
        let acceleration = filtered(self.acceleration_mps2.x, command.acceleration_mps2, ACCELERATION_LAG_S);
        let wanted = STEP_S * command.steering_rate_radps + self.steering_rad;
        let steering_rate =
            (filtered(self.steering_rad, wanted, STEERING_LAG_S) - self.steering_rad) / STEP_S;
        let speed = self.velocity_mps.x;
        let turned = speed * self.steering_rad.tan() / WHEELBASE_M * STEP_S;
        let steering =
            (self.steering_rad + steering_rate * STEP_S).clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD);
        let next_speed = speed + acceleration * STEP_S;
        let yaw_rate = next_speed * steering.tan() / WHEELBASE_M;
        Self {
            place_m: self.place_m + self.forward() * speed * STEP_S,
            heading_rad: principal(self.heading_rad + turned),
            velocity_mps: DVec2::new(next_speed, 0.0),
            acceleration_mps2: DVec2::new(acceleration, 0.0),
            steering_rad: steering,
            yaw_rate_radps: yaw_rate,
            yaw_acceleration_radps2: (yaw_rate - self.yaw_rate_radps) / STEP_S,
        }
    }

    /// Returns a state between two, with the second one's share `s`; heading, too, is interpolated linearly.
    pub(super) fn between(&self, other: &Self, s: f64) -> Self {
        let mix = |a: f64, b: f64| a + s * (b - a);
        let turn = point_skeleton::geometry::wrap_angle(other.heading_rad - self.heading_rad);
        Self {
            place_m: self.place_m + s * (other.place_m - self.place_m),
            heading_rad: principal(self.heading_rad + s * turn),
            velocity_mps: self.velocity_mps + s * (other.velocity_mps - self.velocity_mps),
            acceleration_mps2: self.acceleration_mps2
                + s * (other.acceleration_mps2 - self.acceleration_mps2),
            steering_rad: mix(self.steering_rad, other.steering_rad),
            yaw_rate_radps: mix(self.yaw_rate_radps, other.yaw_rate_radps),
            yaw_acceleration_radps2: mix(self.yaw_acceleration_radps2, other.yaw_acceleration_radps2),
        }
    }

    /// Returns a pose given in the frame of this state (meters to the front and left, radians), global.
    pub(super) fn global(&self, pose: DVec3) -> (DVec2, f64) {
        (self.place_m + self.forward().rotate(pose.truncate()), principal(self.heading_rad + pose.z))
    }
}

/// Wraps an angle in radians into `[-pi, pi)`.
pub(super) fn principal(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_filtered() {
        let start = PdmState { velocity_mps: DVec2::new(10.0, 0.0), ..PdmState::default() };
        let next = start.moved(Command { acceleration_mps2: 3.0, steering_rate_radps: 0.3 });
        // A third of the acceleration, two thirds of the steering.
        assert!((next.acceleration_mps2.x - 1.0).abs() < 1e-12 && (next.velocity_mps.x - 10.1).abs() < 1e-12);
        assert!((next.steering_rad - 0.02).abs() < 1e-12);
        assert_eq!((next.place_m, next.heading_rad), (DVec2::X, 0.0));
        let yaw_rate = 10.1 * 0.02_f64.tan() / WHEELBASE_M;
        assert!((next.yaw_rate_radps - yaw_rate).abs() < 1e-12);
        assert!((next.yaw_acceleration_radps2 - yaw_rate * 10.0).abs() < 1e-9);
        let later = next.moved(Command::default());
        assert!((later.heading_rad - 10.1 * 0.02_f64.tan() / WHEELBASE_M * 0.1).abs() < 1e-12);
    }

    #[test]
    fn angles_are_principal() {
        assert_eq!([0.5, PI, -PI].map(principal), [0.5, -PI, -PI]);
        assert!((principal(3.5) + TAU - 3.5).abs() < 1e-12);
    }
}
