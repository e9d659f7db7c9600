//! Who drives the ego after the warm-up: each policy makes a plan from what was committed.

mod course;
mod lane_change;
mod local_path;
mod preset;
mod profile;
mod smooth;

pub use local_path::{LocalPath, LocalPathError};

use std::path::PathBuf;

use self::course::Course;
use self::preset::Preset;
use super::clock::Clock;
use super::external::Planner;
use super::recorded::Recorded;
use super::simulation::World;
use super::{EgoPolicy, EgoState, SimError, SimOptions, Trajectory, Waypoint};

/// How far plans of ours look ahead: 22 waypoints at 0.1 s.
const HORIZON_US: i64 = 2_200_000;

/// A policy with all that it needs beside the state.
pub(super) enum Driver {
    Replay,
    Preset(Preset),
    /// A course that is laid once, at the takeover; `None` where the log is over before.
    Course(Option<Course>),
    External(Box<Planner>),
}

impl Driver {
    /// `step` is where the rollout starts or goes on.
    pub(super) fn new(
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
        step: usize,
    ) -> Result<Self, SimError> {
        let takeover_us = clock.at(clock.takeover);
        let start = || recorded.ego_at(takeover_us);
        Ok(match &options.ego {
            EgoPolicy::Replay => Self::Replay,
            EgoPolicy::Straight => Self::Preset(Preset::Straight),
            EgoPolicy::RightThenBack => Self::Preset(Preset::RightThenBack),
            EgoPolicy::Cosine => Self::Preset(Preset::Cosine),
            EgoPolicy::LaneChange => {
                Self::Course(start().and_then(|ego| lane_change::course(recorded, takeover_us, &ego)))
            }
            EgoPolicy::File(path) => {
                Self::Course(start().and_then(|ego| local_path::course(path, takeover_us, &ego)))
            }
            EgoPolicy::External(spec) => {
                Self::External(Box::new(Planner::start(spec, options, clock, recorded, step)?))
            }
        })
    }

    /// The plan at a state; `None` where the ego follows the log.
    pub(super) fn plan(
        &mut self,
        recorded: &Recorded<'_>,
        clock: &Clock,
        world: &World,
    ) -> Result<Option<Trajectory>, SimError> {
        let now = &world.instant;
        match self {
            Self::Replay | Self::Course(None) => Ok(None),
            Self::Preset(preset) => {
                let plans = (now.step - clock.takeover) / clock.steps_per_plan;
                Ok(Some(preset.plan(&now.ego, now.t_us, plans)))
            }
            Self::Course(Some(course)) => {
                let times = (now.step + 1..).map(|step| clock.at(step));
                // The last one is behind the horizon, however far apart steps and plans are.
                let end_us = now.t_us + HORIZON_US.max(clock.at(clock.steps_per_plan) - clock.start_us);
                let mut next: Vec<Waypoint> = Vec::new();
                for t_us in times {
                    next.push(course.at(t_us));
                    if t_us >= end_us {
                        break;
                    }
                }
                Ok(Some(Trajectory::new(waypoint(&now.ego, now.t_us), next)))
            }
            Self::External(planner) => Ok(Some(planner.plan(recorded, clock, world)?)),
        }
    }

    /// Files that show what was committed last.
    pub(super) fn show(&mut self, files: Vec<PathBuf>) {
        if let Self::External(planner) = self {
            planner.show(files);
        }
    }
}

/// Where the ego is.
pub(super) fn waypoint(ego: &EgoState, t_us: i64) -> Waypoint {
    let place = ego.position_m();
    let (heading_rad, speed_mps) = (ego.heading_rad(), ego.speed_mps);
    Waypoint { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps }
}
