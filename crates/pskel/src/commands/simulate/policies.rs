use std::path::PathBuf;

use clap::{Args, ValueEnum};
use pskel_sim::PlannerAddress;
use serde::Serialize;

use crate::args::numbers;

/// Policies of ego and actors, and their rates.
#[derive(Debug, Args)]
pub(super) struct PolicyArgs {
    /// Policy of the ego after the warm-up
    #[arg(long, value_enum, value_name = "POLICY", default_value = "replay")]
    pub(super) ego: EgoName,
    /// With --ego file: the path in the ego's frame, meters forward and to the left; JSON, CSV, TXT or NPY
    #[arg(long, value_name = "FILE", required_if_eq("ego", "file"))]
    pub(super) trajectory: Option<PathBuf>,
    /// With --ego file: place the path at the ego anew at each plan, instead of once at the takeover
    #[arg(long)]
    pub(super) reanchor: bool,
    /// With --ego external: a command that communicates over its standard input and output, or the socket on
    /// which it listens, unix:PATH or tcp:HOST:PORT
    #[arg(long, value_name = "COMMAND|ADDRESS", required_if_eq("ego", "external"))]
    pub(super) planner: Option<PlannerAddress>,
    /// Time-out for each answer of the planner, seconds
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    pub(super) planner_timeout: f64,
    /// How the ego tracks the plan
    #[arg(long, value_enum, default_value = "perfect")]
    pub(super) tracking: TrackingName,
    /// Policy of the other actors after the warm-up
    #[arg(long, value_enum, value_name = "POLICY", default_value = "replay")]
    pub(super) actors: ActorName,
    /// Simulation steps per second [default: 12 for nuScenes, 10 for other logs]
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    pub(super) sim_hz: Option<f64>,
    /// Planning steps per second, a divisor of the simulation rate [default: 2 for nuScenes, 5 for other
    /// logs]
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    pub(super) plan_hz: Option<f64>,
    /// Warm-up in frames of a generator's window, one per planning step: the first (N - 1) * SIM_HZ / PLAN_HZ
    /// steps follow the log [default: 1; with --generator its window]
    #[arg(long, value_name = "N")]
    pub(super) warmup: Option<usize>,
    /// Start at this time, absolute microseconds [default: the log's first frame]
    #[arg(long, value_name = "T_US", allow_negative_numbers = true)]
    pub(super) start: Option<i64>,
    /// Seed that is passed to planners
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) seed: u64,
}

/// Names of [`EgoPolicy`](pskel_sim::EgoPolicy).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[value(rename_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub(crate) enum EgoName {
    /// Recorded path of the ego.
    Replay,
    /// Straight ahead.
    Straight,
    /// Increasingly to the right.
    RightThenBack,
    /// 1.5 m to the right along half a cosine wave.
    Cosine,
    /// One lane to the right of the recorded path, at 10 m/s.
    LaneChange,
    /// Along the points of --trajectory.
    File,
    /// Plans of --planner.
    External,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum TrackingName {
    /// The ego follows the plan exactly.
    Perfect,
    /// A kinematic bicycle model with limits tracks the plan.
    Bicycle,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum ActorName {
    /// As in the log.
    Replay,
    /// Vehicles and cycles near the ego follow their paths by the Intelligent Driver Model.
    Idm,
    /// Actors near the ego keep speed and curvature, and brake.
    Reactive,
}

impl EgoName {
    /// Returns the name on the command line.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Replay => "replay",
            Self::Straight => "straight",
            Self::RightThenBack => "right_then_back",
            Self::Cosine => "cosine",
            Self::LaneChange => "lane_change",
            Self::File => "file",
            Self::External => "external",
        }
    }
}
