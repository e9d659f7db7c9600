//! Tracking of a plan by the ego.

use glam::DVec2;
use point_skeleton::geometry::wrap_angle;

use super::time::seconds;
use super::{EgoState, Instant, Tracking, WHEELBASE_M};
use crate::path::route::RouteWindow;
use crate::path::trajectory::{Trajectory, Waypoint};

/// Maximum steering angle of the front wheels to either side, radians.
pub(super) const MAX_STEERING_RAD: f64 = 0.6;
const MAX_STEERING_RADPS: f64 = 0.8;
pub(super) const MAX_ACCELERATION_MPS2: f64 = 4.0;
pub(super) const MAX_BRAKING_MPS2: f64 = 8.0;
/// Maximum time between controller steps, seconds.
pub(super) const CONTROL_S: f64 = 0.01;
/// Gains of longitudinal errors in position (per second squared) and speed (per second). Errors decay within
/// about 2 s, without overshoot.
const GAINS_ALONG: [f64; 2] = [4.0, 4.0];
/// Gains of lateral offset (per meter squared) and heading (per meter) of the rear-wheel feedback controller
/// (Samson 1992; Paden et al. 2016, section V-B). Offsets decay over about 16 m, without overshoot.
const GAINS_ACROSS: [f64; 2] = [0.0625, 0.5];
/// Limits of longitudinal and lateral position errors, meters: a lagging ego exceeds the planned speed by at
/// most as many meters per second.
const MAX_ERRORS_M: [f64; 2] = [2.0, 3.0];
/// Maximum commanded lateral acceleration: above it, tires slip.
const MAX_LATERAL_MPS2: f64 = 8.0;
/// Minimum speed for steering angles from yaw rates, meters per second.
const CREEP_MPS: f64 = 0.1;

/// Returns the ego at the next step, on the ground of the recorded path around its current position.
pub(super) fn follow(
    how: Tracking,
    stretch: RouteWindow<'_>,
    now: &Instant,
    plan: &Trajectory,
    t_us: i64,
) -> EgoState {
    match how {
        Tracking::Perfect => perfect(stretch, now, &plan.at(t_us)),
        Tracking::Bicycle => {
            let mut bicycle = Bicycle::of(&now.ego);
            let pieces = (seconds(now.t_us, t_us) / CONTROL_S).ceil().max(1.0) as i64;
            let at_us = |i: i64| now.t_us + (t_us - now.t_us) * i / pieces;
            for i in 0..pieces {
                bicycle.step(plan, at_us(i), seconds(at_us(i), at_us(i + 1)));
            }
            bicycle.state(stretch)
        }
    }
}

/// Places the ego at a waypoint; acceleration, yaw rate and steering follow from the difference to the
/// previous step.
fn perfect(stretch: RouteWindow<'_>, now: &Instant, to: &Waypoint) -> EgoState {
    let dt_s = seconds(now.t_us, to.t_us);
    let yaw_rate_radps = wrap_angle(to.heading_rad - now.ego.heading_rad()) / dt_s;
    let rolls = to.speed_mps.abs() > CREEP_MPS;
    let steering_rad = (WHEELBASE_M * yaw_rate_radps / to.speed_mps).atan();
    EgoState {
        pose: stretch.pose_at(to.position_m(), to.heading_rad),
        speed_mps: to.speed_mps,
        acceleration_mps2: (to.speed_mps - now.ego.speed_mps) / dt_s,
        yaw_rate_radps,
        steering_rad: if rolls { steering_rad } else { now.ego.steering_rad },
    }
}

/// Kinematic bicycle model about the center of its rear axle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bicycle {
    pub(super) place_m: DVec2,
    pub(super) heading_rad: f64,
    pub(super) speed_mps: f64,
    pub(super) steering_rad: f64,
    acceleration_mps2: f64,
}

impl Bicycle {
    pub(super) fn of(ego: &EgoState) -> Self {
        Self {
            place_m: ego.position_m(),
            heading_rad: ego.heading_rad(),
            speed_mps: ego.speed_mps,
            steering_rad: ego.steering_rad.clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD),
            acceleration_mps2: ego.acceleration_mps2,
        }
    }

    fn yaw_rate_radps(&self) -> f64 {
        self.speed_mps * self.steering_rad.tan() / WHEELBASE_M
    }

    fn state(&self, stretch: RouteWindow<'_>) -> EgoState {
        EgoState {
            pose: stretch.pose_at(self.place_m, self.heading_rad),
            speed_mps: self.speed_mps,
            acceleration_mps2: self.acceleration_mps2,
            yaw_rate_radps: self.yaw_rate_radps(),
            steering_rad: self.steering_rad,
        }
    }

    /// Advances by a short time while steering towards the plan.
    fn step(&mut self, plan: &Trajectory, t_us: i64, dt_s: f64) {
        let (wanted, (acceleration, curvature)) = (plan.at(t_us), plan.changes_at(t_us));
        let forward = DVec2::from_angle(wanted.heading_rad);
        let error = self.place_m - wanted.position_m();
        let (ahead_m, left_m) = (forward.dot(error), forward.perp_dot(error));
        let faster_mps = self.speed_mps - wanted.speed_mps;
        let wish = acceleration
            - GAINS_ALONG[0] * ahead_m.clamp(-MAX_ERRORS_M[0], MAX_ERRORS_M[0])
            - GAINS_ALONG[1] * faster_mps;
        let mut braked = wish.clamp(-MAX_BRAKING_MPS2, MAX_ACCELERATION_MPS2);
        // Braking for a stop must not drive backward.
        if wanted.speed_mps >= 0.0 && self.speed_mps >= 0.0 && self.speed_mps + braked * dt_s < 0.0 {
            braked = -self.speed_mps / dt_s;
        }
        self.advance(braked, self.wanted_steering(left_m, wanted.heading_rad, curvature), dt_s);
    }

    /// Advances by a short time with an acceleration, and the steering angle towards a target at its limited
    /// rate.
    pub(super) fn advance(&mut self, acceleration_mps2: f64, target_rad: f64, dt_s: f64) {
        let most_rad = MAX_STEERING_RADPS * dt_s;
        self.steering_rad += (target_rad - self.steering_rad).clamp(-most_rad, most_rad);
        self.acceleration_mps2 = acceleration_mps2;
        let (speed_mps, yaw_rate_radps) =
            (self.speed_mps + acceleration_mps2 * dt_s / 2.0, self.yaw_rate_radps());
        // Midpoint values for speed and heading.
        let heading_rad = self.heading_rad + yaw_rate_radps * dt_s / 2.0;
        self.place_m += DVec2::from_angle(heading_rad) * (speed_mps * dt_s);
        self.heading_rad = wrap_angle(self.heading_rad + yaw_rate_radps * dt_s);
        self.speed_mps += acceleration_mps2 * dt_s;
    }

    fn wanted_steering(&self, left_m: f64, heading_rad: f64, curvature: f64) -> f64 {
        let turned_rad = wrap_angle(self.heading_rad - heading_rad);
        let sinc = if turned_rad.abs() < 1e-6 { 1.0 } else { turned_rad.sin() / turned_rad };
        // Curvature per driven meter: closer to the center of a bend the path is shorter.
        let along = curvature * turned_rad.cos() / (1.0 - curvature * left_m).max(0.2);
        let sign = if self.speed_mps < 0.0 { -1.0 } else { 1.0 };
        let offset_m = left_m.clamp(-MAX_ERRORS_M[1], MAX_ERRORS_M[1]);
        let wanted = along - sign * GAINS_ACROSS[1] * turned_rad - GAINS_ACROSS[0] * offset_m * sinc;
        self.limited_steering(wanted)
    }

    /// Returns the steering angle (radians) for a curvature (per meter), limited by lateral acceleration and
    /// angle.
    pub(super) fn limited_steering(&self, wanted: f64) -> f64 {
        let limit = MAX_LATERAL_MPS2 / self.speed_mps.powi(2).max(1e-3);
        let wanted = wanted.clamp(-limit, limit);
        (WHEELBASE_M * wanted).atan().clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::route::Route;
    use point_skeleton::dataset::{EgoTrack, Recording};
    use point_skeleton::geometry::Pose;

    fn ego(place: DVec2, heading_rad: f64, speed_mps: f64) -> EgoState {
        let pose = Pose::from_yaw(heading_rad, place.extend(0.0));
        EgoState { pose, speed_mps, acceleration_mps2: 0.0, yaw_rate_radps: 0.0, steering_rad: 0.0 }
    }

    /// Follows a plan for some seconds at 10 Hz.
    fn drive(how: Tracking, start: EgoState, plan: &Trajectory, seconds: usize) -> Vec<Instant> {
        let route = Route::new(&EgoTrack::new(&Recording::default()));
        let instant = |step: usize, ego: EgoState| Instant {
            step,
            t_us: step as i64 * 100_000,
            ego,
            actors: Vec::new(),
            lights: Vec::new(),
        };
        let mut driven = vec![instant(0, start)];
        for step in 1..=seconds * 10 {
            let now = &driven[step - 1];
            let stretch = route.around(0.0, now.ego.position_m());
            let next = follow(how, stretch, now, plan, step as i64 * 100_000);
            driven.push(instant(step, next));
        }
        driven
    }

    /// Returns a left turn around (0, radius), from the origin along x.
    fn circle(radius_m: f64, speed_mps: f64, seconds: i64) -> Trajectory {
        let at = |i: i64| {
            let angle = speed_mps * i as f64 / 10.0 / radius_m;
            let place = DVec2::new(angle.sin(), 1.0 - angle.cos()) * radius_m;
            let heading_rad = wrap_angle(angle);
            Waypoint { t_us: i * 100_000, x_m: place.x, y_m: place.y, heading_rad, speed_mps }
        };
        Trajectory::new(at(0), (1..=seconds * 10).map(at))
    }

    fn assert_within_limits(driven: &[Instant]) {
        for pair in driven.windows(2) {
            let (a, b) = (&pair[0].ego, &pair[1].ego);
            assert!(b.steering_rad.abs() <= MAX_STEERING_RAD);
            assert!((b.steering_rad - a.steering_rad).abs() <= MAX_STEERING_RADPS * 0.1 + 1e-12);
            let rise = (b.speed_mps - a.speed_mps) / 0.1;
            assert!((-MAX_BRAKING_MPS2 - 1e-9..=MAX_ACCELERATION_MPS2 + 1e-9).contains(&rise), "{rise}");
            // No slip: the rear axle moves along the heading.
            let moved = b.position_m() - a.position_m();
            let sideways =
                DVec2::from_angle(a.heading_rad() + wrap_angle(b.heading_rad() - a.heading_rad()) / 2.0);
            assert!(sideways.perp_dot(moved).abs() < 0.02, "{}", sideways.perp_dot(moved));
        }
    }

    #[test]
    fn bicycle_tracks_circles_within_a_decimeter() {
        for (radius_m, speed_mps) in [(8.0, 4.0), (15.0, 6.0), (40.0, 10.0)] {
            // The wheels already have the angle for the bend.
            let steering_rad = (WHEELBASE_M / radius_m).atan();
            let start = EgoState { steering_rad, ..ego(DVec2::ZERO, 0.0, speed_mps) };
            let driven = drive(Tracking::Bicycle, start, &circle(radius_m, speed_mps, 20), 20);
            assert_within_limits(&driven);
            for instant in &driven {
                let off_m = instant.ego.position_m().distance(DVec2::new(0.0, radius_m)) - radius_m;
                assert!(off_m.abs() < 0.1, "{radius_m}: {off_m}");
            }
            let behind = circle(radius_m, speed_mps, 20).at(20_000_000).position_m();
            assert!(driven[200].ego.position_m().distance(behind) < 0.1);
        }
    }

    #[test]
    fn initial_errors_decay() {
        let plan = circle(30.0, 8.0, 20);
        for (place, heading) in [(DVec2::new(-2.0, 1.5), 0.3), (DVec2::new(1.0, -2.0), -0.5)] {
            let driven = drive(Tracking::Bicycle, ego(place, heading, 4.0), &plan, 20);
            assert_within_limits(&driven);
            let end = driven[200].ego.position_m().distance(plan.at(20_000_000).position_m());
            assert!(end < 0.1, "{end}");
        }
    }

    #[test]
    fn impossible_plans_are_limited_and_stops_hold() {
        // A jump of 30 m to the side at full speed, then a sudden stop.
        let at = |t_us: i64, x_m: f64, y_m: f64, speed_mps: f64| Waypoint {
            t_us,
            x_m,
            y_m,
            heading_rad: 0.0,
            speed_mps,
        };
        let wild = Trajectory::new(
            at(0, 0.0, 0.0, 0.0),
            [at(100_000, 5.0, 30.0, 30.0), at(200_000, 5.0, 30.0, 0.0)],
        );
        let driven = drive(Tracking::Bicycle, ego(DVec2::ZERO, 0.0, 5.0), &wild, 10);
        assert_within_limits(&driven);
        assert!(driven.iter().all(|i| i.ego.speed_mps >= 0.0));
    }

    #[test]
    fn perfect_tracking_is_exact() {
        let plan = circle(20.0, 5.0, 3);
        let driven = drive(Tracking::Perfect, ego(DVec2::ZERO, 0.0, 5.0), &plan, 3);
        for (instant, waypoint) in driven.iter().zip(plan.waypoints()) {
            assert_eq!(instant.ego.position_m(), waypoint.position_m());
            assert!(wrap_angle(instant.ego.heading_rad() - waypoint.heading_rad).abs() < 1e-12);
        }
        let last = &driven[30].ego;
        assert!((last.yaw_rate_radps - 0.25).abs() < 1e-9 && last.acceleration_mps2.abs() < 1e-9);
        assert!((last.steering_rad - (WHEELBASE_M / 20.0).atan()).abs() < 1e-9);
    }
}
