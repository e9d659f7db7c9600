use std::path::PathBuf;

use clap::Args;
#[cfg(feature = "network")]
use pskel_sim::Rates;
use pskel_sim::{ActorPolicy, EgoKind, PlannerAddress, Tracking};

use crate::args::names::{names, names_of};
use crate::args::numbers;

/// Policies of ego and actors, and their rates.
#[derive(Debug, Args)]
#[command(next_help_heading = "Policies")]
pub(super) struct PolicyArgs {
    /// Policy of the ego after the warm-up. lane_change needs about 5 s at 10 m/s
    #[arg(long, value_name = "POLICY", default_value_t = EgoKind::Replay)]
    #[arg(value_parser = names_of(EgoKind::OF_COMMAND))]
    pub(super) ego: EgoKind,
    /// With --ego file: the path in the ego's frame, meters forward and to the left; JSON, CSV, TXT or NPY.
    /// Or waypoints with times in the global frame; JSON
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
    /// Warm-up: the ego and all actors follow the log until planning step N - 1, that is for the first
    /// (N - 1) * SIM_HZ / PLAN_HZ steps [default: 1; with --generator its window, whose other frames are
    /// references]
    #[arg(long, value_name = "N")]
    pub(super) warmup: Option<usize>,
    /// Seed that is passed to planners
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) seed: u64,
}

impl PolicyArgs {
    /// Creates the policies for a clip of a log, with a planner for an external ego.
    #[cfg(feature = "network")]
    pub(super) fn of_clip(
        (ego, planner): (EgoKind, Option<PlannerAddress>),
        actors: ActorPolicy,
        rates: Option<Rates>,
    ) -> Self {
        Self {
            ego,
            trajectory: None,
            reanchor: false,
            planner,
            planner_timeout: 10.0,
            tracking: Tracking::Perfect,
            actors,
            sim_hz: rates.map(|rates| rates.sim_hz),
            plan_hz: rates.map(|rates| rates.plan_hz),
            warmup: None,
            seed: 0,
        }
    }
}
