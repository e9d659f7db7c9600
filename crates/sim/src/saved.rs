use std::collections::BTreeSet;
use std::path::Path;

use glam::{DQuat, DVec3};
use point_skeleton::dataset::{Recording, Triggers};
use point_skeleton::error::FileError;
use point_skeleton::files::json;
use point_skeleton::geometry::{Cuboid, LineProjection, Pose};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::actors::{ControlledActors, SavedMover};
use super::clock::Clock;
use super::metrics::MetricsAccumulator;
use super::recorded::Recorded;
use super::world::World;
use super::{Committed, EgoState, Forecast, Instant, Scenario, SimActor, SimError, SimOptions, Trajectory};

const VERSION: u32 = 3;
/// Maximum deviation of a rotation's length from 1.
const UNIT_TOLERANCE: f64 = 1e-6;

/// Saved state of a rollout between two steps; serializes to JSON without loss and can be resumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedState {
    version: u32,
    log: String,
    /// All options except the number of steps, with defaults resolved.
    options: Value,
    step: usize,
    ego: SavedEgo,
    /// Station and offset of the ego on the recorded path.
    foot_m: [f64; 2],
    actors: Vec<SavedActor>,
    movers: Vec<(usize, SavedMover)>,
    gone: BTreeSet<usize>,
    /// Times of the scenario's changes.
    #[serde(default, skip_serializing_if = "Triggers::is_empty")]
    triggers: Triggers,
    plan: Option<Trajectory>,
    tally: MetricsAccumulator,
}

/// State of a simulation, apart from log and options.
pub(super) struct Saved {
    pub(super) world: Committed<World>,
    pub(super) plan: Option<Forecast<Trajectory>>,
    pub(super) tally: MetricsAccumulator,
}

/// Rotation as x y z w, then translation in meters.
type SavedPose = [f64; 7];

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedEgo {
    pose: SavedPose,
    speed_mps: f64,
    acceleration_mps2: f64,
    yaw_rate_radps: f64,
    steering_rad: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedActor {
    track: usize,
    pose: SavedPose,
    size_m: [f64; 3],
    speed_mps: f64,
    lateral_mps: f64,
    yaw_rate_radps: f64,
}

impl SavedState {
    pub(super) fn new(options: &SimOptions, clock: &Clock, log: &Recording, saved: &Saved) -> Self {
        let World { instant, driven, projection } = saved.world.get();
        let ego = &instant.ego;
        let actor = |a: &SimActor| SavedActor {
            track: a.track,
            pose: write_pose(&a.cuboid.pose),
            size_m: a.cuboid.size.to_array(),
            speed_mps: a.speed_mps,
            lateral_mps: a.lateral_mps,
            yaw_rate_radps: a.yaw_rate_radps,
        };
        Self {
            version: VERSION,
            log: log.name.clone(),
            options: fixed_options(options, clock),
            step: instant.step,
            ego: SavedEgo {
                pose: write_pose(&ego.pose),
                speed_mps: ego.speed_mps,
                acceleration_mps2: ego.acceleration_mps2,
                yaw_rate_radps: ego.yaw_rate_radps,
                steering_rad: ego.steering_rad,
            },
            foot_m: [projection.station_m, projection.offset_m],
            actors: instant.actors.iter().map(actor).collect(),
            movers: driven.movers.iter().map(|(track, mover)| (*track, mover.save())).collect(),
            gone: driven.gone.clone(),
            triggers: driven.triggers.clone(),
            plan: saved.plan.as_ref().map(|plan| plan.get().clone()),
            tally: saved.tally.clone(),
        }
    }

    /// Reads the state of a step from `state.json`.
    ///
    /// # Errors
    /// Fails if the file is missing or is not a saved state.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        json::read(path, "a saved state")
    }

    /// Returns the number of steps from the start to the saved state.
    pub fn step(&self) -> usize {
        self.step
    }

    /// Returns the number of evaluated instants so far with a part of the ego off the road.
    #[cfg(feature = "mcap")]
    pub(super) fn off_road_instants(&self) -> usize {
        self.tally.off_road_instants()
    }

    /// Returns the committed instant of the saved state.
    ///
    /// # Errors
    /// Returns any error of [`Simulation::resume`](super::Simulation::resume) about log, options and state.
    pub fn committed(
        &self,
        scenario: &Scenario<'_>,
        options: &SimOptions,
    ) -> Result<Committed<Instant>, SimError> {
        let recorded = Recorded::of(scenario)?;
        let start_us = options.start_us.unwrap_or(recorded.first_us);
        let clock = Clock::of(options, scenario.rates, start_us, scenario.log)?;
        Ok(self.open(options, &clock, &recorded)?.world.map(|world| world.instant))
    }

    /// Validates the state against a log and options and restores it.
    pub(super) fn open(
        &self,
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
    ) -> Result<Saved, SimError> {
        let wrong = |expected: String, found: String| SimError::Saved { expected, found };
        if self.version != VERSION {
            return Err(wrong(format!("version {VERSION}"), self.version.to_string()));
        }
        if self.log != recorded.log.name {
            return Err(wrong(format!("log {}", recorded.log.name), self.log.clone()));
        }
        let wanted = fixed_options(options, clock);
        for key in [&wanted, &self.options].into_iter().filter_map(Value::as_object).flat_map(|o| o.keys()) {
            if self.options.get(key) != wanted.get(key) {
                let text = |options: &Value| options.get(key).map_or("none".to_owned(), Value::to_string);
                return Err(wrong(format!("{key} {}", text(&wanted)), text(&self.options)));
            }
        }
        let damaged = |what: &str| wrong(format!("valid {what}"), "damaged ones".to_owned());
        if !recorded.log.script.fits(&self.triggers) {
            return Err(damaged("times of the scenario's changes"));
        }
        let instant = self.instant(clock, recorded).ok_or_else(|| damaged("places of ego and actors"))?;
        let driven = self.driven(recorded, &instant).ok_or_else(|| damaged("actors that were taken over"))?;
        if self.plan.as_ref().is_some_and(|plan| !plan.is_valid()) {
            return Err(damaged("waypoints"));
        }
        let [station_m, offset_m] = self.foot_m;
        if !(station_m.is_finite() && offset_m.is_finite()) {
            return Err(damaged("places on the recorded path"));
        }
        let projection = LineProjection { station_m, offset_m };
        let world = Committed::new(World { instant, driven, projection });
        Ok(Saved { world, plan: self.plan.clone().map(Forecast::new), tally: self.tally.clone() })
    }

    fn instant(&self, clock: &Clock, recorded: &Recorded<'_>) -> Option<Instant> {
        let numbers =
            [self.ego.speed_mps, self.ego.acceleration_mps2, self.ego.yaw_rate_radps, self.ego.steering_rad];
        let ego = EgoState {
            pose: read_pose(&self.ego.pose)?,
            speed_mps: self.ego.speed_mps,
            acceleration_mps2: self.ego.acceleration_mps2,
            yaw_rate_radps: self.ego.yaw_rate_radps,
            steering_rad: self.ego.steering_rad,
        };
        let actor = |a: &SavedActor| {
            let cuboid = Cuboid::new(read_pose(&a.pose)?, DVec3::from(a.size_m)).ok()?;
            let motion = [a.speed_mps, a.lateral_mps, a.yaw_rate_radps];
            let is_sound = a.track < recorded.log.tracks.len() && motion.iter().all(|n| n.is_finite());
            let [speed_mps, lateral_mps, yaw_rate_radps] = motion;
            is_sound.then_some(SimActor { track: a.track, cuboid, speed_mps, lateral_mps, yaw_rate_radps })
        };
        let actors = self.actors.iter().map(actor).collect::<Option<Vec<_>>>()?;
        let sorted = actors.windows(2).all(|w| w[0].track < w[1].track);
        let t_us = clock.at(self.step);
        let lights = recorded.lights_at(t_us);
        let is_sound = sorted && numbers.iter().all(|n| n.is_finite());
        is_sound.then_some(Instant { step: self.step, t_us, ego, actors, lights })
    }

    fn driven(&self, recorded: &Recorded<'_>, instant: &Instant) -> Option<ControlledActors> {
        let mover = |(track, saved): &(usize, SavedMover)| {
            instant.actors.iter().find(|actor| actor.track == *track)?;
            Some((*track, saved.open(recorded, *track, &self.triggers)?))
        };
        let movers = self.movers.iter().map(mover).collect::<Option<_>>()?;
        let sorted = self.movers.windows(2).all(|w| w[0].0 < w[1].0);
        let (gone, triggers) = (self.gone.clone(), self.triggers.clone());
        sorted.then_some(ControlledActors { movers, gone, triggers })
    }
}

/// Returns the options that must match for a rollout to resume.
fn fixed_options(options: &SimOptions, clock: &Clock) -> Value {
    let mut fixed_options = serde_json::to_value(options).unwrap_or_default();
    if let Some(fixed_options) = fixed_options.as_object_mut() {
        fixed_options.remove("steps");
        fixed_options.insert("start_us".to_owned(), clock.start_us.into());
        fixed_options.insert("sim_hz".to_owned(), clock.rates.sim_hz.into());
        fixed_options.insert("plan_hz".to_owned(), clock.rates.plan_hz.into());
    }
    fixed_options
}

fn write_pose(pose: &Pose) -> SavedPose {
    let ([x, y, z, w], [a, b, c]) = (pose.rotation.to_array(), pose.translation.to_array());
    [x, y, z, w, a, b, c]
}

/// Restores exactly the pose that was written; `None` if it is invalid.
fn read_pose(saved: &SavedPose) -> Option<Pose> {
    let [x, y, z, w, a, b, c] = *saved;
    let pose = Pose { rotation: DQuat::from_xyzw(x, y, z, w), translation: DVec3::new(a, b, c) };
    let is_unit = (pose.rotation.length() - 1.0).abs() <= UNIT_TOLERANCE;
    (is_unit && pose.translation.is_finite()).then_some(pose)
}
