use std::path::PathBuf;

use clap::Args;
use pskel_sim::{ActorPolicy, EgoKind, PlannerAddress, Tracking};

use crate::args::names::{names, names_of};
use crate::args::numbers;

/// Policies of ego and actors, and their rates.
#[derive(Debug, Args)]
pub(super) struct PolicyArgs {
    /// Policy of the ego after the warm-up
    #[arg(long, value_name = "POLICY", default_value_t = EgoKind::Replay)]
    #[arg(value_parser = names_of(EgoKind::OF_COMMAND))]
    pub(super) ego: EgoKind,
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
    #[arg(long, default_value_t, value_parser = names::<Tracking>())]
    pub(super) tracking: Tracking,
    /// Policy of the other actors after the warm-up
    #[arg(long, value_name = "POLICY", default_value_t, value_parser = names::<ActorPolicy>())]
    pub(super) actors: ActorPolicy,
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
