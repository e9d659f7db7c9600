//! Driving by a person's controls.

use point_skeleton::geometry::wrap_angle;

use super::time::seconds;
use super::tracking::{Bicycle, CONTROL_S, MAX_ACCELERATION_MPS2, MAX_BRAKING_MPS2, MAX_STEERING_RAD};
use super::{EgoState, Waypoint};

/// Deceleration of a car that rolls without throttle and brake, meters per second squared.
const DRAG_MPS2: f64 = 0.4;
/// Maximum speeds forward and backward, meters per second; the throttle does not exceed them.
const MAX_SPEEDS_MPS: [f64; 2] = [50.0, 5.0];
/// Maximum speed that counts as standing, meters per second.
const STANDSTILL_MPS: f64 = 0.01;

/// Positions of pedals and steering wheel. Values out of range are clamped; those that are not finite count
/// as 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Controls {
    /// Throttle from -1 to 1. Against the motion it brakes to a standstill; a step that starts there
    /// changes the direction.
    pub throttle: f64,
    /// Brake from 0 to 1; it never reverses the motion.
    pub brake: f64,
    /// Steering from -1 (right) to 1 (left); at 0 the wheel returns to the center.
    pub steer: f64,
}

/// Steering wheel and pedals of a kinematic bicycle with the limits of
/// [`Tracking::Bicycle`](crate::Tracking::Bicycle).
///
/// It retains the steering angle, since the angle of an [`EgoState`] can be the mean over a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheel {
    steering_rad: f64,
}

impl Wheel {
    /// Creates a wheel at the steering angle of the ego.
    pub fn new(ego: &EgoState) -> Self {
        Self { steering_rad: Bicycle::of(ego).steering_rad }
    }

    /// Returns the steering angle of the front wheels to the left, radians.
    pub fn steering_rad(&self) -> f64 {
        self.steering_rad
    }

    /// Drives from the ego's state at `now_us` with constant controls and returns the waypoint at `next_us`,
    /// absolute microseconds. Returns the ego's state if no time passes.
    pub fn drive(&mut self, ego: &EgoState, controls: Controls, now_us: i64, next_us: i64) -> Waypoint {
        if next_us <= now_us {
            return Waypoint::of(ego, next_us);
        }
        let controls = controls.clamped();
        let mut bicycle = Bicycle::of(ego);
        bicycle.steering_rad = self.steering_rad;
        let stands = ego.speed_mps.abs() <= STANDSTILL_MPS;
        let count = (seconds(now_us, next_us) / CONTROL_S).ceil().max(1.0);
        let dt_s = seconds(now_us, next_us) / count;
        for _ in 0..count as u64 {
            let acceleration_mps2 = controls.acceleration(bicycle.speed_mps, stands, dt_s);
            let limit_rad = bicycle.limited_steering(f64::INFINITY);
            let target_rad = (controls.steer * MAX_STEERING_RAD).clamp(-limit_rad, limit_rad);
            bicycle.advance(acceleration_mps2, target_rad, dt_s);
        }
        self.steering_rad = bicycle.steering_rad;
        Waypoint {
            t_us: next_us,
            x_m: bicycle.place_m.x,
            y_m: bicycle.place_m.y,
            heading_rad: wrap_angle(bicycle.heading_rad),
            speed_mps: bicycle.speed_mps,
        }
    }
}

impl Controls {
    fn clamped(self) -> Self {
        let within = |value: f64, min: f64| if value.is_finite() { value.clamp(min, 1.0) } else { 0.0 };
        Self {
            throttle: within(self.throttle, -1.0),
            brake: within(self.brake, 0.0),
            steer: within(self.steer, -1.0),
        }
    }

    /// Returns the acceleration (meters per second squared) over a short time; `stands` is whether the ego
    /// stands at the start of the step, so that the throttle may choose the direction.
    fn acceleration(&self, speed_mps: f64, stands: bool, dt_s: f64) -> f64 {
        let brakes = self.brake > 0.0 || self.throttle * speed_mps < 0.0 && !stands;
        let resistance = if brakes {
            let against = if self.throttle * speed_mps < 0.0 { self.throttle.abs() } else { 0.0 };
            MAX_BRAKING_MPS2 * self.brake.max(against)
        } else if self.throttle == 0.0 {
            DRAG_MPS2
        } else {
            0.0
        };
        if resistance > 0.0 {
            // Neither brake nor drag reverses the motion.
            return -speed_mps.signum() * resistance.min(speed_mps.abs() / dt_s);
        }
        // Having braked to a standstill within this step, the throttle waits for the next one.
        if speed_mps == 0.0 && !stands {
            return 0.0;
        }
        let [forward_mps, backward_mps] = MAX_SPEEDS_MPS;
        let wanted = MAX_ACCELERATION_MPS2 * self.throttle;
        if wanted > 0.0 {
            wanted.min(((forward_mps - speed_mps) / dt_s).max(0.0))
        } else {
            wanted.max(((-backward_mps - speed_mps) / dt_s).min(0.0))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::WHEELBASE_M;
    use glam::DVec3;
    use point_skeleton::geometry::Pose;

    fn ego(waypoint: &Waypoint) -> EgoState {
        let pose = Pose::from_yaw(waypoint.heading_rad, waypoint.position_m().extend(0.0));
        let speed_mps = waypoint.speed_mps;
        EgoState { pose, speed_mps, acceleration_mps2: 0.0, yaw_rate_radps: 0.0, steering_rad: 0.0 }
    }

    fn start(speed_mps: f64) -> Waypoint {
        let at = DVec3::ZERO;
        Waypoint { t_us: 0, x_m: at.x, y_m: at.y, heading_rad: 0.0, speed_mps }
    }

    /// Drives with constant controls at 10 Hz; returns the wheel and all waypoints.
    fn drive(speed_mps: f64, controls: Controls, steps: usize) -> (Wheel, Vec<Waypoint>) {
        let mut driven = vec![start(speed_mps)];
        let mut wheel = Wheel::new(&ego(&driven[0]));
        for step in 0..steps {
            let now = driven[step];
            driven.push(wheel.drive(&ego(&now), controls, now.t_us, now.t_us + 100_000));
        }
        (wheel, driven)
    }

    #[test]
    fn full_throttle_accelerates_straight_on() {
        let (_, driven) = drive(0.0, Controls { throttle: 1.0, ..Controls::default() }, 50);
        let last = driven[50];
        assert!((last.speed_mps - 20.0).abs() < 1e-6 && (last.x_m - 50.0).abs() < 1e-6, "{last:?}");
        assert_eq!((last.y_m, last.heading_rad), (0.0, 0.0));
        let (_, driven) = drive(0.0, Controls { throttle: 1.0, ..Controls::default() }, 200);
        assert!((driven[200].speed_mps - 50.0).abs() < 1e-6);
    }

    #[test]
    fn brake_and_drag_stop_without_reversing() {
        let brake = Controls { brake: 1.0, throttle: 1.0, ..Controls::default() };
        let (_, driven) = drive(8.0, brake, 20);
        assert!(driven.iter().all(|w| w.speed_mps >= 0.0) && driven[20].speed_mps.abs() < 1e-12);
        assert!((driven[20].x_m - 4.0).abs() < 1e-6, "{:?}", driven[20]);
        let (_, driven) = drive(8.0, Controls::default(), 100);
        assert!((driven[100].speed_mps - 4.0).abs() < 1e-6, "{:?}", driven[100]);
    }

    #[test]
    fn reverse_needs_a_standstill() {
        let back = Controls { throttle: -1.0, ..Controls::default() };
        let (_, driven) = drive(0.4, back, 30);
        assert_eq!(driven[1].speed_mps, 0.0);
        assert!(driven[2].speed_mps < 0.0 && (driven[30].speed_mps + 5.0).abs() < 1e-6);
    }

    #[test]
    fn constant_angle_drives_a_circle() {
        // Next to no throttle: it keeps the speed, without drag.
        let controls = Controls { steer: 0.5, throttle: 1e-9, ..Controls::default() };
        let mut wheel = Wheel { steering_rad: 0.3 };
        let (mut now, radius_m) = (start(3.0), WHEELBASE_M / 0.3f64.tan());
        for _ in 0..40 {
            now = wheel.drive(&ego(&now), controls, now.t_us, now.t_us + 100_000);
            let off_m = (now.x_m.hypot(now.y_m - radius_m) - radius_m).abs();
            assert!(off_m < 1e-3, "{off_m}");
        }
        assert_eq!(wheel.steering_rad(), 0.3);
    }

    #[test]
    fn steering_is_limited_and_returns_to_the_center() {
        let left = Controls { steer: 1.0, ..Controls::default() };
        let (mut wheel, driven) = drive(20.0, left, 1);
        assert!((wheel.steering_rad() - (WHEELBASE_M * 8.0 / 400.0).atan()).abs() < 1e-3, "{wheel:?}");
        let (slow, _) = drive(1.0, left, 1);
        assert!((slow.steering_rad() - 0.08).abs() < 1e-12);
        let center = Controls { steer: f64::NAN, throttle: f64::INFINITY, brake: f64::NAN };
        wheel.drive(&ego(&driven[1]), center, 100_000, 300_000);
        assert_eq!(wheel.steering_rad(), 0.0);
    }
}
