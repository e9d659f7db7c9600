use std::path::PathBuf;

use glam::{DVec2, DVec3};
use point_skeleton::dataset::{Class, TrafficLight};
use point_skeleton::geometry::{Foot, wrap_angle};
use serde::{Deserialize, Serialize};

use crate::clock::Clock;
use crate::peer::{ProtocolError, begin_of};
use crate::recorded::Recorded;
use crate::time::seconds;
use crate::world::World;
use crate::{
    EGO_SIZE_M, Instant, REAR_AXLE_TO_CENTER_M, SimActor, SimOptions, Trajectory, WHEELBASE_M, Waypoint,
};

const PROTOCOL: &str = "pskel-planner";
const VERSION: u32 = 1;
/// Length of the recorded path sent to a planner, and the spacing of its points, meters.
const AHEAD_M: f64 = 100.0;
const AHEAD_STEP_M: f64 = 1.0;
/// Maximum speed between waypoints and at waypoints, meters per second; larger values are rejected.
const MAX_SPEED_MPS: f64 = 100.0;
const MAX_WAYPOINTS: usize = 10_000;
/// Maximum time of a waypoint, seconds; larger values are rejected, as they are probably microseconds.
const MAX_TIME_S: f64 = 3600.0;

/// First message to the planner.
#[derive(Serialize)]
pub(super) struct Hello<'a> {
    protocol: &'static str,
    version: u32,
    log: &'a str,
    seed: u64,
    sim_hz: f64,
    plan_hz: f64,
    step: usize,
    ego: EgoSize,
}

#[derive(Serialize)]
struct EgoSize {
    length: f64,
    width: f64,
    height: f64,
    rear_axle_to_center: f64,
    wheelbase: f64,
}

/// Message sent at each planning step.
#[derive(Serialize)]
pub(crate) struct Observation<'a> {
    r#type: &'static str,
    step: usize,
    t_us: i64,
    /// Seconds to the next observation; the plan must extend at least that far.
    plan_dt: f64,
    ego: Ego,
    actors: Vec<Actor<'a>>,
    lights: Vec<Light<'a>>,
    path: Vec<[f64; 2]>,
    files: Vec<PathBuf>,
}

#[derive(Serialize)]
struct Ego {
    x: f64,
    y: f64,
    z: f64,
    heading: f64,
    v: f64,
    a: f64,
    yaw_rate: f64,
    steering: f64,
}

#[derive(Serialize)]
struct Actor<'a> {
    track: &'a str,
    category: &'a str,
    class: Class,
    x: f64,
    y: f64,
    z: f64,
    heading: f64,
    length: f64,
    width: f64,
    height: f64,
    v: f64,
}

#[derive(Serialize)]
struct Light<'a> {
    lane_connector: &'a str,
    color: &'a str,
}

#[derive(Deserialize)]
struct HelloAnswer {
    protocol: String,
    version: u32,
}

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

impl<'a> Hello<'a> {
    pub(super) fn new(options: &SimOptions, clock: &Clock, log: &'a str, step: usize) -> Self {
        let size = EGO_SIZE_M;
        let ego = EgoSize {
            length: size.x,
            width: size.y,
            height: size.z,
            rear_axle_to_center: REAR_AXLE_TO_CENTER_M,
            wheelbase: WHEELBASE_M,
        };
        let (sim_hz, plan_hz) = (clock.rates.sim_hz, clock.rates.plan_hz);
        Self { protocol: PROTOCOL, version: VERSION, log, seed: options.seed, sim_hz, plan_hz, step, ego }
    }
}

impl<'a> Observation<'a> {
    pub(crate) fn new(
        recorded: &'a Recorded<'_>,
        clock: &Clock,
        world: &'a World,
        files: Vec<PathBuf>,
    ) -> Self {
        let now = &world.instant;
        let (ego, at) = (&now.ego, now.ego.pose.translation);
        let light =
            |light: &'a TrafficLight| Light { lane_connector: &light.lane_connector, color: &light.color };
        Self {
            r#type: "observation",
            step: now.step,
            t_us: now.t_us,
            plan_dt: seconds(now.t_us, clock.at(now.step + clock.steps_per_plan)),
            ego: Ego {
                x: at.x,
                y: at.y,
                z: at.z,
                heading: ego.heading_rad(),
                v: ego.speed_mps,
                a: ego.acceleration_mps2,
                yaw_rate: ego.yaw_rate_radps,
                steering: ego.steering_rad,
            },
            actors: now.actors.iter().map(|actor| told(recorded, actor)).collect(),
            lights: now.lights.iter().map(light).collect(),
            path: path_ahead(recorded, world.foot),
            files,
        }
    }
}

fn told<'a>(recorded: &'a Recorded<'_>, actor: &SimActor) -> Actor<'a> {
    let track = &recorded.log.tracks[actor.track];
    let (at, size): (DVec3, DVec3) = (actor.cuboid.pose.translation, actor.cuboid.size);
    Actor {
        track: &track.id,
        category: &track.category,
        class: track.class,
        x: at.x,
        y: at.y,
        z: at.z,
        heading: actor.cuboid.pose.yaw_rad(),
        length: size.x,
        width: size.y,
        height: size.z,
        v: actor.speed_mps,
    }
}

/// Returns the recorded path ahead of the ego's projection, global meters; empty if the ego never moved.
fn path_ahead(recorded: &Recorded<'_>, ego: Foot) -> Vec<[f64; 2]> {
    let Some(line) = recorded.route.line() else { return Vec::new() };
    let from_m = ego.station_m.clamp(0.0, line.length_m());
    let to_m = (from_m + AHEAD_M).min(line.length_m());
    let count = ((to_m - from_m) / AHEAD_STEP_M).floor() as usize;
    let inner = (0..=count).map(|i| from_m + i as f64 * AHEAD_STEP_M);
    let end = Some(to_m).filter(|to_m| to_m - (from_m + count as f64 * AHEAD_STEP_M) > 1e-6);
    inner.chain(end).map(|station_m| line.at(station_m).0.to_array()).collect()
}

/// Validates the reply to the hello message.
pub(super) fn read_hello(answer: &[u8]) -> Result<(), ProtocolError> {
    let expected = format!("{{\"protocol\": \"{PROTOCOL}\", \"version\": {VERSION}}}");
    let hello: HelloAnswer = serde_json::from_slice(answer)
        .map_err(|e| ProtocolError::new(expected.clone(), shown(answer, &e)))?;
    if (hello.protocol.as_str(), hello.version) == (PROTOCOL, VERSION) {
        return Ok(());
    }
    Err(ProtocolError::new(expected, format!("{:?} of version {}", hello.protocol, hello.version)))
}

/// Validates the reply to an observation; the plan must extend to `due_us`, the time of the next one (microseconds).
pub(crate) fn read_plan(answer: &[u8], now: &Instant, due_us: i64) -> Result<Trajectory, ProtocolError> {
    let expected = "{\"trajectory\": [{\"t\", \"x\", \"y\", \"heading\", \"v\"}, ..]}";
    let plan: PlanAnswer =
        serde_json::from_slice(answer).map_err(|e| ProtocolError::new(expected, shown(answer, &e)))?;
    if let Some(step) = plan.step.filter(|step| *step != now.step) {
        return Err(ProtocolError::new(
            format!("an answer to step {}", now.step),
            format!("one to step {step}"),
        ));
    }
    let points = plan.trajectory;
    if points.is_empty() || points.len() > MAX_WAYPOINTS {
        return Err(ProtocolError::new(format!("1 to {MAX_WAYPOINTS} waypoints"), points.len().to_string()));
    }
    let start = Waypoint::of(&now.ego, now.t_us);
    let mut next: Vec<Waypoint> = Vec::with_capacity(points.len());
    for (i, point) in points.iter().enumerate() {
        let to = placed(point, plan.frame, &start, i)?;
        let before = next.last().unwrap_or(&start);
        // A first waypoint at the time of the observation repeats the known ego state.
        if i == 0 && to.t_us == start.t_us {
            continue;
        }
        if to.t_us <= before.t_us {
            let found = format!("{} s at waypoint {i}", point.t);
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
    let PlannedPoint { t, x, y, heading, v } = *point;
    let sound = (0.0..=MAX_TIME_S).contains(&t)
        && [x, y, heading].iter().all(|n| n.is_finite())
        && v.abs() <= MAX_SPEED_MPS;
    if !sound {
        let expected = format!("finite numbers, t from 0 to {MAX_TIME_S} s, v up to {MAX_SPEED_MPS} m/s");
        let found = format!("t {t}, x {x}, y {y}, heading {heading}, v {v} at waypoint {index}");
        return Err(ProtocolError::new(expected, found));
    }
    let (place, heading_rad) = match frame {
        Frame::Global => (DVec2::new(x, y), heading),
        Frame::Ego => {
            let forward = DVec2::from_angle(start.heading_rad);
            (start.position_m() + forward * x + forward.perp() * y, start.heading_rad + heading)
        }
    };
    // Rounding can map a time just after the observation to the observation's own time, but never a required later
    // one.
    let t_us = start.t_us.saturating_add((t * 1e6).round() as i64);
    let heading_rad = wrap_angle(heading_rad);
    Ok(Waypoint { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps: v })
}

/// Formats a parse error with the beginning of the reply.
fn shown(answer: &[u8], error: &serde_json::Error) -> String {
    format!("{} ({error})", begin_of(answer))
}
