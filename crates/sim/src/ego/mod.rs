//! Policies of the ego after the warm-up: each computes a plan from the committed state.

mod course;
mod given_path;
mod lane_change;
mod preset;
mod profile;
mod smooth;

use std::path::PathBuf;

use self::course::Course;
use self::preset::Preset;
use super::clock::Clock;
use super::external::{Observation, Planner};
use super::history::History;
use super::recorded::Recorded;
use super::world::World;
use super::{
    EgoPolicy, EgoState, Instant, LocalPath, PathAnchor, SimError, SimOptions, Trajectory, Waypoint,
};

/// Horizon of built-in plans: 22 waypoints at 0.1 s.
const HORIZON_US: i64 = 2_200_000;

/// Ego policy with its private data.
pub(super) enum Driver {
    Replay,
    /// Preset shapes, and the step of the first plan.
    Preset(Preset, usize),
    /// Course computed once at the takeover; `None` if the log ends before it or the ego's pose is not
    /// finite.
    Course(Option<Course>),
    /// Path from a file, placed anew at each plan.
    Path(LocalPath),
    /// Waypoints with times after the takeover; `None` if the log ends before it.
    Timed(Option<Trajectory>),
    External(Box<Planner>),
    /// Plan of the caller for the current step.
    Caller(Option<Trajectory>),
}

/// State from which a policy plans.
struct Start {
    step: usize,
    t_us: i64,
    /// `None` if the log ends before it.
    ego: Option<EgoState>,
}

impl Driver {
    /// Creates the policy; `step` is the first or resumed step of the rollout.
    pub(super) fn new(
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
        step: usize,
    ) -> Result<Self, SimError> {
        let start_us = clock.at(clock.takeover);
        let start = Start { step: clock.takeover, t_us: start_us, ego: recorded.ego_at(start_us) };
        Self::from(&options.ego, start, options, clock, recorded, step)
    }

    /// Creates a policy that plans from a committed state on.
    pub(super) fn at(
        policy: &EgoPolicy,
        now: &Instant,
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
    ) -> Result<Self, SimError> {
        let start = Start { step: now.step, t_us: now.t_us, ego: Some(now.ego) };
        Self::from(policy, start, options, clock, recorded, now.step)
    }

    fn from(
        policy: &EgoPolicy,
        start: Start,
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
        step: usize,
    ) -> Result<Self, SimError> {
        let Start { step: first, t_us, ego } = start;
        Ok(match policy {
            EgoPolicy::Replay => Self::Replay,
            EgoPolicy::Straight => Self::Preset(Preset::Straight, first),
            EgoPolicy::RightThenBack => Self::Preset(Preset::RightThenBack, first),
            EgoPolicy::Cosine => Self::Preset(Preset::Cosine, first),
            EgoPolicy::LaneChange => {
                Self::Course(ego.and_then(|ego| lane_change::course(recorded, t_us, &ego)))
            }
            EgoPolicy::File(path, PathAnchor::EachPlan) => Self::Path(path.clone()),
            EgoPolicy::File(path, PathAnchor::Takeover) => {
                Self::Course(ego.and_then(|ego| given_path::course(path, t_us, &ego)))
            }
            EgoPolicy::Trajectory(file) => {
                let from = |ego: EgoState| {
                    let later = file.waypoints().iter().copied().filter(|w| w.t_us > t_us);
                    Trajectory::new(Waypoint::of(&ego, t_us), later)
                };
                Self::Timed(ego.map(from))
            }
            EgoPolicy::External(spec) => {
                Self::External(Box::new(Planner::start(spec, options, clock, recorded, step)?))
            }
            EgoPolicy::Caller => Self::Caller(None),
        })
    }

    /// Returns the plan at a state, with its files and the states before it; `None` if the ego follows the
    /// log.
    pub(super) fn plan(
        &mut self,
        recorded: &Recorded<'_>,
        clock: &Clock,
        world: &World,
        files: &[PathBuf],
        history: &History,
    ) -> Result<Option<Trajectory>, SimError> {
        let now = &world.instant;
        match self {
            Self::Replay | Self::Course(None) | Self::Timed(None) => Ok(None),
            Self::Preset(preset, first) => {
                let plans = now.step.saturating_sub(*first) / clock.steps_per_plan;
                Ok(Some(preset.plan(&now.ego, now.t_us, plans)))
            }
            Self::Course(Some(course)) => Ok(Some(along(|t_us| course.at(t_us), clock, now))),
            Self::Path(path) => {
                let course = given_path::course(path, now.t_us, &now.ego);
                Ok(course.map(|course| along(|t_us| course.at(t_us), clock, now)))
            }
            Self::Timed(Some(waypoints)) => Ok(Some(along(|t_us| waypoints.at(t_us), clock, now))),
            Self::External(planner) => {
                let observation = Observation::new(recorded, clock, world, files, history);
                Ok(Some(planner.plan(&observation, now, clock.at(now.step + clock.steps_per_plan))?))
            }
            Self::Caller(plan) => match plan.take() {
                Some(plan) => Ok(Some(plan)),
                None => Err(SimError::NoPlan { step: now.step }),
            },
        }
    }

    /// Returns whether a plan of the caller is missing.
    pub(super) fn needs_plan(&self) -> bool {
        matches!(self, Self::Caller(None))
    }
}

/// Returns the plan along a course, with waypoints at the simulation steps.
fn along(course: impl Fn(i64) -> Waypoint, clock: &Clock, now: &Instant) -> Trajectory {
    // The last waypoint lies at or beyond the horizon, for any simulation and planning rates.
    let end_us = now.t_us + HORIZON_US.max(clock.at(clock.steps_per_plan) - clock.start_us);
    let mut next: Vec<Waypoint> = Vec::new();
    for t_us in (now.step + 1..).map(|step| clock.at(step)) {
        next.push(course(t_us));
        if t_us >= end_us {
            break;
        }
    }
    Trajectory::new(Waypoint::of(&now.ego, now.t_us), next)
}
