//! Constant speed and curve, and brakes for what is in front.

use glam::DVec2;

use super::leader::{Leader, Others};
use crate::geometry::{Cuboid, Polyline};
use crate::sim::SimActor;
use crate::sim::recorded::Recorded;

/// Gap that is kept to what is in front, metres.
const SAFE_GAP_M: f64 = 2.0;
/// Hardest braking.
const MAX_BRAKING_MPS2: f64 = 6.0;
/// Braking begins once this much is needed.
const BRAKING_MPS2: f64 = 2.0;
/// With which the speed is taken up again where nothing is in front.
const ACCELERATION_MPS2: f64 = 1.0;
/// What must be free in front before, beyond the safe gap.
const RESUME_GAP_M: f64 = 1.0;
const RESUME_HEADWAY_S: f64 = 1.5;
/// Slower ones stand: the rest is noise of their boxes.
const STANDING_MPS: f64 = 0.2;
/// Sharper curves than this (per metre) are noise of boxes that hardly move.
const MAX_CURVATURE: f64 = 0.2;
/// Between points of the way ahead, metres.
const STEP_M: f64 = 1.0;
/// How far the way ahead is curved, metres; then it is straight.
const CURVED_M: f64 = 40.0;

/// An actor that goes on as it was when it was taken over.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(in crate::sim) struct Cruiser {
    /// Along its heading when it was taken over, metres per second.
    pub(in crate::sim) cruise_mps: f64,
    /// Of its way to the left, per metre along its heading.
    pub(in crate::sim) curvature: f64,
}

impl Cruiser {
    /// With speed and yaw rate as recorded at a time, microseconds.
    pub(super) fn join(recorded: &Recorded<'_>, actor: &SimActor, t_us: i64) -> Self {
        let (speed_mps, yaw_rate_radps) = recorded.actor_motion(actor.track, t_us);
        if speed_mps.abs() < STANDING_MPS {
            return Self { cruise_mps: 0.0, curvature: 0.0 };
        }
        let curvature = (yaw_rate_radps / speed_mps).clamp(-MAX_CURVATURE, MAX_CURVATURE);
        Self { cruise_mps: speed_mps, curvature }
    }

    /// Moves on.
    pub(super) fn step(&mut self, actor: &SimActor, others: &Others, dt_s: f64) -> SimActor {
        if self.cruise_mps == 0.0 {
            return SimActor { speed_mps: 0.0, ..*actor };
        }
        let (pose, size) = (actor.cuboid.pose, actor.cuboid.size);
        let sign = self.cruise_mps.signum();
        let leader = self
            .way_ahead(pose.translation.truncate(), pose.yaw_rad())
            .and_then(|way| others.leader(actor.track, &way, size.x / 2.0, size.y));
        let speed_mps = (sign * actor.speed_mps).max(0.0);
        let rise = acceleration_mps2(speed_mps, self.cruise_mps.abs(), leader, dt_s);
        let next_mps = (speed_mps + rise * dt_s).clamp(0.0, self.cruise_mps.abs().max(speed_mps));
        let way_m = sign * (speed_mps + next_mps) / 2.0 * dt_s;
        // An arc is its chord with the yaw halfway.
        let turn_rad = self.curvature * way_m;
        let yaw_rad = pose.yaw_rad() + turn_rad / 2.0;
        let chord_m = if turn_rad == 0.0 { way_m } else { way_m * (turn_rad / 2.0).sin() / (turn_rad / 2.0) };
        let mut moved = pose.with_yaw(pose.yaw_rad() + turn_rad);
        moved.translation += (DVec2::from_angle(yaw_rad) * chord_m).extend(0.0);
        let cuboid = Cuboid { pose: moved, size };
        SimActor { track: actor.track, cuboid, speed_mps: sign * next_mps }
    }

    /// Its way from where it is.
    fn way_ahead(&self, from: DVec2, yaw_rad: f64) -> Option<Polyline> {
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

/// At a speed and with another to go back to, metres per second.
fn acceleration_mps2(speed_mps: f64, cruise_mps: f64, leader: Option<Leader>, dt_s: f64) -> f64 {
    let back = ((cruise_mps - speed_mps) / dt_s).clamp(0.0, ACCELERATION_MPS2);
    let Some(leader) = leader else { return back };
    let closing = speed_mps.powi(2) - leader.speed_mps.max(0.0).powi(2);
    let room_m = leader.gap_m - SAFE_GAP_M;
    // By when this step is over, some of the room is used up.
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
