//! Answer of the planner to an observation.

use glam::DVec2;
use point_skeleton::geometry::wrap_angle;
use serde::Deserialize;

use super::unreadable::unreadable;
use crate::peer::ProtocolError;
use crate::time::seconds;
use crate::{Instant, Trajectory, Waypoint};

/// Maximum speed between waypoints and at waypoints, meters per second; larger values are rejected.
const MAX_SPEED_MPS: f64 = 100.0;
const MAX_WAYPOINTS: usize = 10_000;
/// Maximum time of a waypoint, seconds; larger values are rejected, as they are probably microseconds.
const MAX_TIME_S: f64 = 3600.0;

#[derive(Deserialize)]
struct PlanAnswer {
    step: Option<usize>,
    #[serde(default)]
    frame: Frame,
    trajectory: Vec<PlannedPoint>,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Frame {
    #[default]
    Global,
    Ego,
}

#[derive(Clone, Copy, Deserialize)]
struct PlannedPoint {
    t: f64,
    x: f64,
    y: f64,
    heading: f64,
    v: f64,
}

/// Validates the reply to an observation; the plan must extend to `due_us`, the time of the next one
/// (microseconds).
pub(crate) fn read_plan(answer: &[u8], now: &Instant, due_us: i64) -> Result<Trajectory, ProtocolError> {
    let expected = "{\"trajectory\": [{\"t\", \"x\", \"y\", \"heading\", \"v\"}, ..]}";
    let plan: PlanAnswer =
        serde_json::from_slice(answer).map_err(|e| ProtocolError::new(expected, unreadable(answer, &e)))?;
    if let Some(step) = plan.step.filter(|step| *step != now.step) {
        return Err(ProtocolError::new(
            format!("an answer to step {}", now.step),
            format!("one to step {step}"),
        ));
    }
    let points = plan.trajectory;
    check_count(points.len())?;
    let start = Waypoint::of(&now.ego, now.t_us);
    let next = points.iter().enumerate().map(|(i, point)| placed(point, plan.frame, &start, i));
    joined(start, next, due_us)
}

/// Validates waypoints (global frame) as [`read_plan`] does and returns them unchanged as a plan.
pub(crate) fn plan_of(next: &[Waypoint], now: &Instant, due_us: i64) -> Result<Trajectory, ProtocolError> {
    let start = Waypoint::of(&now.ego, now.t_us);
    check_count(next.len())?;
    let sound = |(i, w): (usize, &Waypoint)| {
        let (t, x, y, heading, v) = (seconds(start.t_us, w.t_us), w.x_m, w.y_m, w.heading_rad, w.speed_mps);
        check_point(&PlannedPoint { t, x, y, heading, v }, i).map(|()| *w)
    };
    joined(start, next.iter().enumerate().map(sound), due_us)
}

fn check_count(found: usize) -> Result<(), ProtocolError> {
    if found == 0 || found > MAX_WAYPOINTS {
        return Err(ProtocolError::new(format!("1 to {MAX_WAYPOINTS} waypoints"), found.to_string()));
    }
    Ok(())
}

/// Validates times and distances of waypoints after a start, and joins them to a plan.
fn joined(
    start: Waypoint,
    points: impl Iterator<Item = Result<Waypoint, ProtocolError>>,
    due_us: i64,
) -> Result<Trajectory, ProtocolError> {
    let mut next: Vec<Waypoint> = Vec::new();
    for (i, point) in points.enumerate() {
        let to = point?;
        let before = next.last().unwrap_or(&start);
        // A first waypoint at the time of the observation repeats the known ego state.
        if i == 0 && to.t_us == start.t_us {
            continue;
        }
        if to.t_us <= before.t_us {
            let found = format!("{} s at waypoint {i}", seconds(start.t_us, to.t_us));
            return Err(ProtocolError::new("times that rise from over 0 s", found));
        }
        let speed_mps = before.position_m().distance(to.position_m()) / seconds(before.t_us, to.t_us);
        if speed_mps > MAX_SPEED_MPS {
            let found = format!("a jump at {speed_mps:.0} m/s to waypoint {i}");
            return Err(ProtocolError::new(format!("waypoints at most {MAX_SPEED_MPS} m/s apart"), found));
        }
        next.push(to);
    }
    let end_us = next.last().map_or(start.t_us, |last| last.t_us);
    if end_us < due_us {
        let found = format!("one of {} s", seconds(start.t_us, end_us));
        let expected = format!("a trajectory of at least {} s", seconds(start.t_us, due_us));
        return Err(ProtocolError::new(expected, found));
    }
    Ok(Trajectory::new(start, next))
}

/// Validates a planned point and converts it to the global frame.
fn placed(
    point: &PlannedPoint,
    frame: Frame,
    start: &Waypoint,
    index: usize,
) -> Result<Waypoint, ProtocolError> {
    check_point(point, index)?;
    let PlannedPoint { t, x, y, heading, v } = *point;
    let (place, heading_rad) = match frame {
        Frame::Global => (DVec2::new(x, y), heading),
        Frame::Ego => {
            let forward = DVec2::from_angle(start.heading_rad);
            (start.position_m() + forward * x + forward.perp() * y, start.heading_rad + heading)
        }
    };
    // Rounding can map a time just after the observation to the observation's own time, but never a required
    // later one.
    let t_us = start.t_us.saturating_add((t * 1e6).round() as i64);
    let heading_rad = wrap_angle(heading_rad);
    Ok(Waypoint { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps: v })
}

fn check_point(point: &PlannedPoint, index: usize) -> Result<(), ProtocolError> {
    let PlannedPoint { t, x, y, heading, v } = *point;
    let sound = (0.0..=MAX_TIME_S).contains(&t)
        && [x, y, heading].iter().all(|n| n.is_finite())
        && v.abs() <= MAX_SPEED_MPS;
    if !sound {
        let expected = format!("finite numbers, t from 0 to {MAX_TIME_S} s, v up to {MAX_SPEED_MPS} m/s");
        let found = format!("t {t}, x {x}, y {y}, heading {heading}, v {v} at waypoint {index}");
        return Err(ProtocolError::new(expected, found));
    }
    Ok(())
}
