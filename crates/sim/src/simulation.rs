use std::collections::BTreeMap;
use std::path::PathBuf;

use point_skeleton::dataset::NavigationRoute;
use serde::Serialize;

use super::actors::{self, ControlledActors};
use super::clock::Clock;
use super::ego::Driver;
use super::external::{Observation, plan_of, read_plan};
use super::history::History;
use super::metrics::{MetricsAccumulator, Road};
use super::recorded::Recorded;
use super::saved::{Saved, SavedState};
use super::tracking::follow;
use super::world::World;
use super::{
    ActorPolicy, Committed, EgoPolicy, Forecast, Instant, Metrics, Rates, Scenario, SimError, SimOptions,
    Trajectory, Waypoint,
};
use crate::peer::ProtocolError;

/// Closed-loop rollout: moves a log's ego and actors by policies, step by step.
///
/// The transition between two steps is a pure function of the committed state and the plan.
pub struct Simulation<'a> {
    recorded: Recorded<'a>,
    options: SimOptions,
    clock: Clock,
    driver: Driver,
    road: Option<Road>,
    /// Committed state, and the plan that the ego follows until the next one.
    committed: Saved,
    /// Files that show the committed state.
    files: Vec<PathBuf>,
    history: History,
    log_ended: bool,
}

/// Result of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepOutcome {
    /// Plan computed at this step; `None` if the step has none.
    pub plan: Option<Forecast<Trajectory>>,
}

/// Reason for the end of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// All steps were simulated.
    Steps,
    /// The ego follows the log, and the log has ended.
    LogEnded,
}

impl<'a> Simulation<'a> {
    /// Creates a rollout and commits step 0, which is taken from the log.
    ///
    /// # Errors
    /// Fails if the options are inconsistent or do not fit the log, or if the planner does not answer.
    pub fn new(scenario: &Scenario<'a>, options: SimOptions) -> Result<Self, SimError> {
        Self::start(scenario, options, None)
    }

    /// Resumes a rollout of the same log and options; the number of steps may differ. An external planner is
    /// restarted and receives the current step.
    ///
    /// # Errors
    /// Returns any error of [`Simulation::new`]. Fails if the state was saved with other options or by
    /// another version, or is damaged.
    pub fn resume(
        scenario: &Scenario<'a>,
        options: SimOptions,
        saved: &SavedState,
    ) -> Result<Self, SimError> {
        Self::start(scenario, options, Some(saved))
    }

    fn start(
        scenario: &Scenario<'a>,
        options: SimOptions,
        saved: Option<&SavedState>,
    ) -> Result<Self, SimError> {
        if options.steps == 0 {
            return Err(SimError::NoSteps);
        }
        let log = scenario.log;
        let recorded = Recorded::of(scenario)?;
        let (first_us, last_us) = (recorded.first_us, recorded.last_us);
        let start_us = options.start_us.unwrap_or(first_us);
        let clock = Clock::of(&options, scenario.rates, start_us, log)?;
        let outside = || SimError::Start { first_us, last_us, found_us: start_us, log: log.name.clone() };
        let triggers = log.script.recorded(log, clock.start_us);
        let mut driven = ControlledActors { triggers, ..ControlledActors::default() };
        let first = actors::replayed(&recorded, 0, clock.start_us, &mut driven).ok_or_else(outside)?;
        let road = scenario.map.as_ref().and_then(|map| Road::new(map.vector_map()));
        let start = match saved {
            Some(saved) => saved.open(&options, &clock, &recorded)?,
            None => {
                let projection = recorded.logged_projection(&first.ego, clock.start_us);
                let world = World { instant: first, driven, projection };
                let mut tally = MetricsAccumulator::default();
                if clock.takeover == 0 {
                    tally.add(&recorded, road.as_ref(), &world);
                }
                Saved { world: Committed::new(world), plan: None, tally }
            }
        };
        let history = match saved {
            Some(_) => History::default(),
            None => History::before_start(&recorded, &clock, clock.start_us),
        };
        let driver = Driver::new(&options, &clock, &recorded, start.world.get().instant.step)?;
        let files = Vec::new();
        Ok(Self {
            recorded,
            options,
            clock,
            driver,
            road,
            committed: start,
            files,
            history,
            log_ended: false,
        })
    }

    /// Returns the last committed instant.
    pub fn committed(&self) -> Committed<&Instant> {
        self.committed.world.as_ref().map(|world| &world.instant)
    }

    /// Computes and commits the next step. Returns `None` and changes nothing once the rollout is over;
    /// [`Simulation::ended`] gives the reason.
    ///
    /// # Errors
    /// Fails if an external planner fails; the committed state remains unchanged.
    pub fn step(&mut self) -> Result<Option<StepOutcome>, SimError> {
        if self.is_done() {
            return Ok(None);
        }
        let now = self.committed.world.get();
        let mut made = None;
        if self.clock.plans_at(now.instant.step) {
            let (recorded, clock, files) = (&self.recorded, &self.clock, &self.files);
            made = self.driver.plan(recorded, clock, now, files, &self.history)?.map(Forecast::new);
        }
        let plan = made.as_ref().or(self.committed.plan.as_ref()).map(Forecast::get);
        let Some(next) = self.advance(now, plan) else {
            self.log_ended = true;
            return Ok(None);
        };
        if next.instant.step >= self.clock.takeover {
            self.committed.tally.add(&self.recorded, self.road.as_ref(), &next);
        }
        let next_us = next.instant.t_us;
        let before = std::mem::replace(&mut self.committed.world, Committed::new(next));
        let files = std::mem::take(&mut self.files);
        if made.is_some() {
            self.history = History::default(); // observed, as the state before
        } else {
            self.history.push(before.into_inner(), files, next_us);
        }
        if made.is_some() {
            self.committed.plan.clone_from(&made);
        }
        Ok(Some(StepOutcome { plan: made }))
    }

    /// Returns the observation of the committed state, as an external planner receives it
    /// (`docs/src/reference/planner.md`).
    pub fn observation(&self) -> impl Serialize {
        Observation::new(&self.recorded, &self.clock, self.committed.world.get(), &self.files, &self.history)
    }

    /// Returns the log's route to the destination at the first plan; `None` if it has none.
    pub fn route(&self) -> Option<&NavigationRoute> {
        self.recorded.log.route_at(self.clock.at(self.clock.takeover))
    }

    /// Returns the direction of the recorded path within 20 m ahead of the ego
    /// (`docs/src/reference/planner.md`): `left`, `straight`, `right`, or `unknown` past its end.
    pub fn driving_command(&self) -> &'static str {
        self.recorded.route.command(self.committed.world.get().projection)
    }

    /// Returns whether the next step requires a plan of the caller ([`EgoPolicy::Caller`]).
    pub fn needs_plan(&self) -> bool {
        let step = self.committed.world.get().instant.step;
        !self.is_done() && self.driver.needs_plan() && self.clock.plans_at(step)
    }

    /// Sets the plan for the next step of an ego that follows its caller ([`EgoPolicy::Caller`]): a JSON
    /// object, the answer of an external planner (`docs/src/reference/planner.md`).
    ///
    /// # Errors
    /// Fails if the next step requires no plan, or if the plan is invalid. The simulation remains unchanged.
    pub fn follow(&mut self, answer: &[u8]) -> Result<(), SimError> {
        self.follow_by(|now, due_us| read_plan(answer, now, due_us))
    }

    /// Sets the plan for the next step as [`Simulation::follow`] does, by waypoints in the global frame.
    ///
    /// # Errors
    /// Returns any error of [`Simulation::follow`].
    pub fn follow_waypoints(&mut self, next: Vec<Waypoint>) -> Result<(), SimError> {
        self.follow_by(|now, due_us| plan_of(&next, now, due_us))
    }

    fn follow_by(
        &mut self,
        plan: impl FnOnce(&Instant, i64) -> Result<Trajectory, ProtocolError>,
    ) -> Result<(), SimError> {
        let now = &self.committed.world.get().instant;
        if !self.needs_plan() {
            return Err(SimError::NotPlanned { step: now.step });
        }
        let due_us = self.clock.at(now.step + self.clock.steps_per_plan);
        self.driver = Driver::Caller(Some(plan(now, due_us)?));
        Ok(())
    }

    /// Ends the warm-up at the committed step, as if the rollout had been created with such a warm-up; an
    /// external planner is restarted. A rollout that ended with the log during the warm-up continues. Does
    /// nothing if the warm-up has ended.
    ///
    /// # Errors
    /// Fails if the committed step is no planning step, or if the planner does not answer. The simulation
    /// remains unchanged.
    pub fn take_over(&mut self) -> Result<(), SimError> {
        let step = self.committed.world.get().instant.step;
        let steps_per_plan = self.clock.steps_per_plan;
        if step >= self.clock.takeover {
            return Ok(());
        }
        if !step.is_multiple_of(steps_per_plan) {
            return Err(SimError::Takeover { step, steps_per_plan });
        }
        let options = SimOptions { warmup_frames: step / steps_per_plan + 1, ..self.options.clone() };
        let clock = self.clock.with_takeover(step);
        self.driver = Driver::new(&options, &clock, &self.recorded, step)?;
        (self.options, self.clock, self.log_ended) = (options, clock, false);
        self.committed.tally.add(&self.recorded, self.road.as_ref(), self.committed.world.get());
        Ok(())
    }

    /// Lets another policy plan from the committed state on, at the next planning step. The options remain
    /// unchanged, so a saved state resumes with their policy.
    ///
    /// # Errors
    /// Fails during the warm-up, for [`EgoPolicy::Replay`] (the ego would jump), or if an external planner
    /// does not answer. The simulation remains unchanged.
    pub fn plan_by(&mut self, policy: &EgoPolicy) -> Result<(), SimError> {
        let now = &self.committed.world.get().instant;
        if now.step < self.clock.takeover || *policy == EgoPolicy::Replay {
            return Err(SimError::Policy { policy: policy.name(), step: now.step });
        }
        self.driver = Driver::at(policy, now, &self.options, &self.clock, &self.recorded)?;
        Ok(())
    }

    /// Returns the log's ego at a time (absolute microseconds) as a waypoint; `None` outside the log.
    pub fn recorded_waypoint(&self, t_us: i64) -> Option<Waypoint> {
        Some(Waypoint::of(&self.recorded.ego_at(t_us)?, t_us))
    }

    /// Returns the time of the next step, absolute microseconds.
    pub fn next_us(&self) -> i64 {
        self.clock.at(self.committed.world.get().instant.step + 1)
    }

    /// Predicts the next `plan_steps` planning steps after the committed one. The ego follows the rest of its
    /// plan and the actors follow their policy; before the first plan the log is used. Returns fewer if the
    /// log ends.
    pub fn forecast(&self, plan_steps: usize) -> Vec<Forecast<Instant>> {
        self.forecast_every(self.clock.steps_per_plan, plan_steps)
    }

    /// Predicts as [`Simulation::forecast`] does, but `count` instants that are `steps` simulation steps
    /// apart.
    pub fn forecast_every(&self, steps: usize, count: usize) -> Vec<Forecast<Instant>> {
        let mut expected = self.committed.world.get().clone();
        let mut forecast = Vec::new();
        for _ in 0..count {
            for _ in 0..steps {
                let Some(next) = self.expect(&expected) else { return forecast };
                expected = next;
            }
            forecast.push(Forecast::new(expected.instant.clone()));
        }
        forecast
    }

    /// Predicts the state after another; `None` if the log ends.
    fn expect(&self, now: &World) -> Option<World> {
        let plan = self.committed.plan.as_ref().map(Forecast::get);
        // An ego that replays the log has no plans, but its actors still follow their policy.
        if plan.is_some() || self.options.ego == EgoPolicy::Replay {
            return self.advance(now, plan);
        }
        let step = now.instant.step + 1;
        let mut driven = now.driven.clone();
        let instant = actors::replayed(&self.recorded, step, self.clock.at(step), &mut driven)?;
        Some(World { instant, driven, projection: now.projection })
    }

    /// Computes the state after another; `None` if the ego follows the log and the log has ended.
    fn advance(&self, now: &World, plan: Option<&Trajectory>) -> Option<World> {
        let step = now.instant.step + 1;
        let t_us = self.clock.at(step);
        let by_log = step <= self.clock.takeover;
        let (ego, projection) = match plan {
            Some(plan) if !by_log => {
                let place_m = now.instant.ego.position_m();
                let stretch = self.recorded.route.around(now.projection.station_m, place_m);
                let ego = follow(self.options.tracking, stretch, &now.instant, plan, t_us);
                (ego, stretch.project(ego.position_m()))
            }
            _ => {
                let ego = self.recorded.ego_at(t_us)?;
                (ego, self.recorded.logged_projection(&ego, t_us))
            }
        };
        let policy = if by_log { ActorPolicy::Replay } else { self.options.actors };
        let mut driven = now.driven.clone();
        let actors = actors::advance(policy, &self.recorded, &mut driven, &now.instant, (t_us, &ego));
        let lights = self.recorded.lights_at(t_us);
        let mut instant = Instant { step, t_us, ego, actors, lights };
        actors::meet_conditions(&self.recorded, &mut instant, &mut driven);
        Some(World { instant, driven, projection })
    }

    /// Returns whether the rollout is over.
    pub fn is_done(&self) -> bool {
        self.ended().is_some()
    }

    /// Returns the reason for the end of the rollout; `None` while it is running.
    pub fn ended(&self) -> Option<EndReason> {
        if self.committed.world.get().instant.step >= self.options.steps {
            return Some(EndReason::Steps);
        }
        self.log_ended.then_some(EndReason::LogEnded)
    }

    /// Returns the metrics of the committed steps from the takeover on.
    pub fn metrics(&self) -> Metrics {
        self.committed.tally.metrics(self.road.is_some())
    }

    /// Returns notes on the log for the user: kinds with their counts.
    pub fn notes(&self) -> BTreeMap<String, usize> {
        self.recorded.notes()
    }

    /// Returns the state required by [`Simulation::resume`].
    pub fn save(&self) -> SavedState {
        SavedState::new(&self.options, &self.clock, self.recorded.log, &self.committed)
    }

    /// Returns the simulation and planning rates.
    pub fn rates(&self) -> Rates {
        self.clock.rates
    }

    /// Returns the number of steps per plan, at least 1.
    pub fn steps_per_plan(&self) -> usize {
        self.clock.steps_per_plan
    }

    /// Returns the last step whose ego and actors are taken from the log; the first plan is computed there.
    pub fn takeover_step(&self) -> usize {
        self.clock.takeover
    }

    /// Sets the files that show the last committed state; an external planner receives them with the next
    /// observation.
    pub fn show(&mut self, files: Vec<PathBuf>) {
        self.files = files;
    }

    /// Adds states before a resumed one, oldest first, each with the files that show it, to the history of
    /// the next observation. Those older than 2 s are left out, and the log's states before step 0 are added
    /// as far as needed.
    ///
    /// # Errors
    /// Returns any error of [`Simulation::resume`] about a state.
    pub fn restore_history(&mut self, earlier: Vec<(SavedState, Vec<PathBuf>)>) -> Result<(), SimError> {
        let now_us = self.committed.world.get().instant.t_us;
        let mut history = History::before_start(&self.recorded, &self.clock, now_us);
        for (saved, files) in earlier {
            let saved = saved.open(&self.options, &self.clock, &self.recorded)?;
            history.push(saved.world.into_inner(), files, now_us);
        }
        self.history = history;
        Ok(())
    }
}
