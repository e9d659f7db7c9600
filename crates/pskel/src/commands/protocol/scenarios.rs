//! Driving scores of a policy or planner over many rollouts.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use point_skeleton::dataset::{LogLocator, LogOpener};
use point_skeleton::error::{FileError, with_causes};
use point_skeleton::files::input::is_there;
use point_skeleton::files::{Inputs, OutputFolder, write_json, write_whole};
use point_skeleton::skeleton;
use pskel_eval::protocol::{Clip, ScenarioReport, ScenarioRollout, check_settings, scenario_clips};
use pskel_sim::report::ROLLOUT;
use pskel_sim::rollout;
use pskel_sim::{ActorPolicy, EgoKind, PlannerAddress, Rates};
use serde_json::json;

use super::super::simulate::{self, ClipArgs, SimulateArgs};
use super::logs::ProtocolLogs;
use crate::args::actors;
use crate::args::generator::GeneratorArgs;
use crate::args::lidar::LidarArgs;
use crate::args::maps::MapArgs;
use crate::args::names::{names, names_of};
use crate::args::outputs::FolderArgs;
use crate::args::prompt::PromptArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::rollout::RolloutArgs;
use crate::args::source::SourceArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::{logs, print_progress, print_result};

/// Files in the folder itself.
const FILES: [&str; 3] = ["protocol.json", "results.json", "table.md"];
/// Name of the change that changes nothing.
const RECORDED: &str = "recorded";

/// Any logs: driving scores of a policy or planner over many rollouts, with confidence intervals
///
/// Starts rollouts evenly spaced in each log. Writes a rollout per start, CHANGE/CLIP, then table.md and
/// results.json with PDMS, EPDMS and their sub-scores, NeuroNCAP, route completion and AlpaSim's fields.
/// Finished rollouts are retained and others resumed, so the same command continues an interrupted run. Logs
/// that fail are reported at the end.
#[derive(Debug, Args)]
pub(crate) struct ScenarioArgs {
    #[command(flatten)]
    given: ProtocolLogs,
    /// Policy of the ego
    #[arg(long, value_name = "POLICY", default_value_t = EgoKind::Replay)]
    #[arg(value_parser = names_of(EgoKind::OF_COMMAND))]
    ego: EgoKind,
    /// With --ego external: a command that communicates over its standard input and output, or the socket on
    /// which it listens, unix:PATH or tcp:HOST:PORT
    #[arg(long, value_name = "COMMAND|ADDRESS", required_if_eq("ego", "external"))]
    planner: Option<PlannerAddress>,
    /// Policy of the other actors
    #[arg(long, value_name = "POLICY", default_value_t, value_parser = names::<ActorPolicy>())]
    actors: ActorPolicy,
    /// Scenarios, each simulated on all logs. The table has a row for a file's name without its number, as
    /// side for side-3.json [default: the log as it was recorded]
    #[arg(long, value_name = "FILE,..", value_delimiter = ',')]
    scenario: Vec<PathBuf>,
    /// Length of a rollout, seconds; PDM scores need 4
    #[arg(long, value_name = "S", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..))]
    seconds: u16,
    /// Time between the starts of rollouts, seconds
    #[arg(long, value_name = "S", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..))]
    every: u16,
    /// At most this number of rollouts per recording and change [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    clips: Option<u16>,
    /// Name of the method in tables [default: the policy, or the planner]
    #[arg(long, value_name = "NAME")]
    method: Option<String>,
    #[command(flatten)]
    prompt: PromptArgs,
    #[command(flatten)]
    generator: GeneratorArgs,
    #[command(flatten)]
    maps: MapArgs,
    #[command(flatten)]
    lidar: LidarArgs,
    #[command(flatten)]
    substitutes: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// What is changed in a log before its rollouts.
#[derive(Clone, Debug)]
struct Change {
    /// Name, also of the folder.
    name: String,
    /// Name of the group in the table.
    family: String,
    scenario: actors::ScenarioArgs,
}

/// Simulates all rollouts, writes the table.
pub(super) fn run(args: &ScenarioArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    args.maps.check()?;
    let opener = Arc::<LogOpener>::default();
    let logs = args.given.expand()?;
    let files = OutputFolder::open(&args.given.folder.out, "protocol", &args.inputs(&logs))?;
    files.check(FILES)?;
    args.settle(&files)?;
    let changes = args.changes()?;
    let (mut rollouts, mut failures) = (Vec::new(), 0_usize);
    for locator in &logs {
        match args.simulate(locator, &changes, &files, &opener) {
            Ok(done) => rollouts.extend(done),
            Err(error) => {
                print_progress(&format!("failed: {locator}: {}", with_causes(error.as_ref())));
                failures += 1;
            }
        }
    }
    anyhow::ensure!(failures < logs.len(), "every recording failed: {failures}");
    let report = ScenarioReport::read(&args.method_name(), &rollouts)?;
    write_json(&files.claim("results.json")?, &report)?;
    let (path, table) = (files.claim("table.md")?, report.table());
    write_whole(&path, |out| {
        std::io::Write::write_all(out, table.as_bytes()).map_err(FileError::io("write", &path))
    })?;
    files.close()?;
    print_result(table.trim_end());
    let (count, seconds) = (rollouts.len(), start.elapsed().as_secs_f64());
    print_result(&format!("{count} rollouts in {seconds:.2} s: {}", args.given.folder.out.display()));
    anyhow::ensure!(failures == 0, "failed recordings: {failures}");
    Ok(())
}

impl ScenarioArgs {
    /// Returns everything that is read, except for skeletons.
    fn inputs(&self, logs: &[LogLocator]) -> Inputs {
        Inputs::new(logs.iter().flat_map(LogLocator::inputs))
            .and(&self.prompt.annotations)
            .and(&self.scenario)
            .and(self.generator.inputs())
            .and(self.substitutes.inputs())
            .and(self.lidar.inputs())
    }

    /// Writes the settings, or compares them with an earlier run's.
    fn settle(&self, files: &OutputFolder) -> anyhow::Result<()> {
        let settings = json!({
            "protocol": "scenarios",
            "method": self.method_name(),
            "ego": self.ego.name(),
            "planner": self.planner.as_ref().map(ToString::to_string),
            "actors": self.actors.name(),
            "seconds": self.seconds,
            "every": self.every,
            "clips": self.clips,
            "scenarios": self.scenario,
            "lidar": self.lidar.unmounted()?,
        });
        let path = files.claim(FILES[0])?;
        check_settings(&path, &settings)?;
        Ok(write_json(&path, &settings)?)
    }

    /// Returns the changes of each log: those of the scenarios, or none.
    ///
    /// # Errors
    /// Fails if two files have the same name.
    fn changes(&self) -> anyhow::Result<Vec<Change>> {
        if self.scenario.is_empty() {
            let scenario = actors::ScenarioArgs::default();
            return Ok(vec![Change { name: RECORDED.into(), family: RECORDED.into(), scenario }]);
        }
        let mut names = BTreeSet::new();
        let change = |path: &PathBuf| {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let family = name.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('-');
            let family = if family.is_empty() { name.as_str() } else { family }.to_owned();
            let is_new = names.insert(name.clone());
            anyhow::ensure!(is_new, "expected scenarios of different names, found two: {}", path.display());
            Ok(Change { name, family, scenario: actors::ScenarioArgs::of_file(path) })
        };
        self.scenario.iter().map(change).collect()
    }

    /// Returns the name of the method in tables.
    fn method_name(&self) -> String {
        let planner = self.planner.as_ref().map(ToString::to_string);
        self.method.clone().or(planner).unwrap_or_else(|| self.ego.name().to_owned())
    }

    /// Simulates the rollouts of a log, after building its skeleton if it does not exist.
    fn simulate(
        &self,
        locator: &LogLocator,
        changes: &[Change],
        files: &OutputFolder,
        opener: &Arc<LogOpener>,
    ) -> anyhow::Result<Vec<ScenarioRollout>> {
        let source = logs::open_by(locator, opener)?;
        let log = source.recording();
        let skeleton = self.given.skeletons.skeletons.join(&log.name);
        if !skeleton.exists() {
            print_progress(&format!("building {}", skeleton.display()));
        }
        skeleton::open_or_build(&skeleton, source.reader())?;
        let rates = Rates::of(locator.format, log);
        let clips = scenario_clips(log, rates, f64::from(self.seconds), f64::from(self.every));
        let limit = self.clips.map_or(usize::MAX, usize::from);
        let mut done = Vec::new();
        for change in changes {
            for clip in clips.iter().take(limit) {
                let out = files.folder(Path::new(&change.name).join(&clip.name))?;
                if !rollout::is_finished(&out)? {
                    let args = self.clip(locator, &skeleton, (change, clip), &out, opener)?;
                    let summary = simulate::rollout(SimulateArgs::of_clip(args));
                    let what = || format!("{}, rollout {}", change.name, clip.name);
                    print_progress(&summary.with_context(what)?);
                }
                done.push(ScenarioRollout {
                    log: log.name.clone(),
                    change: change.name.clone(),
                    family: change.family.clone(),
                    folder: out,
                });
            }
        }
        Ok(done)
    }

    /// Returns the options of a rollout.
    fn clip(
        &self,
        locator: &LogLocator,
        skeleton: &Path,
        (change, clip): (&Change, &Clip),
        out: &Path,
        opener: &Arc<LogOpener>,
    ) -> anyhow::Result<ClipArgs> {
        Ok(ClipArgs {
            source: SourceArgs {
                log: locator.clone(),
                skeleton: skeleton.to_owned(),
                roots: self.given.roots.clone(),
            },
            folder: FolderArgs { out: out.to_owned() },
            rollout: RolloutArgs {
                steps: Some(clip.steps()),
                start: Some(clip.start_us),
                resume: is_there(&out.join(ROLLOUT))?,
                ..RolloutArgs::default()
            },
            clock: Some(clip.clock),
            ego: self.ego,
            planner: self.planner.clone(),
            actors: self.actors,
            scenario: change.scenario.clone(),
            least_warmup: true,
            ego_offset: None,
            copies_dataset: false,
            prompt: self.prompt.clone(),
            generator: self.generator.clone(),
            images: None,
            maps: self.maps.clone(),
            lidar: self.lidar.clone(),
            substitutes: self.substitutes.clone(),
            rasterizer: self.rasterizer.clone(),
            opener: Arc::clone(opener),
        })
    }
}
