//! Message to the planner at each planning step.

use std::path::PathBuf;

use glam::DVec3;
use point_skeleton::dataset::{Class, TrafficLight};
use point_skeleton::geometry::LineProjection;
use serde::Serialize;

use crate::clock::Clock;
use crate::history::History;
use crate::recorded::Recorded;
use crate::time::seconds;
use crate::world::World;
use crate::{EgoState, SimActor};

/// Length of the recorded path sent to a planner, and the spacing of its points, meters.
const AHEAD_M: f64 = 100.0;
const AHEAD_STEP_M: f64 = 1.0;

/// The committed state, and the states since the previous observation.
#[derive(Serialize)]
pub(crate) struct Observation<'a> {
    r#type: &'static str,
    /// Seconds to the next observation; the plan must extend at least that far.
    plan_dt: f64,
    #[serde(flatten)]
    now: State<'a>,
    path: Vec<[f64; 2]>,
    history: Vec<State<'a>>,
}

#[derive(Serialize)]
struct State<'a> {
    step: i64,
    t_us: i64,
    ego: Ego,
    actors: Vec<Actor<'a>>,
    lights: Vec<Light<'a>>,
    driving_command: &'static str,
    files: &'a [PathBuf],
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
    vx: f64,
    vy: f64,
    yaw_rate: f64,
}

#[derive(Serialize)]
struct Light<'a> {
    lane_connector: &'a str,
    color: &'a str,
}

impl<'a> Observation<'a> {
    /// Describes a committed state, its files and the states before it.
    pub(crate) fn new(
        recorded: &'a Recorded<'_>,
        clock: &Clock,
        world: &'a World,
        files: &'a [PathBuf],
        history: &'a History,
    ) -> Self {
        let now = &world.instant;
        Self {
            r#type: "observation",
            plan_dt: seconds(now.t_us, clock.at(now.step + clock.steps_per_plan)),
            now: State::new(recorded, now.step as i64, world, files),
            path: path_ahead(recorded, world.projection),
            history: history
                .states()
                .map(|past| State::new(recorded, past.step, &past.world, &past.files))
                .collect(),
        }
    }
}

impl<'a> State<'a> {
    fn new(recorded: &'a Recorded<'_>, step: i64, world: &'a World, files: &'a [PathBuf]) -> Self {
        let World { instant, projection, .. } = world;
        let light =
            |light: &'a TrafficLight| Light { lane_connector: &light.lane_connector, color: &light.color };
        Self {
            step,
            t_us: instant.t_us,
            ego: Ego::new(&instant.ego),
            actors: instant.actors.iter().map(|actor| Actor::new(recorded, actor)).collect(),
            lights: instant.lights.iter().map(light).collect(),
            driving_command: recorded.route.command(*projection),
            files,
        }
    }
}

impl Ego {
    fn new(ego: &EgoState) -> Self {
        let at = ego.pose.translation;
        Self {
            x: at.x,
            y: at.y,
            z: at.z,
            heading: ego.heading_rad(),
            v: ego.speed_mps,
            a: ego.acceleration_mps2,
            yaw_rate: ego.yaw_rate_radps,
            steering: ego.steering_rad,
        }
    }
}

impl<'a> Actor<'a> {
    fn new(recorded: &'a Recorded<'_>, actor: &SimActor) -> Self {
        let track = &recorded.log.tracks[actor.track];
        let (at, size): (DVec3, DVec3) = (actor.cuboid.pose.translation, actor.cuboid.size);
        let velocity = actor.velocity_mps();
        Self {
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
            vx: velocity.x,
            vy: velocity.y,
            yaw_rate: actor.yaw_rate_radps,
        }
    }
}

/// Returns the recorded path ahead of the ego's projection, global meters; empty if the ego never moved.
fn path_ahead(recorded: &Recorded<'_>, ego: LineProjection) -> Vec<[f64; 2]> {
    let Some(line) = recorded.route.line() else { return Vec::new() };
    let from_m = ego.station_m.clamp(0.0, line.length_m());
    let to_m = (from_m + AHEAD_M).min(line.length_m());
    let count = ((to_m - from_m) / AHEAD_STEP_M).floor() as usize;
    let inner = (0..=count).map(|i| from_m + i as f64 * AHEAD_STEP_M);
    let end = Some(to_m).filter(|to_m| to_m - (from_m + count as f64 * AHEAD_STEP_M) > 1e-6);
    inner.chain(end).map(|station_m| line.at(station_m).0.to_array()).collect()
}
