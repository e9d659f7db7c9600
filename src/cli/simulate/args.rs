use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::cli::WrongUsage;
use crate::cli::generator::{GeneratorArgs, NetworkName};
use crate::cli::log_args::{self, LogRoots};
use crate::cli::map_args::MapArgs;
use crate::cli::numbers;
use crate::cli::rasterizer::RasterizerArgs;
use crate::cli::stand_ins::StandInArgs;
use crate::dataset::LogLocator;
use crate::scene::frame_rate_hz;
use crate::sim::{
    ActorPolicy, EgoPolicy, LocalPath, PlannerAddress, PlannerSpec, Scenario, SimOptions, Tracking,
};

/// As many as a generator sees at once beside the frame that is there.
const FORECAST_STEPS: usize = 9;

/// Simulate a drive in a closed loop: ego and others move by policies, and every step is rendered
///
/// Writes steps/STEP with the maps (as render writes a frame), birdseye.png, view/MAP.jpg (what the page shows) and
/// state.json (what --resume needs); states.jsonl, a line a step; at the end metrics.json, index.json, rollout.mp4 and
/// index.html, a page that plays the rollout. If a planner fails, all of it is there for the steps until then.
#[derive(Debug, Args)]
pub(in crate::cli) struct SimulateArgs {
    /// Drive: FORMAT:PATH[@VERSION][#SCENE], like nuscenes:/data/nuscenes@v1.0-mini#scene-0061
    #[arg(value_parser = log_args::log)]
    pub(super) log: LogLocator,
    #[command(flatten)]
    pub(super) roots: LogRoots,
    /// Skeleton that was built from it
    #[arg(long, value_name = "SKEL")]
    pub(super) skeleton: PathBuf,
    /// Folder to write: a new or empty one, or an earlier rollout, which is replaced
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
    pub(super) out: PathBuf,
    /// How many steps to take; step 0 is the log's. An ego that replays ends with the log; others drive on beyond its end,
    /// where nobody is left but actors that a policy has taken over, and the skeleton may have no points
    #[arg(long, value_name = "N")]
    pub(super) steps: usize,
    #[command(flatten)]
    policies: PolicyArgs,
    #[command(flatten)]
    pub(super) maps: MapArgs,
    /// Also render at each plan step what is expected at the next ones, as steps/STEP/forecast/STEP
    #[arg(long)]
    forecast_maps: bool,
    /// With --forecast-maps: how many plan steps are forecast, 1 to 100
    #[arg(long, value_name = "K", default_value_t = FORECAST_STEPS, value_parser = numbers::forecast_steps)]
    #[arg(requires = "forecast_maps", allow_negative_numbers = true)]
    forecast: usize,
    /// Also write steps/STEP/sheet.png with all maps at a glance
    #[arg(long)]
    pub(super) sheets: bool,
    /// Go on with the rollout in --out behind its last step, with the same log, skeleton and options; --steps,
    /// --planner-timeout, --generator-timeout, --profile and the rasterizer may change
    #[arg(long)]
    pub(super) resume: bool,
    /// Go on behind this step; later ones are made anew
    #[arg(long, value_name = "STEP")]
    pub(super) resume_from: Option<usize>,
    /// Write nothing below --out, only tell the times: how fast is the loop without writing?
    #[arg(long, conflicts_with_all = ["resume", "resume_from"])]
    pub(super) dry: bool,
    /// Write the times of all steps and stages to this file
    #[arg(long, value_name = "F.json")]
    pub(super) profile: Option<PathBuf>,
    /// For the prompt in meta.json: {"weather": "Sunny", "city": "Boston"}, either may be missing
    #[arg(long, value_name = "F.json")]
    pub(super) annotations: Option<PathBuf>,
    /// Also make the images that the cameras would see, by a network: `network`, which comes with the program,
    /// network:FILE with weights of `pskel train`, or process:COMMAND, process:unix:PATH or process:tcp:HOST:PORT
    /// (docs/DENOISER.md). At each plan step it writes steps/STEP/generated, and truth where that is known. Options of
    /// maps are for the maps that are written: what the network sees is drawn as it was trained for
    #[arg(long, value_name = "NETWORK")]
    pub(super) generator: Option<NetworkName>,
    #[command(flatten)]
    pub(super) stand_ins: StandInArgs,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
    #[command(flatten, next_help_heading = "Options of --generator")]
    pub(super) generating: GeneratorArgs,
    /// Steps are frames of the log, to its end if there are that many; `pskel generate` asks for that.
    #[arg(skip)]
    frames: Option<EveryFrames>,
}

/// Every so many-th frame of the log is a step.
#[derive(Clone, Copy, Debug)]
struct EveryFrames(Option<usize>);

/// A log that is replayed frame by frame.
pub(in crate::cli) struct OpenLoop {
    pub(in crate::cli) log: LogLocator,
    pub(in crate::cli) roots: LogRoots,
    pub(in crate::cli) skeleton: PathBuf,
    pub(in crate::cli) out: PathBuf,
    pub(in crate::cli) generator: NetworkName,
    pub(in crate::cli) generating: GeneratorArgs,
    pub(in crate::cli) steps: usize,
    pub(in crate::cli) every: Option<usize>,
    pub(in crate::cli) start: Option<i64>,
    pub(in crate::cli) maps: MapArgs,
    pub(in crate::cli) resume: bool,
    pub(in crate::cli) resume_from: Option<usize>,
    pub(in crate::cli) profile: Option<PathBuf>,
    pub(in crate::cli) annotations: Option<PathBuf>,
    pub(in crate::cli) stand_ins: StandInArgs,
    pub(in crate::cli) rasterizer: RasterizerArgs,
}

/// Who moves, and how often.
#[derive(Debug, Args)]
struct PolicyArgs {
    /// Who drives the ego after the warm-up
    #[arg(long, value_enum, value_name = "POLICY", default_value = "replay")]
    ego: EgoName,
    /// With --ego file: the path in the ego's frame, metres forward and to the left; JSON, CSV, TXT or NPY
    #[arg(long, value_name = "FILE", required_if_eq("ego", "file"))]
    trajectory: Option<PathBuf>,
    /// With --ego external: a command, which talks over its standard input and output, or a socket that it listens at,
    /// unix:PATH or tcp:HOST:PORT
    #[arg(long, value_name = "COMMAND|ADDRESS", required_if_eq("ego", "external"))]
    planner: Option<PlannerAddress>,
    /// How long to wait for each answer of the planner, seconds
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    planner_timeout: f64,
    /// How the ego follows what was planned
    #[arg(long, value_enum, default_value = "perfect")]
    tracking: TrackingName,
    /// Who moves the others after the warm-up
    #[arg(long, value_enum, value_name = "POLICY", default_value = "replay")]
    actors: ActorName,
    /// Steps a second [default: 12 of nuScenes, 10 of other logs]
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    sim_hz: Option<f64>,
    /// Plans a second, which divide the steps [default: 2 of nuScenes, 5 of other logs]
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    plan_hz: Option<f64>,
    /// Frames of a generator's window, one a plan: the first (N - 1) * SIM_HZ / PLAN_HZ steps follow the log [default: 1;
    /// with --generator its window]
    #[arg(long, value_name = "N")]
    warmup: Option<usize>,
    /// Start at this time, absolute microseconds [default: the log's first frame]
    #[arg(long, value_name = "T_US", allow_negative_numbers = true)]
    start: Option<i64>,
    /// Seed, told to planners
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
}

/// Names of [`EgoPolicy`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[value(rename_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub(super) enum EgoName {
    /// Where the log's ego drove.
    Replay,
    /// Straight on.
    Straight,
    /// To the right, more and more.
    RightThenBack,
    /// 1.5 m to the right along half a wave.
    Cosine,
    /// One lane to the right of the recorded path, at 10 m/s.
    LaneChange,
    /// Along the points of --trajectory.
    File,
    /// As --planner says.
    External,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
enum TrackingName {
    /// The ego is where the plan says.
    Perfect,
    /// A kinematic bicycle with limits follows the plan.
    Bicycle,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
enum ActorName {
    /// As in the log.
    Replay,
    /// Vehicles follow their paths by the Intelligent Driver Model.
    Idm,
    /// All keep speed and curve, and brake.
    Reactive,
}

impl SimulateArgs {
    /// Ego and actors follow the log; its frames are the steps.
    pub(in crate::cli) fn open_loop(open: OpenLoop) -> Self {
        let policies = PolicyArgs {
            ego: EgoName::Replay,
            trajectory: None,
            planner: None,
            planner_timeout: 10.0,
            tracking: TrackingName::Perfect,
            actors: ActorName::Replay,
            sim_hz: None,
            plan_hz: None,
            warmup: None,
            start: open.start,
            seed: 0,
        };
        Self {
            log: open.log,
            roots: open.roots,
            skeleton: open.skeleton,
            out: open.out,
            steps: open.steps,
            policies,
            maps: open.maps,
            forecast_maps: false,
            forecast: FORECAST_STEPS,
            sheets: false,
            resume: open.resume,
            resume_from: open.resume_from,
            dry: false,
            profile: open.profile,
            annotations: open.annotations,
            generator: Some(open.generator),
            generating: open.generating,
            stand_ins: open.stand_ins,
            rasterizer: open.rasterizer,
            frames: Some(EveryFrames(open.every)),
        }
    }

    /// Options that the parser cannot check.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
        let PolicyArgs { ego, trajectory, planner, .. } = &self.policies;
        let unused = [
            ("--trajectory", trajectory.is_some() && *ego != EgoName::File, "file"),
            ("--planner", planner.is_some() && *ego != EgoName::External, "external"),
        ];
        if let Some((option, _, name)) = unused.into_iter().find(|(_, unused, _)| *unused) {
            return Err(WrongUsage(format!("expected --ego {name} with {option}, found {}", ego.name())));
        }
        self.generating.check(self.generator.as_ref())?;
        self.maps.check()
    }

    /// Files that are named one by one and only read.
    pub(super) fn input_files(&self) -> impl Iterator<Item = &Path> {
        let weights = match &self.generator {
            Some(NetworkName::Network(weights)) => weights.as_deref(),
            _ => None,
        };
        [self.annotations.as_deref(), self.policies.trajectory.as_deref(), weights].into_iter().flatten()
    }

    /// How many plan steps are forecast and rendered at each of them.
    pub(super) fn forecast_steps(&self) -> usize {
        if self.forecast_maps { self.forecast } else { 0 }
    }

    /// Every so many-th frame that is a step, if frames are steps, and how many steps there are to take.
    fn frames_of(&self, scenario: &Scenario<'_>) -> anyhow::Result<(Option<usize>, usize)> {
        let Some(EveryFrames(every)) = self.frames else { return Ok((None, self.steps)) };
        let frames = &scenario.log.frames;
        let nearest = || {
            let hz = frame_rate_hz(frames).unwrap_or(scenario.rates.plan_hz);
            (hz / scenario.rates.plan_hz).round().max(1.0) as usize
        };
        let every = every.unwrap_or_else(nearest);
        let start = self.policies.start.unwrap_or(i64::MIN);
        let there = frames.iter().filter(|frame| frame.t_us >= start).count();
        anyhow::ensure!(
            there > every,
            "expected more than {every} frames from --start on (--every {every}), found {there} in log {}",
            scenario.log.shown_name()
        );
        Ok((Some(every), self.steps.min((there - 1) / every)))
    }

    /// Whether ego and others follow the log all along.
    pub(super) fn follow_log(&self) -> [bool; 2] {
        [self.policies.ego == EgoName::Replay, matches!(self.policies.actors, ActorName::Replay)]
    }

    /// Whether steps are the log's own frames, as `pskel generate` has it.
    pub(super) fn is_open_loop(&self) -> bool {
        self.frames.is_some()
    }

    /// Name of the ego's policy.
    pub(super) fn ego_name(&self) -> &'static str {
        self.policies.ego.name()
    }

    /// Name of the others' policy.
    pub(super) fn actors_name(&self) -> &'static str {
        match self.policies.actors {
            ActorName::Replay => "replay",
            ActorName::Idm => "idm",
            ActorName::Reactive => "reactive",
        }
    }

    /// What is to be simulated; reads the trajectory. A generator with a window of `window` frames needs as many for its warm-up.
    pub(super) fn sim_options(
        &self,
        scenario: &Scenario<'_>,
        window: Option<usize>,
    ) -> anyhow::Result<SimOptions> {
        let p = &self.policies;
        let (every_frames, steps) = self.frames_of(scenario)?;
        let least = window.unwrap_or(0);
        if let Some(warmup) = p.warmup.filter(|warmup| *warmup < least) {
            let message =
                format!("expected --warmup of {least} or more, the generator's window, found {warmup}");
            return Err(WrongUsage(message).into());
        }
        let ego = match (p.ego, &p.trajectory, &p.planner) {
            (EgoName::Straight, ..) => EgoPolicy::Straight,
            (EgoName::RightThenBack, ..) => EgoPolicy::RightThenBack,
            (EgoName::Cosine, ..) => EgoPolicy::Cosine,
            (EgoName::LaneChange, ..) => EgoPolicy::LaneChange,
            (EgoName::File, Some(path), _) => EgoPolicy::File(LocalPath::read(path)?),
            (EgoName::External, _, Some(address)) => {
                EgoPolicy::External(PlannerSpec { address: address.clone(), timeout_s: p.planner_timeout })
            }
            // The parser asks for what File and External need.
            (EgoName::Replay | EgoName::File | EgoName::External, ..) => EgoPolicy::Replay,
        };
        Ok(SimOptions {
            seed: p.seed,
            steps,
            sim_hz: p.sim_hz,
            plan_hz: p.plan_hz,
            every_frames,
            warmup_frames: p.warmup.or(window).unwrap_or(SimOptions::default().warmup_frames),
            start_us: p.start,
            ego,
            tracking: match p.tracking {
                TrackingName::Perfect => Tracking::Perfect,
                TrackingName::Bicycle => Tracking::Bicycle,
            },
            actors: match p.actors {
                ActorName::Replay => ActorPolicy::Replay,
                ActorName::Idm => ActorPolicy::Idm,
                ActorName::Reactive => ActorPolicy::Reactive,
            },
        })
    }
}

impl EgoName {
    /// As on the command line.
    fn name(self) -> &'static str {
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
