use glam::DVec2;
use point_skeleton::geometry::wrap_angle;
use serde::{Deserialize, Serialize};

use crate::state::EgoState;
use crate::time::seconds;

/// Planned pose and speed of the ego at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// Absolute time, microseconds.
    pub t_us: i64,
    /// Global x, meters.
    pub x_m: f64,
    /// Global y, meters.
    pub y_m: f64,
    /// Global yaw, radians.
    pub heading_rad: f64,
    /// Speed along the heading, meters per second.
    pub speed_mps: f64,
}

/// Plan: at least one waypoint, in time order. The first is the ego's state at planning time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trajectory {
    waypoints: Vec<Waypoint>,
}

impl Waypoint {
    /// Returns the ego's state at a time (microseconds) as a waypoint.
    pub fn of(ego: &EgoState, t_us: i64) -> Self {
        let place = ego.position_m();
        let (heading_rad, speed_mps) = (ego.heading_rad(), ego.speed_mps);
        Self { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps }
    }

    /// Returns global x and y, meters.
    pub fn position_m(&self) -> DVec2 {
        DVec2::new(self.x_m, self.y_m)
    }

    /// Interpolates linearly between two waypoints; the heading takes the shorter turn.
    fn between(&self, next: &Self, t_us: i64) -> Self {
        let s = seconds(self.t_us, t_us) / seconds(self.t_us, next.t_us);
        let place = self.position_m().lerp(next.position_m(), s);
        let turn_rad = wrap_angle(next.heading_rad - self.heading_rad);
        Self {
            t_us,
            x_m: place.x,
            y_m: place.y,
            heading_rad: wrap_angle(self.heading_rad + s * turn_rad),
            speed_mps: self.speed_mps + s * (next.speed_mps - self.speed_mps),
        }
    }
}

impl Trajectory {
    /// Creates a plan from the ego's current state and its future waypoints; drops each waypoint that is not
    /// later than its predecessor.
    pub(crate) fn new(now: Waypoint, next: impl IntoIterator<Item = Waypoint>) -> Self {
        let mut waypoints = vec![now];
        for waypoint in next {
            if waypoints.last().is_some_and(|last| waypoint.t_us > last.t_us) {
                waypoints.push(waypoint);
            }
        }
        Self { waypoints }
    }

    /// Returns whether the waypoints satisfy the guarantees of [`Trajectory::new`]: at least one, strictly
    /// increasing times, finite values.
    pub(crate) fn is_valid(&self) -> bool {
        let finite = |w: &Waypoint| [w.x_m, w.y_m, w.heading_rad, w.speed_mps].iter().all(|v| v.is_finite());
        let later = self.waypoints.windows(2).all(|w| w[0].t_us < w[1].t_us);
        !self.waypoints.is_empty() && later && self.waypoints.iter().all(finite)
    }

    /// Returns all waypoints; the first is the ego's state at planning time.
    pub fn waypoints(&self) -> &[Waypoint] {
        &self.waypoints
    }

    /// Returns the waypoint at a time, microseconds. Beyond the last waypoint it extrapolates straight on at
    /// constant speed; before the first it returns the first one's pose.
    pub fn at(&self, t_us: i64) -> Waypoint {
        let next = self.waypoints.partition_point(|w| w.t_us < t_us);
        match (self.waypoints[..next].last(), self.waypoints.get(next)) {
            (_, Some(waypoint)) if waypoint.t_us == t_us => *waypoint,
            (Some(before), Some(after)) => before.between(after, t_us),
            (Some(last), None) => {
                let travelled_m = last.speed_mps * seconds(last.t_us, t_us);
                let place = last.position_m() + DVec2::from_angle(last.heading_rad) * travelled_m;
                Waypoint { t_us, x_m: place.x, y_m: place.y, ..*last }
            }
            (None, _) => Waypoint { t_us, ..self.waypoints[0] },
        }
    }

    /// Returns acceleration (meters per second squared) and curvature (radians per meter) at a time
    /// (microseconds), from the waypoints around it. Both are 0 before the first and from the last waypoint
    /// on.
    pub(crate) fn changes_at(&self, t_us: i64) -> (f64, f64) {
        let next = self.waypoints.partition_point(|w| w.t_us <= t_us);
        let around = next.checked_sub(1).map(|i| &self.waypoints[i]).zip(self.waypoints.get(next));
        let Some((before, after)) = around else { return (0.0, 0.0) };
        let acceleration = (after.speed_mps - before.speed_mps) / seconds(before.t_us, after.t_us);
        let travelled_m = before.position_m().distance(after.position_m());
        // Waypoints at one position do not define a curvature.
        let turn_rad = wrap_angle(after.heading_rad - before.heading_rad);
        let backward = before.speed_mps + after.speed_mps < 0.0;
        let curvature = if travelled_m < 1e-3 {
            0.0
        } else {
            turn_rad / if backward { -travelled_m } else { travelled_m }
        };
        (acceleration, curvature)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waypoint(t_us: i64, x_m: f64, heading_rad: f64, speed_mps: f64) -> Waypoint {
        Waypoint { t_us, x_m, y_m: 7.0, heading_rad, speed_mps }
    }

    #[test]
    fn interpolates_and_extrapolates_waypoints() {
        let next = [waypoint(1_000_000, 4.0, -3.0, 6.0), waypoint(900_000, 9.0, 0.0, 0.0)];
        let plan = Trajectory::new(waypoint(0, 1.0, 3.0, 2.0), next);
        assert_eq!(plan.waypoints().len(), 2);
        assert_eq!(plan.at(0), waypoint(0, 1.0, 3.0, 2.0));
        assert_eq!(plan.at(1_000_000), next[0]);
        let half = plan.at(500_000);
        assert_eq!((half.x_m, half.speed_mps), (2.5, 4.0));
        // The shorter turn passes through pi.
        assert!((half.heading_rad.abs() - std::f64::consts::PI).abs() < 1e-12);
        let beyond = plan.at(3_000_000);
        assert!((beyond.x_m - (4.0 + 12.0 * (-3f64).cos())).abs() < 1e-12 && beyond.speed_mps == 6.0);
        assert_eq!(plan.at(-5), waypoint(-5, 1.0, 3.0, 2.0));
        let (acceleration, curvature) = plan.changes_at(0);
        assert!((acceleration - 4.0).abs() < 1e-12);
        assert!((curvature - (std::f64::consts::TAU - 6.0) / 3.0).abs() < 1e-12);
        assert_eq!(plan.changes_at(1_000_000), (0.0, 0.0));
    }
}
