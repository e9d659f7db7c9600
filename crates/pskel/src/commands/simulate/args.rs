#[cfg(feature = "mcap")]
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use clap::Args;
use point_skeleton::Log;
#[cfg(feature = "mcap")]
use point_skeleton::conditions::MapFormat;
use point_skeleton::dataset::{ChangedLog, LogOpener, Recording};
use point_skeleton::files::{Inputs as InputPaths, OutputFile};
use point_skeleton::scene::{EgoOffset, SceneMap, frame_rate_hz};
#[cfg(feature = "network")]
use pskel_eval::protocol::ClipClock;
#[cfg(feature = "mcap")]
use pskel_sim::rollout::MCAP;
use pskel_sim::rollout::Profile;
use pskel_sim::{
    ActorPolicy, EgoKind, EgoPolicy, PathAnchor, PlannerAddress, PlannerSpec, Scenario, SimOptions,
};

use super::generation::{GeneratorArgs, GivenImages};
use super::inputs::Inputs;
use super::policies::PolicyArgs;
use crate::args::actors::ActorArgs;
#[cfg(feature = "network")]
use crate::args::actors::ScenarioArgs;
use crate::args::lidar::LidarArgs;
use crate::args::maps::MapArgs;
use crate::args::numbers;
use crate::args::outputs::{self, FolderArgs};
use crate::args::prompt::PromptArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::rollout::RolloutArgs;
use crate::args::source::SourceArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::{WrongUsage, warn};

/// Help of `--steps`.
const STEPS: &str = "Number of simulation steps; step 0 is the log's. A replayed ego stops when the log \
    ends. With other policies it drives on: only actors under a policy remain there, and the skeleton may \
    have no points";

/// Simulate a recording in a closed loop: ego and other actors move by policies, and every step is rendered
///
/// Writes steps/STEP with the maps (as render writes a frame), birdseye.png, view/MAP.jpg (images of the
/// page) and state.json (for --resume); states.jsonl, one line per step; finally metrics.json, index.json,
/// rollout.mp4 and index.html, a page that plays the rollout. If a planner fails, all of these are written
/// for the steps before the failure.
#[derive(Debug, Args)]
#[command(mut_arg("steps", |arg| arg.required(true).help(STEPS)))]
pub(crate) struct SimulateArgs {
    #[command(flatten)]
    pub(super) source: SourceArgs,
    #[command(flatten)]
    pub(super) folder: FolderArgs,
    #[command(flatten)]
    pub(super) rollout: RolloutArgs,
    /// Also write steps/STEP/sheet.png, a contact sheet of all maps
    #[arg(long)]
    pub(super) sheets: bool,
    /// Also render the forecasts for the next K planning steps (default 9, at most 100) at each planning
    /// step, as steps/STEP/forecast/STEP
    #[arg(long, value_name = "K", num_args = 0..=1, default_missing_value = "9")]
    #[arg(value_parser = numbers::forecast_steps, allow_negative_numbers = true)]
    forecast_maps: Option<usize>,
    /// Write nothing below --out and only print the times, to measure the loop without output
    #[arg(long, conflicts_with_all = ["resume", "resume_from"])]
    pub(super) dry: bool,
    /// Also write the rollout to an MCAP file for Foxglove, Lichtblick and Rerun, after its last step:
    /// images, poses, boxes, plans, events and metrics. Maps need --format png; with --dry there are no
    /// images
    #[cfg(feature = "mcap")]
    #[arg(long, value_name = "F.mcap")]
    pub(super) mcap: Option<PathBuf>,
    #[command(flatten)]
    pub(super) prompt: PromptArgs,
    #[command(flatten)]
    policies: PolicyArgs,
    #[command(flatten)]
    pub(super) generator: GeneratorArgs,
    #[command(flatten)]
    pub(super) maps: MapArgs,
    #[command(flatten)]
    pub(super) lidar: LidarArgs,
    #[command(flatten)]
    pub(super) actors: ActorArgs,
    #[command(flatten)]
    pub(super) substitutes: SubstituteArgs,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
    /// Set if steps are frames of the log, until its end at most; used by `pskel generate`.
    #[arg(skip)]
    frames: Option<EveryFrames>,
    /// Displacement of the ego at all frames; used by `pskel generate`.
    #[arg(skip)]
    ego_offset: Option<EgoOffset>,
    /// Whether the policies take over with the first generated frame, as in the paper; used by `pskel
    /// protocol`.
    #[arg(skip)]
    least_warmup: bool,
    /// Whether generated images replace the data set's; used by `pskel generate`.
    #[arg(skip)]
    copies_dataset: bool,
    /// Images of another program in the place of a generator; used by `pskel protocol`.
    #[arg(skip)]
    pub(super) images: GivenImages,
    /// Keeps the tables of a data set between its logs; used by `pskel protocol`.
    #[arg(skip)]
    opener: Arc<LogOpener>,
}

/// Files besides the output folder.
pub(super) struct OutputFiles {
    pub(super) profile: Option<OutputFile>,
    #[cfg(feature = "mcap")]
    pub(super) mcap: Option<OutputFile>,
}

/// Stride of the log's frames that are steps; `None` selects the default.
#[derive(Clone, Copy, Debug)]
struct EveryFrames(Option<usize>);

/// Options for generating a clip of a log.
#[cfg(feature = "network")]
pub(crate) struct ClipArgs {
    pub(crate) source: SourceArgs,
    pub(crate) folder: FolderArgs,
    /// Steps to the end of the log at most, unless the clock has rates.
    pub(crate) rollout: RolloutArgs,
    /// `None` for the frames of the log, at the default stride.
    pub(crate) clock: Option<ClipClock>,
    pub(crate) ego: EgoKind,
    /// Planner of [`EgoKind::External`].
    pub(crate) planner: Option<PlannerAddress>,
    pub(crate) actors: ActorPolicy,
    pub(crate) least_warmup: bool,
    pub(crate) ego_offset: Option<EgoOffset>,
    /// Whether generated images replace the data set's.
    pub(crate) copies_dataset: bool,
    pub(crate) prompt: PromptArgs,
    pub(crate) generator: GeneratorArgs,
    /// Images of another program in the place of the generator's.
    pub(crate) images: GivenImages,
    pub(crate) maps: MapArgs,
    pub(crate) lidar: LidarArgs,
    pub(crate) scenario: ScenarioArgs,
    pub(crate) substitutes: SubstituteArgs,
    pub(crate) rasterizer: RasterizerArgs,
    pub(crate) opener: Arc<LogOpener>,
}

impl SimulateArgs {
    #[cfg(feature = "network")]
    /// Creates options for generating a clip of a log.
    pub(crate) fn of_clip(clip: ClipArgs) -> Self {
        let (frames, rates) = match clip.clock {
            None => (Some(EveryFrames(None)), None),
            Some(ClipClock::Frames(every)) => (Some(EveryFrames(Some(every))), None),
            Some(ClipClock::Rates(rates)) => (None, Some(rates)),
        };
        Self {
            source: clip.source,
            folder: clip.folder,
            rollout: clip.rollout,
            sheets: false,
            forecast_maps: None,
            dry: false,
            #[cfg(feature = "mcap")]
            mcap: None,
            prompt: clip.prompt,
            policies: PolicyArgs::of_clip((clip.ego, clip.planner), clip.actors, rates),
            generator: clip.generator,
            maps: clip.maps,
            lidar: clip.lidar,
            actors: ActorArgs::of_scenario(clip.scenario),
            substitutes: clip.substitutes,
            rasterizer: clip.rasterizer,
            frames,
            ego_offset: clip.ego_offset,
            least_warmup: clip.least_warmup,
            copies_dataset: clip.copies_dataset,
            images: clip.images,
            opener: clip.opener,
        }
    }

    /// Checks options that the parser cannot check.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
        let PolicyArgs { ego, trajectory, reanchor, planner, .. } = &self.policies;
        let unused = [
            ("--trajectory", trajectory.is_some() && *ego != EgoKind::File, "file"),
            ("--reanchor", *reanchor && *ego != EgoKind::File, "file"),
            ("--planner", planner.is_some() && *ego != EgoKind::External, "external"),
        ];
        if let Some((option, _, name)) = unused.into_iter().find(|(_, unused, _)| *unused) {
            return Err(WrongUsage(format!("expected --ego {name} with {option}, found {}", ego.name())));
        }
        self.generator.check()?;
        self.maps.check()
    }

    /// Returns a note if the MCAP file has no maps although they are written.
    pub(super) fn note_on_maps(&self) -> Option<&'static str> {
        #[cfg(feature = "mcap")]
        if self.mcap.is_some() && !self.dry && self.maps.format != MapFormat::Png {
            return Some("the file of --mcap has no maps, which are only copied with --format png");
        }
        None
    }

    /// Returns a note if policies that leave the log decide less than half of the steps. Protocols choose
    /// their warm-up themselves.
    pub(super) fn note_on_warmup(&self, log: &Recording, takeover: usize, steps: usize) -> Option<String> {
        let follows_log = self.follow_log(log) == [true, true];
        (!follows_log && !self.least_warmup && 2 * takeover > steps).then(|| {
            format!(
                "warm-up: the policies take over at step {takeover} of {steps}; more --steps or a lower \
                    ratio of --sim-hz to --plan-hz give them more"
            )
        })
    }

    /// Returns everything that is read.
    pub(super) fn input_paths(&self) -> InputPaths {
        let files =
            [self.prompt.annotations.as_deref(), self.policies.trajectory.as_deref(), self.actors.file()];
        self.source
            .inputs()
            .and(files.into_iter().flatten())
            .and(self.generator.inputs())
            .and(self.substitutes.inputs())
            .and(self.lidar.inputs())
    }

    /// Opens the files besides the output folder that the command writes. `read` is everything that it reads.
    pub(super) fn open_files(&self, read: &InputPaths) -> anyhow::Result<OutputFiles> {
        let folder = (!self.dry).then_some(self.folder.out.as_path());
        let profile = ("--profile", self.rollout.profile.as_deref(), Profile::KIND);
        #[cfg(feature = "mcap")]
        {
            let mcap = ("--mcap", self.mcap.as_deref(), MCAP);
            let [profile, mcap] = outputs::open([profile, mcap], read, folder)?;
            Ok(OutputFiles { profile, mcap })
        }
        #[cfg(not(feature = "mcap"))]
        {
            let [profile] = outputs::open([profile], read, folder)?;
            Ok(OutputFiles { profile })
        }
    }

    /// Reads the inputs.
    pub(super) fn inputs(&self) -> anyhow::Result<Inputs> {
        let mut source = self.source.roots.open_by(&self.source.log, &self.opener)?;
        // The skeleton belongs to the recording, where the ego has not moved.
        let unmoved = self.ego_offset.map(|_| source.recording().clone());
        if let Some(offset) = self.ego_offset {
            let moved = ChangedLog::with_moved_ego(source.into_reader(), offset).with_context(|| {
                format!(
                    "expected a synthetic log (town:..) with --ego-offset, since recorded logs have no \
                        images at other poses, found {}",
                    self.source.log
                )
            })?;
            source = Log::new(Box::new(moved));
        }
        let source = self.actors.edit(&source)?;
        let log = source.recording();
        let skeleton = self.source.open_skeleton(unmoved.as_ref().unwrap_or(source.unedited()))?;
        let prompt = self.prompt.read()?;
        let map = self.read_map(&source)?;
        let maps = self.maps.kinds(map.is_some()).with_context(|| {
            format!(
                "expected an HD map of {:?} for --maps map, found none in log {}",
                log.location,
                log.shown_name()
            )
        })?;
        Ok(Inputs { log: source, skeleton, prompt, map, maps })
    }

    /// Reads the HD map. A damaged one that is not drawn is an error only with `--missing error`.
    fn read_map(&self, log: &Log) -> anyhow::Result<Option<Arc<SceneMap>>> {
        let is_drawn = self.generator.generates() || !self.dry && self.maps.wants_map();
        if is_drawn {
            return Ok(log.require_map()?);
        }
        let map = log.optional_map()?;
        if let Some(error) = log.map_error() {
            warn(&format!("the HD map cannot be read, so metrics of the road are missing: {error}"));
        }
        Ok(map)
    }

    /// Returns the number of planning steps to forecast and render at each planning step.
    pub(super) fn forecast_steps(&self) -> usize {
        self.forecast_maps.unwrap_or(0)
    }

    /// Returns the stride of the frames that are steps, `None` if steps are not frames, and the number of
    /// steps.
    fn frames_of(&self, scenario: &Scenario<'_>) -> anyhow::Result<(Option<usize>, usize)> {
        let wanted = self.rollout.steps.unwrap_or(usize::MAX);
        let Some(EveryFrames(every)) = self.frames else { return Ok((None, wanted)) };
        let frames = &scenario.log.frames;
        let nearest = || {
            let hz = frame_rate_hz(frames).unwrap_or(scenario.rates.plan_hz);
            (hz / scenario.rates.plan_hz).round().max(1.0) as usize
        };
        let every = every.unwrap_or_else(nearest);
        let start = self.rollout.start.unwrap_or(i64::MIN);
        let available = frames.iter().filter(|frame| frame.t_us >= start).count();
        anyhow::ensure!(
            available > every,
            "expected more than {every} frames from --start on (--every {every}), found {available} in \
                log {}",
            scenario.log.shown_name()
        );
        Ok((Some(every), wanted.min((available - 1) / every)))
    }

    /// Returns whether ego and other actors follow the log throughout.
    pub(super) fn follow_log(&self, log: &Recording) -> [bool; 2] {
        let actors = self.policies.actors == ActorPolicy::Replay && log.edits.is_empty();
        [self.policies.ego == EgoKind::Replay, actors]
    }

    /// Returns whether steps are the log's own frames, as in `pskel generate`.
    pub(super) fn is_open_loop(&self) -> bool {
        self.frames.is_some()
    }

    /// Returns the warm-up's frame count: at least as many as a generator with this `window` has references.
    pub(super) fn warmup_frames(&self, window: Option<usize>) -> Result<usize, WrongUsage> {
        let (given, least) = (self.policies.warmup, window.map_or(0, |window| window - 1));
        if let Some(warmup) = given.filter(|warmup| *warmup < least) {
            let message = format!(
                "expected --warmup of {least} or more, the references of the generator, found {warmup}"
            );
            return Err(WrongUsage(message));
        }
        let default = if self.least_warmup { window.map(|window| window - 1) } else { window };
        Ok(given.or(default).unwrap_or(SimOptions::default().warmup_frames))
    }

    /// Checks that there are steps after the references of a generator with this `window`, if their images
    /// are needed.
    pub(super) fn check_steps(&self, steps: usize, window: Option<usize>) -> Result<(), WrongUsage> {
        let references = window.map_or(0, |window| window - 1);
        if !self.copies_dataset || steps + 1 > references {
            return Ok(());
        }
        let message = format!(
            "expected {references} steps or more with --dataset, since the first {references} frames are \
                references, found {steps}"
        );
        Err(WrongUsage(message))
    }

    /// Returns the simulation options except for the warm-up; reads the trajectory.
    pub(super) fn sim_options(&self, scenario: &Scenario<'_>) -> anyhow::Result<SimOptions> {
        let p = &self.policies;
        let (every_frames, steps) = self.frames_of(scenario)?;
        let anchor = if p.reanchor { PathAnchor::EachPlan } else { PathAnchor::Takeover };
        let file = p.trajectory.as_deref().map(|path| EgoPolicy::read(path, anchor)).transpose()?;
        let spec =
            |address: &PlannerAddress| PlannerSpec { address: address.clone(), timeout_s: p.planner_timeout };
        // The parser requires the arguments of these policies.
        let ego = EgoPolicy::new(p.ego, file, p.planner.as_ref().map(spec)).unwrap_or(EgoPolicy::Replay);
        Ok(SimOptions {
            seed: p.seed,
            steps,
            sim_hz: p.sim_hz,
            plan_hz: p.plan_hz,
            every_frames,
            start_us: self.rollout.start,
            ego,
            tracking: p.tracking,
            actors: p.actors,
            ..SimOptions::default()
        })
    }
}
