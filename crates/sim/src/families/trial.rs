//! Two egos in a scenario: one keeps its recorded motion, one brakes by a rule.
//!
//! The rule: the ego keeps its recorded motion. As soon as a body would meet it within 4 s, if both kept
//! their speed and the ego its recorded path, it brakes with 5 m/s² until it stands, and stays there.

use point_skeleton::Log;
use point_skeleton::geometry::{Footprint, Polyline};

use super::course::Course;
use super::family::TRACK;
use crate::recorded::Recorded;
use crate::state::ego_cuboid;
use crate::time::seconds;
use crate::{
    EgoPolicy, EgoState, Instant, Rates, Scenario, SimActor, SimError, SimOptions, Simulation, Waypoint,
};

/// Steps and plans per second.
const HZ: f64 = 10.0;
/// Time within which an ego that keeps its motion collides, seconds.
const COLLIDES_WITHIN_S: f64 = 4.0;
/// Time over which an ego that brakes does not, seconds.
const AVOIDS_FOR_S: f64 = 7.0;
/// Horizon of the rule, its interval, and the distance that it keeps.
const HORIZON_S: f64 = 4.0;
const INTERVAL_S: f64 = 0.1;
const MARGIN_M: f64 = 0.4;
const BRAKING_MPS2: f64 = 5.0;

/// Simulates both egos. Returns the time of the collision (absolute microseconds), or what is wrong.
///
/// # Errors
/// Fails if the log cannot be simulated.
pub(super) fn run(log: &Log, course: &Course) -> Result<Result<i64, &'static str>, SimError> {
    let start_us = course.start_us;
    let kept = collision(log, start_us, false, COLLIDES_WITHIN_S)?;
    let Some(collision_us) = kept else { return Ok(Err("no collision of the recorded ego")) };
    Ok(match collision(log, start_us, true, AVOIDS_FOR_S)? {
        None => Ok(collision_us),
        Some(_) => Err("a collision of an ego that brakes"),
    })
}

/// Returns the time of the collision with the actor (absolute microseconds), of an ego that brakes by the
/// rule or keeps its recorded motion, simulated from a time on.
///
/// # Errors
/// Fails if the log cannot be simulated.
pub(crate) fn collision(log: &Log, start_us: i64, brakes: bool, for_s: f64) -> Result<Option<i64>, SimError> {
    let recording = log.recording();
    let scenario = Scenario { log: recording, map: None, rates: Rates { sim_hz: HZ, plan_hz: HZ } };
    let options = SimOptions {
        steps: (for_s * HZ) as usize,
        sim_hz: Some(HZ),
        plan_hz: Some(HZ),
        start_us: Some(start_us),
        ego: if brakes { EgoPolicy::Caller } else { EgoPolicy::Replay },
        ..SimOptions::default()
    };
    let recorded = Recorded::of(&scenario)?;
    let mut rule = Rule { path: path(&recorded, start_us), way_m: 0.0, is_braking: false };
    let mut simulation = Simulation::new(&scenario, options)?;
    while !simulation.is_done() {
        if simulation.needs_plan() {
            let next_us = simulation.next_us();
            let recorded = simulation.recorded_waypoint(next_us);
            let plan = rule.plan(simulation.committed().get(), next_us, recorded);
            simulation.follow_waypoints(vec![plan])?;
        }
        simulation.step()?;
        let collisions = simulation.metrics().collisions;
        if let Some(met) = collisions.iter().find(|collision| collision.track == TRACK) {
            return Ok(Some(met.t_us));
        }
    }
    Ok(None)
}

/// Returns the ego's recorded path from a time on; `None` if it stands.
fn path(recorded: &Recorded<'_>, start_us: i64) -> Option<Polyline> {
    let times_us = (start_us..=recorded.last_us).step_by(100_000);
    let mut points = Vec::new();
    for ego in times_us.filter_map(|t_us| recorded.ego_at(t_us)) {
        // Shorter steps have the direction of noise.
        if points.last().is_none_or(|last| ego.position_m().distance(*last) > 0.5) {
            points.push(ego.position_m());
        }
    }
    Polyline::new(points)
}

/// Ego that brakes.
struct Rule {
    path: Option<Polyline>,
    /// Along the path, meters.
    way_m: f64,
    is_braking: bool,
}

impl Rule {
    /// Returns the plan for the next step, absolute microseconds; `recorded` is the log's.
    fn plan(&mut self, now: &Instant, next_us: i64, recorded: Option<Waypoint>) -> Waypoint {
        let ego = now.ego;
        self.is_braking |= self.is_in_danger(&ego, &now.actors);
        if let (false, Some(recorded)) = (self.is_braking, recorded) {
            let station_m = self.path.as_ref().map(|path| path.nearest(recorded.position_m()).0);
            self.way_m = station_m.unwrap_or(self.way_m);
            return recorded;
        }
        let dt_s = seconds(now.t_us, next_us);
        let after_mps = (ego.speed_mps - BRAKING_MPS2 * dt_s).max(0.0);
        self.way_m += (ego.speed_mps.max(0.0) + after_mps) / 2.0 * dt_s;
        let next = EgoState { speed_mps: after_mps, ..self.at(&ego, self.way_m) };
        Waypoint::of(&next, next_us)
    }

    /// Returns the ego at a position of the path, meters.
    fn at(&self, ego: &EgoState, way_m: f64) -> EgoState {
        let Some(path) = &self.path else { return *ego };
        let (place, direction) = path.at(way_m);
        let height_m = ego.pose.translation.z;
        let pose = point_skeleton::geometry::Pose::from_yaw(direction.to_angle(), place.extend(height_m));
        EgoState { pose, ..*ego }
    }

    fn is_in_danger(&self, ego: &EgoState, actors: &[SimActor]) -> bool {
        let steps = (HORIZON_S / INTERVAL_S) as usize;
        (0..=steps).any(|step| {
            let t_s = step as f64 * INTERVAL_S;
            let there = self.at(ego, self.way_m + ego.speed_mps.max(0.0) * t_s);
            let body = Footprint::from(&ego_cuboid(&there.pose)).grown(MARGIN_M);
            actors.iter().any(|actor| {
                let other = Footprint::from(&actor.cuboid);
                let other = Footprint { center: other.center + actor.velocity_mps() * t_s, ..other };
                body.center.distance(other.center) <= body.radius_m() + other.radius_m()
                    && body.overlaps(&other)
            })
        })
    }
}
