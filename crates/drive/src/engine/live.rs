//! Simulation in real time, driven by the log, a person or a policy.

use std::collections::BTreeMap;

use point_skeleton::dataset::Recording;
use point_skeleton::named::Named;
use pskel_sim::{
    ActorPolicy, Controls, EgoKind, EgoPolicy, EndReason, Instant, LocalPathError, Scenario, SimError,
    SimOptions, Simulation, TrajectoryFile, Waypoint, Wheel,
};

use super::look::within;
use crate::frame::{Ego, Event};
use crate::message::{Keys, Start};

/// Steps per second of a drive, unless others are wanted.
const HZ: f64 = 20.0;
/// Rates that are accepted, per second.
const RATES_HZ: std::ops::RangeInclusive<f64> = 2.0..=100.0;
/// Policies that can take the wheel.
pub(super) const POLICIES: [EgoKind; 4] =
    [EgoKind::Straight, EgoKind::RightThenBack, EgoKind::Cosine, EgoKind::LaneChange];
/// Name of the log as driver.
pub(super) const LOG: &str = "log";
/// Name of a person as driver.
pub(super) const PERSON: &str = "person";

/// How a simulation begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Beginning {
    /// Steps per second.
    pub(super) hz: f64,
    /// Policy of the actors after the takeover.
    pub(super) actors: ActorPolicy,
    /// Time of step 0, absolute microseconds.
    pub(super) start_us: i64,
}

/// Who drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    /// The log: the recorded path.
    Log,
    /// A person's controls.
    Person,
    /// A policy.
    Policy(EgoKind),
}

/// Running simulation.
pub(super) struct Live<'a> {
    simulation: Simulation<'a>,
    pub(super) beginning: Beginning,
    pub(super) by: By,
    /// Who gets the wheel as soon as the log may give it away.
    wanted: Option<By>,
    wheel: Wheel,
    keys: Keys,
    /// Number of the keys of the last step.
    pub(super) keys_number: u64,
    /// Committed states from the takeover on, as waypoints.
    driven: Vec<Waypoint>,
    /// Step of the takeover.
    pub(super) takeover: Option<usize>,
    collisions: usize,
    off_road_instants: usize,
    is_off_road: bool,
    is_comfortable: bool,
    /// Why the drive cannot go on by its driver.
    pub(super) ended: Option<&'static str>,
    events: Vec<Event>,
    first_us: i64,
    /// Categories of tracks.
    categories: BTreeMap<String, String>,
}

impl Beginning {
    /// Returns the beginning of a message. Without a time it is the one that is shown, or the end of the log
    /// if that is earlier.
    ///
    /// # Errors
    /// Returns what was expected and what was found.
    pub(super) fn of(start: &Start, shown_us: i64, log: &Recording) -> Result<Self, String> {
        let hz = start.hz.unwrap_or(HZ);
        if !RATES_HZ.contains(&hz) {
            let (low, high) = (RATES_HZ.start(), RATES_HZ.end());
            return Err(format!("expected {low} to {high} steps per second, found {hz}"));
        }
        let actors = match &start.actors {
            Some(name) => ActorPolicy::from_name(name).map_err(|error| error.to_string())?,
            None => ActorPolicy::Idm,
        };
        Ok(Self { hz, actors, start_us: start.from_t_us.unwrap_or(within(log, shown_us)) })
    }

    fn options(self) -> SimOptions {
        SimOptions {
            steps: usize::MAX,
            sim_hz: Some(self.hz),
            plan_hz: Some(self.hz),
            warmup_frames: usize::MAX,
            start_us: Some(self.start_us),
            ego: EgoPolicy::Caller,
            actors: self.actors,
            ..SimOptions::default()
        }
    }
}

impl By {
    /// Returns the driver of a name.
    ///
    /// # Errors
    /// Returns an error that lists the names.
    pub(super) fn from_name(name: &str) -> Result<Self, String> {
        match name {
            LOG => Ok(Self::Log),
            PERSON => Ok(Self::Person),
            _ => EgoKind::from_name_in(name, &POLICIES)
                .map(Self::Policy)
                .map_err(|error| format!("{error}; or {LOG}, {PERSON}")),
        }
    }

    /// Returns the name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Log => LOG,
            Self::Person => PERSON,
            Self::Policy(kind) => kind.name(),
        }
    }
}

impl<'a> Live<'a> {
    /// Begins a simulation; the log drives.
    ///
    /// # Errors
    /// Fails if the time is outside the log.
    pub(super) fn new(scenario: &Scenario<'a>, beginning: Beginning) -> Result<Self, SimError> {
        let simulation = Simulation::new(scenario, beginning.options())?;
        let wheel = Wheel::new(&simulation.committed().get().ego);
        Ok(Self {
            simulation,
            beginning,
            by: By::Log,
            wanted: None,
            wheel,
            keys: Keys::default(),
            keys_number: 0,
            driven: Vec::new(),
            takeover: None,
            collisions: 0,
            off_road_instants: 0,
            is_off_road: false,
            is_comfortable: true,
            ended: None,
            events: Vec::new(),
            first_us: scenario.log.frames.first().map_or(0, |frame| frame.t_us),
            categories: scenario.log.tracks.iter().map(|t| (t.id.clone(), t.category.clone())).collect(),
        })
    }

    /// Returns the simulation.
    pub(super) fn simulation(&self) -> &Simulation<'a> {
        &self.simulation
    }

    /// Returns the committed state.
    pub(super) fn instant(&self) -> &Instant {
        self.simulation.committed().get()
    }

    /// Returns the states from the takeover on.
    pub(super) fn driven(&self) -> &[Waypoint] {
        &self.driven
    }

    /// Sets the state of the controls. The first key takes the wheel, see [`Live::hand_over`].
    ///
    /// # Errors
    /// Fails as [`Live::hand_over`].
    pub(super) fn press(&mut self, keys: Keys, is_allowed: bool) -> Result<(), SimError> {
        self.keys = keys;
        if !keys.is_idle() && self.by != By::Person {
            self.hand_over(By::Person, is_allowed)?;
        }
        Ok(())
    }

    /// Hands the wheel over. The log stays at the wheel before the takeover, and until it `is_allowed`:
    /// [`Live::settle`] hands over then.
    ///
    /// # Errors
    /// Fails if a policy cannot plan.
    pub(super) fn hand_over(&mut self, by: By, is_allowed: bool) -> Result<(), SimError> {
        self.wanted = None;
        if by == self.by {
            return Ok(());
        }
        if self.takeover.is_none() && by != By::Log && !is_allowed {
            self.wanted = Some(by);
            return Ok(());
        }
        if self.takeover.is_none() && by != By::Log {
            self.simulation.take_over()?;
            let now = self.instant();
            let (step, start) = (now.step, Waypoint::of(&now.ego, now.t_us));
            self.takeover = Some(step);
            self.driven = vec![start];
        }
        match by {
            By::Person => {
                self.wheel = Wheel::new(&self.instant().ego);
                self.simulation.plan_by(&EgoPolicy::Caller)?;
            }
            By::Log => self.simulation.plan_by(&EgoPolicy::Caller)?,
            By::Policy(kind) => {
                if let Some(policy) = EgoPolicy::new(kind, None, None) {
                    self.simulation.plan_by(&policy)?;
                }
            }
        }
        self.by = by;
        self.ended = None;
        self.note(format!("{} drives", by.name()));
        Ok(())
    }

    /// Hands the wheel to the one who waits for it, if that `is_allowed` now.
    ///
    /// # Errors
    /// Fails as [`Live::hand_over`].
    pub(super) fn settle(&mut self, is_allowed: bool) -> Result<(), SimError> {
        match self.wanted.filter(|_| is_allowed) {
            Some(by) => self.hand_over(by, is_allowed),
            None => Ok(()),
        }
    }

    /// Returns whether somebody waits for the wheel.
    pub(super) fn is_wanted(&self) -> bool {
        self.wanted.is_some()
    }

    /// Commits the next step; plans reach `horizon` steps ahead. Does nothing where the driver cannot go on,
    /// which [`Live::ended`] tells.
    ///
    /// # Errors
    /// Fails if a policy fails.
    pub(super) fn step(&mut self, horizon: usize) -> Result<(), SimError> {
        match self.by {
            By::Log if self.takeover.is_some() => {
                let times = self.times_us(horizon);
                let recorded = times.map_while(|t_us| self.simulation.recorded_waypoint(t_us));
                let next: Vec<Waypoint> = recorded.collect();
                if next.is_empty() {
                    self.ended = Some("the log has ended: take the wheel, or reset");
                    return Ok(());
                }
                self.simulation.follow_waypoints(next)?;
            }
            By::Person => {
                let Keys { throttle, brake, steer, number } = self.keys;
                let (controls, now) = (Controls { throttle, brake, steer }, self.instant());
                // The controls stay as they are, as far as anybody knows.
                let (ego, t_us) = (now.ego, now.t_us);
                let driven = |time_us| {
                    let mut wheel = self.wheel;
                    let next = wheel.drive(&ego, controls, t_us, time_us);
                    (wheel, next)
                };
                let (wheels, next): (Vec<_>, Vec<_>) = self.times_us(horizon).map(driven).unzip();
                self.wheel = wheels.first().copied().unwrap_or(self.wheel);
                self.simulation.follow_waypoints(next)?;
                self.keys_number = number;
            }
            By::Log | By::Policy(_) => {}
        }
        if self.simulation.step()?.is_none() {
            self.ended = self.simulation.ended().map(|reason| match reason {
                EndReason::LogEnded => "the log has ended: take the wheel, or reset",
                EndReason::Steps => "all steps are simulated",
            });
            return Ok(());
        }
        if self.takeover.is_some() {
            let now = self.instant();
            let waypoint = Waypoint::of(&now.ego, now.t_us);
            self.driven.push(waypoint);
            self.observe();
        }
        Ok(())
    }

    /// Returns the times of the next steps, absolute microseconds.
    fn times_us(&self, count: usize) -> impl Iterator<Item = i64> + use<> {
        let (next_us, hz) = (self.simulation.next_us(), self.beginning.hz);
        (0..count).map(move |step| next_us + (1e6 * step as f64 / hz).round() as i64)
    }

    /// Notes what happened at the committed step.
    fn observe(&mut self) {
        let metrics = self.simulation.metrics();
        for collision in &metrics.collisions[self.collisions.min(metrics.collisions.len())..] {
            let category = self.categories.get(&collision.track).map_or("an actor", String::as_str);
            let text = collision.text(category);
            self.events.push(Event { step: collision.step, t_s: self.seconds(collision.t_us), text });
        }
        self.collisions = metrics.collisions.len();
        if self.is_comfortable && !metrics.comfort.comfortable {
            self.is_comfortable = false;
            self.note("accelerations, jerk or yaw rate beyond the bounds of comfort".to_owned());
        }
        if let Some(off_road) = metrics.off_road {
            let is_off = off_road.instants > self.off_road_instants;
            self.off_road_instants = off_road.instants;
            if is_off != std::mem::replace(&mut self.is_off_road, is_off) {
                let text = if is_off { "off the drivable area" } else { "back on the drivable area" };
                self.note(text.to_owned());
            }
        }
    }

    fn note(&mut self, text: String) {
        let now = self.instant();
        let (step, t_s) = (now.step, self.seconds(now.t_us));
        self.events.push(Event { step, t_s, text });
    }

    fn seconds(&self, t_us: i64) -> f64 {
        (t_us - self.first_us) as f64 / 1e6
    }

    /// Returns the events since the last call.
    pub(super) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Returns the state of the ego; deviations from the recorded path after the takeover.
    pub(super) fn ego(&self) -> Ego {
        let ego = self.instant().ego;
        let at = ego.pose.translation;
        let metrics = self.takeover.map(|_| self.simulation.metrics());
        Ego {
            x: at.x,
            y: at.y,
            z: at.z,
            yaw_rad: ego.heading_rad(),
            speed_mps: ego.speed_mps,
            acceleration_mps2: ego.acceleration_mps2,
            yaw_rate_radps: ego.yaw_rate_radps,
            steering_rad: ego.steering_rad,
            lateral_m: metrics.as_ref().map(|metrics| metrics.lateral_deviation_m.end),
            heading_rad: metrics.map(|metrics| metrics.heading_deviation_rad.end),
        }
    }

    /// Returns the options of the same drive along its trajectory, with plans `every` steps and a warm-up of
    /// at least `window` of them.
    ///
    /// # Errors
    /// Fails if the states are no trajectory.
    pub(super) fn replay_options(&self, every: usize, window: usize) -> Result<SimOptions, LocalPathError> {
        let steps = self.instant().step;
        let warmup_frames = self.warmup(every, window);
        let ego = match self.takeover {
            Some(_) => EgoPolicy::Trajectory(TrajectoryFile::new(self.driven.clone())?),
            None => EgoPolicy::Replay,
        };
        let plan_hz = Some(self.beginning.hz / every as f64);
        Ok(SimOptions { steps, warmup_frames, ego, plan_hz, ..self.beginning.options() })
    }

    /// Returns the number of planning steps in the warm-up of the same drive.
    fn warmup(&self, every: usize, window: usize) -> usize {
        (self.takeover.unwrap_or(self.instant().step) / every + 1).max(window)
    }

    /// Returns the arguments of `pskel simulate` for the same drive, as [`Live::replay_options`].
    pub(super) fn arguments(&self, trajectory: &str, every: usize, window: usize) -> Vec<String> {
        let Beginning { hz, actors, start_us } = self.beginning;
        let steps = self.instant().step;
        let mut arguments: Vec<String> = [
            ("--steps", steps.to_string()),
            ("--start", start_us.to_string()),
            ("--sim-hz", hz.to_string()),
            ("--plan-hz", (hz / every as f64).to_string()),
            ("--warmup", self.warmup(every, window).to_string()),
            ("--actors", actors.to_string()),
        ]
        .into_iter()
        .flat_map(|(name, value)| [name.to_owned(), value])
        .collect();
        if self.takeover.is_some() {
            arguments.extend(["--ego", "file", "--trajectory", trajectory].map(str::to_owned));
        }
        arguments
    }
}
