//! Intelligent Driver Model along recorded paths.

use std::sync::Arc;

use glam::DVec2;
use point_skeleton::dataset::Triggers;
use point_skeleton::geometry::{Cuboid, Pose, wrap_angle};
use point_skeleton::idm::{Idm, Leader};

use super::leader::Others;
use crate::SimActor;
use crate::path::pose_path::PosePath;
use crate::recorded::Recorded;

/// Parameters as in nuPlan.
const IDM: Idm = Idm {
    desired_mps: 10.0,
    acceleration_mps2: 1.0,
    braking_mps2: 2.0,
    headway_s: 1.5,
    min_gap_m: 1.0,
    gap_floor_m: 1.0,
    keeps_min_gap: false,
};
/// Minimum distance between points of a path, meters: smaller motion is the noise of a standing actor's
/// boxes.
const KNOT_STEP_M: f64 = 0.5;
/// An actor is parked if it later moves less than this in total and is slower than `PARKED_MPS` now.
const PARKED_M: f64 = 1.0;
const PARKED_MPS: f64 = 1.0;

/// Actor that follows its recorded path.
#[derive(Clone, Debug)]
pub(crate) struct Follower {
    /// Time of the takeover from the log, absolute microseconds; the path begins there.
    pub(crate) joined_us: i64,
    /// Position of the box's center along the path, meters.
    pub(crate) way_m: f64,
    /// Speed along the path, meters per second.
    pub(crate) speed_mps: f64,
    path: Arc<PosePath>,
    /// 1, or -1 for an actor recorded as driving backward.
    sign: f64,
}

impl Follower {
    /// Creates a follower of an actor's recorded or scripted boxes from a time (microseconds) on; `None` for
    /// a parked actor, which stays on the log.
    pub(super) fn join(
        recorded: &Recorded<'_>,
        actor: &SimActor,
        t_us: i64,
        triggers: &Triggers,
    ) -> Option<Self> {
        let later = recorded.boxes_after(actor.track, t_us, triggers).into_iter().map(|cuboid| cuboid.pose);
        let sizes = recorded.log.script.sizes_at(actor.track, t_us, triggers);
        let first = sizes.map_or(actor.cuboid, |[of_path, _]| actor.cuboid.resized(of_path));
        let mut poses = vec![first.pose];
        let place = |pose: &Pose| pose.translation.truncate();
        for pose in later.filter(|pose| pose.translation.is_finite()) {
            if poses.last().is_some_and(|last| place(last).distance(place(&pose)) >= KNOT_STEP_M) {
                poses.push(pose);
            }
        }
        let length_m: f64 = poses.windows(2).map(|w| place(&w[0]).distance(place(&w[1]))).sum();
        if length_m < PARKED_M && actor.speed_mps.abs() < PARKED_MPS {
            return None;
        }
        let heading = |pose: &Pose| DVec2::from_angle(pose.yaw_rad());
        let sign = match &poses[..] {
            [first, second, ..] if heading(first).dot(place(second) - place(first)) < 0.0 => -1.0,
            [_] if actor.speed_mps < 0.0 => -1.0,
            _ => 1.0,
        };
        // Beyond the last box the path follows that box's heading; the direction between the last two boxes
        // is noisy.
        let last = poses[poses.len() - 1];
        poses.push(Pose { translation: last.translation + (heading(&last) * sign).extend(0.0), ..last });
        let speed_mps = (sign * actor.speed_mps).max(0.0);
        let path = Arc::new(PosePath::new(poses)?);
        Some(Self { joined_us: t_us, way_m: 0.0, speed_mps, path, sign })
    }

    /// Moves the follower to a position (meters) on its path with a speed (meters per second); `None` if
    /// either is negative.
    pub(super) fn placed(self, way_m: f64, speed_mps: f64) -> Option<Self> {
        let is_sound = way_m >= 0.0 && speed_mps >= 0.0;
        is_sound.then_some(Self { way_m, speed_mps, ..self })
    }

    /// Advances the actor by one step.
    pub(super) fn step(&mut self, actor: &SimActor, others: &Others, dt_s: f64) -> SimActor {
        let size = actor.cuboid.size;
        let leader = others.leader(actor.track, self.path.line(), self.way_m + size.x / 2.0, size.y);
        let (way_m, speed_mps) = idm_step((self.way_m, self.speed_mps), leader, dt_s);
        // The model itself would drive backward in front of an obstacle.
        (self.way_m, self.speed_mps) = (way_m, speed_mps.max(0.0));
        let cuboid = Cuboid { pose: self.path.at(self.way_m), size };
        let turn_rad = wrap_angle(cuboid.pose.yaw_rad() - actor.cuboid.pose.yaw_rad());
        SimActor {
            track: actor.track,
            cuboid,
            speed_mps: self.sign * self.speed_mps,
            lateral_mps: 0.0,
            yaw_rate_radps: turn_rad / dt_s,
        }
    }
}

/// Advances position (meters) and speed (meters per second) by one forward Euler step of the Intelligent
/// Driver Model, as in nuPlan. The speed may become negative. The acceleration is limited to -2 to 1 m/s²;
/// gaps below 1 m count as 1 m.
pub fn idm_step((way_m, speed_mps): (f64, f64), leader: Option<Leader>, dt_s: f64) -> (f64, f64) {
    let rise = IDM.acceleration_mps2(speed_mps, leader).clamp(-IDM.braking_mps2, IDM.acceleration_mps2);
    (way_m + dt_s * speed_mps, speed_mps + dt_s * rise)
}
