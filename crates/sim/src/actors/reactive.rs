//! Motion at constant speed and curvature with braking for obstacles ahead.

use glam::DVec2;
use point_skeleton::geometry::{Cuboid, Polyline};
use point_skeleton::idm::Leader;

use super::leader::Others;
use crate::SimActor;
use crate::recorded::{ActorMotion, Recorded};

/// Minimum gap to a leader, meters.
const SAFE_GAP_M: f64 = 2.0;
/// Maximum braking.
const MAX_BRAKING_MPS2: f64 = 6.0;
/// Required deceleration at which braking begins.
const BRAKING_MPS2: f64 = 2.0;
/// Acceleration back to the cruise speed on a free path.
const ACCELERATION_MPS2: f64 = 1.0;
/// Additional gap beyond the safe gap, required before accelerating again.
const RESUME_GAP_M: f64 = 1.0;
const RESUME_HEADWAY_S: f64 = 1.5;
/// Slower actors are treated as standing: smaller speeds are noise of their boxes.
const STANDING_MPS: f64 = 0.2;
/// Sharper curvatures (per meter) are noise of boxes that hardly move.
const MAX_CURVATURE: f64 = 0.2;
/// Distance between points of the path ahead, meters.
const STEP_M: f64 = 1.0;
/// Length of the curved part of the path ahead, meters; beyond it the path is straight.
const CURVED_M: f64 = 40.0;

/// Actor that maintains its speed and curvature at the takeover.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct ReactiveActor {
    /// Speed along its heading at the takeover, meters per second.
    pub(crate) cruise_mps: f64,
    /// Curvature to the left, radians per meter along the heading.
    pub(crate) curvature: f64,
}

impl ReactiveActor {
    /// Uses the recorded speed and yaw rate at a time, microseconds.
    pub(super) fn join(recorded: &Recorded<'_>, actor: &SimActor, t_us: i64) -> Self {
        let ActorMotion { speed_mps, yaw_rate_radps, .. } = recorded.actor_motion(actor.track, t_us);
        if speed_mps.abs() < STANDING_MPS {
            return Self { cruise_mps: 0.0, curvature: 0.0 };
        }
        let curvature = (yaw_rate_radps / speed_mps).clamp(-MAX_CURVATURE, MAX_CURVATURE);
        Self { cruise_mps: speed_mps, curvature }
    }

    /// Advances the actor by one step.
    pub(super) fn step(&mut self, actor: &SimActor, others: &Others, dt_s: f64) -> SimActor {
        if self.cruise_mps == 0.0 {
            return SimActor { speed_mps: 0.0, lateral_mps: 0.0, yaw_rate_radps: 0.0, ..*actor };
        }
        let (pose, size) = (actor.cuboid.pose, actor.cuboid.size);
        let sign = self.cruise_mps.signum();
        let leader = self
            .path_ahead(pose.translation.truncate(), pose.yaw_rad())
            .and_then(|path| others.leader(actor.track, &path, size.x / 2.0, size.y));
        let speed_mps = (sign * actor.speed_mps).max(0.0);
        let rise = acceleration_mps2(speed_mps, self.cruise_mps.abs(), leader, dt_s);
        let next_mps = (speed_mps + rise * dt_s).clamp(0.0, self.cruise_mps.abs().max(speed_mps));
        let travelled_m = sign * (speed_mps + next_mps) / 2.0 * dt_s;
        // An arc's chord points along the yaw at its middle.
        let turn_rad = self.curvature * travelled_m;
        let yaw_rad = pose.yaw_rad() + turn_rad / 2.0;
        let chord_m = if turn_rad == 0.0 {
            travelled_m
        } else {
            travelled_m * (turn_rad / 2.0).sin() / (turn_rad / 2.0)
        };
        let mut moved = pose.with_yaw(pose.yaw_rad() + turn_rad);
        moved.translation += (DVec2::from_angle(yaw_rad) * chord_m).extend(0.0);
        let cuboid = Cuboid { pose: moved, size };
        let yaw_rate_radps = turn_rad / dt_s;
        SimActor { track: actor.track, cuboid, speed_mps: sign * next_mps, lateral_mps: 0.0, yaw_rate_radps }
    }

    /// Returns the path ahead from the current position.
    fn path_ahead(&self, from: DVec2, yaw_rad: f64) -> Option<Polyline> {
        let step_m = self.cruise_mps.signum() * STEP_M;
        let count = (CURVED_M / STEP_M) as usize;
        let mut at = from;
        let rest = (0..count).map(|i| {
            at += DVec2::from_angle(yaw_rad + self.curvature * step_m * (i as f64 + 0.5)) * step_m;
            at
        });
        Polyline::new(std::iter::once(from).chain(rest))
    }
}

/// Returns the acceleration at a speed with a cruise speed to return to, both meters per second.
fn acceleration_mps2(speed_mps: f64, cruise_mps: f64, leader: Option<Leader>, dt_s: f64) -> f64 {
    let back = ((cruise_mps - speed_mps) / dt_s).clamp(0.0, ACCELERATION_MPS2);
    let Some(leader) = leader else { return back };
    let closing = speed_mps.powi(2) - leader.speed_mps.max(0.0).powi(2);
    let room_m = leader.gap_m - SAFE_GAP_M;
    // The motion of this step uses up part of the room.
    let left_m = room_m - speed_mps * dt_s;
    let needed = if closing <= 0.0 {
        0.0
    } else if left_m <= 0.0 {
        f64::INFINITY
    } else {
        closing / (2.0 * left_m)
    };
    if needed >= BRAKING_MPS2 {
        return -needed.min(MAX_BRAKING_MPS2);
    }
    if room_m > RESUME_GAP_M + RESUME_HEADWAY_S * speed_mps { back } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::collision::tests::{actor, instant};

    /// Simulates a cruising car among others for some seconds at 10 Hz, with the ego far away.
    fn drive(
        mut cruiser: ReactiveActor,
        start: SimActor,
        others: &[SimActor],
        seconds: usize,
    ) -> Vec<SimActor> {
        let mut now = instant(0.0, &[]);
        now.ego.pose.translation.y = 1e4;
        let mut driven = vec![start];
        for i in 0..seconds * 10 {
            now.actors = [&[driven[i]], others].concat();
            let next = cruiser.step(&driven[i], &Others::new(&now), 0.1);
            driven.push(next);
        }
        driven
    }

    #[test]
    fn constant_curvature_drives_circles() {
        let cruiser = ReactiveActor { cruise_mps: 5.0, curvature: 0.05 };
        let driven = drive(cruiser, actor(0, 0.0, 0.0, 0.0, 5.0), &[], 30);
        for at in &driven {
            let place = at.cuboid.pose.translation.truncate();
            assert!((place.distance(DVec2::new(0.0, 20.0)) - 20.0).abs() < 1e-9);
            assert_eq!(at.speed_mps, 5.0);
        }
        let angle = point_skeleton::geometry::wrap_angle(5.0 * 30.0 * 0.05);
        assert!((driven[300].cuboid.pose.yaw_rad() - angle).abs() < 1e-9);
    }

    #[test]
    fn stops_two_meters_before_obstacles() {
        for speed in [3.0, 8.0, 15.0] {
            let cruiser = ReactiveActor { cruise_mps: speed, curvature: 0.0 };
            let wall = actor(1, 80.0, 0.0, 0.0, 0.0);
            let driven = drive(cruiser, actor(0, 0.0, 0.0, 0.0, speed), &[wall], 40);
            for pair in driven.windows(2) {
                let rise = (pair[1].speed_mps - pair[0].speed_mps) / 0.1;
                assert!((-6.0 - 1e-9..=1.0 + 1e-9).contains(&rise), "{rise}");
                let gap = 76.0 - pair[1].cuboid.pose.translation.x;
                assert!(gap > 1.99, "{gap}");
            }
            let end = driven[400];
            assert!(end.speed_mps == 0.0 && 76.0 - end.cuboid.pose.translation.x < 4.0, "{end:?}");
        }
    }

    #[test]
    fn returns_to_cruise_speed() {
        let cruiser = ReactiveActor { cruise_mps: 8.0, curvature: 0.0 };
        let slowed = drive(cruiser, actor(0, 0.0, 0.0, 0.0, 2.0), &[], 10);
        assert!((slowed[30].speed_mps - 5.0).abs() < 1e-9 && slowed[100].speed_mps == 8.0);
        // Backward it brakes for obstacles behind.
        let back = ReactiveActor { cruise_mps: -2.0, curvature: 0.0 };
        let driven = drive(back, actor(0, 0.0, 0.0, 0.0, -2.0), &[actor(1, -20.0, 0.0, 0.0, 0.0)], 20);
        let x = driven[200].cuboid.pose.translation.x;
        assert!(driven[200].speed_mps == 0.0 && (-14.01..-12.0).contains(&x), "{x}");
    }

    #[test]
    fn parked_actors_stay_parked() {
        let parked = actor(0, 3.0, 1.0, 0.4, 0.1);
        let driven = drive(ReactiveActor { cruise_mps: 0.0, curvature: 0.0 }, parked, &[], 3);
        assert_eq!(driven[30].cuboid, parked.cuboid);
    }
}
