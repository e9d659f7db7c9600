use std::path::Path;

use point_skeleton::dataset::{LogFormat, Recording};
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_file;
use serde::Serialize;

use super::{LocalPath, LocalPathError, PlannerSpec, TrajectoryFile};
use crate::path::local_path::MAX_BYTES;
use point_skeleton::{named, named_in_files};

/// Options of a rollout.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SimOptions {
    /// Seed passed to external planners; built-in policies use no random numbers.
    pub seed: u64,
    /// Number of steps from the start, at least 1, including the warm-up.
    pub steps: usize,
    /// Simulation rate, hertz; `None` for the [`Rates`] of the log.
    pub sim_hz: Option<f64>,
    /// Planning rate, hertz; must divide the simulation rate. `None` for the [`Rates`] of the log.
    pub plan_hz: Option<f64>,
    /// Uses every n-th frame of the log from the start as a simulation and planning step, instead of fixed
    /// rates. Requires an ego and actors that follow the log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every_frames: Option<usize>,
    /// Number of frames in a generative model's window that follow the log, one per plan. They cover the
    /// first `(N - 1) * sim_hz / plan_hz` simulation steps.
    pub warmup_frames: usize,
    /// Start time, absolute microseconds; `None` for the log's first frame.
    pub start_us: Option<i64>,
    /// Policy of the ego after the warm-up.
    pub ego: EgoPolicy,
    /// Tracking of the plan by the ego.
    pub tracking: Tracking,
    /// Policy of the actors after the warm-up.
    pub actors: ActorPolicy,
}

impl Default for SimOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            steps: 1,
            sim_hz: None,
            plan_hz: None,
            every_frames: None,
            warmup_frames: 1,
            start_us: None,
            ego: EgoPolicy::Replay,
            tracking: Tracking::Perfect,
            actors: ActorPolicy::Replay,
        }
    }
}

/// Policy of the ego.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EgoPolicy {
    /// Replays the log.
    Replay,
    /// Drives straight on.
    Straight,
    /// Aims increasingly to the right from the 8th to the 17th plan, constantly afterwards.
    RightThenBack,
    /// Moves 1.5 m to the right along half a cosine wave.
    Cosine,
    /// Changes to one lane right of the recorded path, at 10 m/s.
    LaneChange,
    /// Follows a path read from a file.
    File(LocalPath, PathAnchor),
    /// Follows waypoints with times read from a file; its kind is [`EgoKind::File`].
    #[serde(rename = "file")]
    Trajectory(TrajectoryFile),
    /// Follows the plans of an external process.
    External(PlannerSpec),
    /// Follows the plans given to [`Simulation::follow`](super::Simulation::follow).
    Caller,
}

/// [`EgoPolicy`] without its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum EgoKind {
    Replay,
    Straight,
    RightThenBack,
    Cosine,
    LaneChange,
    File,
    External,
    Caller,
}

named!(EgoKind, "policy of the ego" {
    Replay => "replay", "Recorded path of the ego";
    Straight => "straight", "Straight ahead";
    RightThenBack => "right_then_back", "Increasingly to the right";
    Cosine => "cosine", "1.5 m to the right along half a cosine wave";
    LaneChange => "lane_change", "One lane to the right of the recorded path, at 10 m/s";
    File => "file", "Along the points of --trajectory";
    External => "external", "Plans of --planner";
    Caller => "caller", "Plans of the program that runs the simulation";
});

impl EgoKind {
    /// Policies of a simulation that plans on its own.
    pub const OF_COMMAND: &[Self] = Self::ALL.split_at(7).0;
}

impl EgoPolicy {
    /// Returns the policy of a kind; `None` for [`EgoKind::File`] without the policy of a file
    /// ([`EgoPolicy::read`]), and for [`EgoKind::External`] without a planner.
    pub fn new(kind: EgoKind, file: Option<Self>, planner: Option<PlannerSpec>) -> Option<Self> {
        Some(match kind {
            EgoKind::Replay => Self::Replay,
            EgoKind::Straight => Self::Straight,
            EgoKind::RightThenBack => Self::RightThenBack,
            EgoKind::Cosine => Self::Cosine,
            EgoKind::LaneChange => Self::LaneChange,
            EgoKind::File => file?,
            EgoKind::External => Self::External(planner?),
            EgoKind::Caller => Self::Caller,
        })
    }

    /// Reads a path ([`LocalPath::read`]) or waypoints with times ([`TrajectoryFile::read`]). JSON objects
    /// with the key `waypoints` are the latter.
    ///
    /// # Errors
    /// Returns any error of the two. Fails if waypoints with times have another anchor than the takeover.
    pub fn read(path: &Path, anchor: PathAnchor) -> Result<Self, LocalPathError> {
        let bytes = read_file(path, MAX_BYTES)?;
        if !TrajectoryFile::is_in(&bytes, path) {
            return Ok(Self::File(LocalPath::parse(&bytes, path)?, anchor));
        }
        if anchor == PathAnchor::EachPlan {
            let expected = "a path of points to place anew at each plan";
            return Err(FileError::content(expected, "waypoints with times", path).into());
        }
        TrajectoryFile::parse(&bytes, path).map(Self::Trajectory)
    }

    /// Returns its kind.
    pub fn kind(&self) -> EgoKind {
        match self {
            Self::Replay => EgoKind::Replay,
            Self::Straight => EgoKind::Straight,
            Self::RightThenBack => EgoKind::RightThenBack,
            Self::Cosine => EgoKind::Cosine,
            Self::LaneChange => EgoKind::LaneChange,
            Self::File(..) | Self::Trajectory(_) => EgoKind::File,
            Self::External(_) => EgoKind::External,
            Self::Caller => EgoKind::Caller,
        }
    }

    /// Returns the name of the policy in files, like `lane_change`.
    pub fn name(&self) -> &'static str {
        self.kind().name()
    }
}

/// Ego pose at which a path from a file begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PathAnchor {
    /// At the takeover: the ego drives along the path once.
    #[default]
    Takeover,
    /// At each plan: each plan is the path from the current pose on. The reference implementation of the
    /// paper does so, but covers the whole path in 2.2 s.
    EachPlan,
}

/// Tracking of a plan by the ego.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tracking {
    /// The ego follows the plan exactly.
    #[default]
    Perfect,
    /// A kinematic bicycle model with limits tracks the plan.
    Bicycle,
}

named!(Tracking, "tracking" {
    Perfect => "perfect", "The ego follows the plan exactly";
    Bicycle => "bicycle", "A kinematic bicycle model with limits tracks the plan";
});
named_in_files!(Tracking);

/// Policy of the actors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ActorPolicy {
    /// Replays the log.
    #[default]
    Replay,
    /// Vehicles and cycles near the ego follow their recorded paths with the Intelligent Driver Model; others
    /// replay the log.
    Idm,
    /// Vehicles, cycles and pedestrians near the ego maintain speed and curvature and brake for obstacles
    /// ahead.
    Reactive,
}

named!(ActorPolicy, "policy of actors" {
    Replay => "replay", "As in the log";
    Idm => "idm",
        "Vehicles and cycles near the ego follow their paths by the Intelligent Driver Model";
    Reactive => "reactive", "Actors near the ego keep speed and curvature, and brake";
});
named_in_files!(ActorPolicy);

/// Simulation and planning rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Simulation steps per second.
    pub sim_hz: f64,
    /// Plans per second.
    pub plan_hz: f64,
}

impl Rates {
    /// Rates for nuScenes.
    pub const NUSCENES: Self = Self { sim_hz: 12.0, plan_hz: 2.0 };

    /// Returns the default rates of a log, or else of its format.
    pub fn of(format: &LogFormat, log: &Recording) -> Self {
        let [sim_hz, plan_hz] = log.rates_hz.unwrap_or(format.rates_hz);
        Self { sim_hz, plan_hz }
    }
}

impl Default for Rates {
    /// Returns the rates for nuPlan and all other logs.
    fn default() -> Self {
        Self { sim_hz: 10.0, plan_hz: 5.0 }
    }
}
