//! `pskel simulate`: [`args`] defines the options, [`rollout`] is the loop, [`generation`] generates images in it,
//! [`output`] writes its steps on a separate thread, [`finish`] writes the summary files, [`profile`] records times,
//! [`sources`] identifies the inputs, [`summary`] formats the last line, [`files`] has the file names.

mod args;
mod files;
mod finish;
mod generation;
mod output;
mod profile;
mod rollout;
mod sources;
mod summary;

pub(super) use args::{OpenLoop, SimulateArgs};

use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use point_skeleton::conditions::meta::PromptParts;
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapSet};
use point_skeleton::dataset::{Dataset, Log};
use point_skeleton::error::FileError;
use point_skeleton::files::{OutputFolder, check_output_file, check_outside};
use point_skeleton::raster::{RasterizerInfo, StageTimes};
use point_skeleton::scene::{SceneClouds, SceneMap};
use point_skeleton::skeleton::Skeleton;
use pskel_generate::GroundTruthImages;
use pskel_sim::report::StepRow;
use pskel_sim::{EndReason, Scenario, SimError, Simulation};

use self::finish::{Outcome, finish};
use self::generation::{EarlierSteps, Generation};
use self::output::{Earlier, Output, Resumed, RolloutOptions};
use self::rollout::{Rollout, Run};
use self::sources::{Places, Sources};
use self::summary::summary;
use super::generator::{GenerationScene, GeneratorReport, OpenedNetwork};
use super::render::{open_skeleton, read_prompt};
use super::stand_ins::StandInReport;
use super::{WrongUsage, say, warn};

/// Kind of the output folder.
const KIND: &str = "rollout";
/// Default size of maps if cameras are larger.
const SIZE: ImageSize = ImageSize { height: 256, width: 448 };

/// Runs the command: simulates, renders, writes.
pub(super) fn run(mut args: SimulateArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    args.check()?;
    if let Some(profile) = &args.profile {
        check_output_file(profile, args.input_files())?;
        if !args.dry {
            check_outside(profile, &args.out)?;
        }
    }
    let inputs = Inputs::open(&args)?;
    let Inputs { dataset, skeleton, prompt, map, maps } = &inputs;
    let log = dataset.log();
    let opened = args.generator.as_ref().map(|name| args.generating.open(name, log.rig.len())).transpose()?;
    let scenario = Scenario::new(log, map.clone(), args.log.format);
    let sim_options = args.sim_options(&scenario, opened.as_ref().map(OpenedNetwork::window))?;
    args.steps = sim_options.steps;
    let sources = Sources::new(log, skeleton, prompt)?;
    let inputs_of_files = [args.skeleton.as_path(), args.log.path.as_path()];
    let open_files = || OutputFolder::open(&args.out, KIND, &inputs_of_files);
    let files = (!args.dry).then(open_files).transpose()?;
    let earlier = earlier(&args, &sources)?;
    let (saved, rows) = earlier.map_or((None, Vec::new()), |Earlier { rows, saved }| (Some(saved), rows));
    let simulation = match &saved {
        Some(saved) => Simulation::resume(&scenario, sim_options.clone(), saved),
        None => Simulation::new(&scenario, sim_options.clone()),
    };
    let simulation = simulation.map_err(usage)?;
    let (stand_ins, told) = args.stand_ins.make(skeleton, &log.name)?;
    let stage = SceneClouds::with(skeleton, &log.name, &stand_ins)?;
    let mut rasterizer = args.rasterizer.create(stage.cloud_set())?;
    let generator = opened.as_ref().map(OpenedNetwork::report);
    let options = options(&args, log, (*maps, told, sources, generator), &simulation, sim_options.clone());
    let output = Output { folder: &args.out, options: &options, prompt };
    let states = files.as_ref().map(|files| output.begin(files, &rows)).transpose()?;
    let [ego_follows_log, actors_follow_log] = args.follow_log();
    let subject = GenerationScene {
        log,
        map: map.clone(),
        stage: &stage,
        prompt,
        truth: GroundTruthImages::new(dataset.as_ref()),
        ego_follows_log,
        actors_follow_log,
    };
    let before = EarlierSteps {
        folder: &args.out,
        rows: &rows,
        steps_per_plan: simulation.steps_per_plan(),
        scenario: &scenario,
        options: &sim_options,
    };
    let begin = |opened: OpenedNetwork| Generation::begin(opened, &subject, rasterizer.as_mut(), &before);
    let mut generation = opened.map(begin).transpose()?;
    let shown_to_planner = args.ego_name() == "external" && !args.dry;
    let rollout = Rollout {
        log,
        map: map.clone(),
        stage: &stage,
        options: &options,
        output: &output,
        files: files.as_ref(),
        shown_to_planner,
    };
    let run = rollout.run(simulation, rasterizer.as_mut(), generation.as_mut(), rows, states)?;
    let (stages, info) = (rasterizer.take_stages(), rasterizer.info());
    let text = report(&args, &output, files, log, run, (&stages, info))?;
    say(&format!("{text} in {:.2} s: {}", start.elapsed().as_secs_f64(), args.out.display()));
    Ok(())
}

/// Inputs that are read before the simulation starts.
struct Inputs {
    dataset: Box<dyn Dataset>,
    skeleton: Skeleton,
    prompt: PromptParts,
    map: Option<Arc<SceneMap>>,
    /// Kinds of maps to render.
    maps: MapSet,
}

impl Inputs {
    fn open(args: &SimulateArgs) -> anyhow::Result<Self> {
        let dataset = args.roots.open(&args.log)?;
        let log = dataset.log();
        let skeleton = open_skeleton(&args.skeleton, dataset.as_ref())?;
        let prompt = args.annotations.as_deref().map_or(Ok(PromptParts::default()), read_prompt)?;
        let map = dataset.read_map()?.map(|map| Arc::new(SceneMap::new(map, log)));
        let maps = args.maps.kinds(map.is_some()).with_context(|| {
            format!(
                "expected an HD map of {:?} for --maps map, found none in log {}",
                log.location,
                log.shown_name()
            )
        })?;
        Ok(Self { dataset, skeleton, prompt, map, maps })
    }
}

/// Writes the summary files of all steps, and returns the summary line.
fn report(
    args: &SimulateArgs,
    output: &Output<'_>,
    files: Option<OutputFolder>,
    log: &Log,
    mut run: Run,
    (stages, info): (&StageTimes, RasterizerInfo),
) -> anyhow::Result<String> {
    let outcome = outcome(args, output.options, log, &mut run);
    let clock = Instant::now();
    let finished = files.map_or(Ok(()), |files| {
        finish(output, &files, &run.rows, &outcome)?;
        Ok(files.close()?)
    });
    run.profile.report_s = clock.elapsed().as_secs_f64();
    run.profile.close(info.clone(), stages);
    let profiled = args.profile.as_deref().map_or(Ok(()), |path| run.profile.write(path));
    let reported = finished.and_then(|()| Ok(profiled?));
    if let Some(failure) = run.failure {
        // The first error is the result.
        if let Err(error) = reported {
            warn(&format!("after the rollout had failed: {}", super::with_causes(&error)));
        }
        return Err(failure.context(told_failure(args, &run.rows)));
    }
    reported?;
    Ok(summary(args, &outcome, &run.rows, &run.profile, &info))
}

/// Reads the rollout to resume, if requested.
fn earlier(args: &SimulateArgs, sources: &Sources) -> Result<Option<Earlier>, FileError> {
    if !args.resume && args.resume_from.is_none() {
        return Ok(None);
    }
    let places =
        Places { log: &args.log.path, skeleton: &args.skeleton, annotations: args.annotations.as_deref() };
    let (folder, until) = (&args.out, args.resume_from);
    let earlier = Resumed { folder, until, steps: args.steps, sources, places }.read()?;
    if earlier.is_none() {
        warn("no rollout with a step was found to resume; this one starts at step 0");
    }
    Ok(earlier)
}

/// Converts invalid options into [`WrongUsage`], which has its own exit code.
fn usage(error: SimError) -> anyhow::Error {
    if error.is_usage() { WrongUsage(error.to_string()).into() } else { error.into() }
}

fn options(
    args: &SimulateArgs,
    log: &Log,
    (maps, stand_ins, sources, generator): (MapSet, StandInReport, Sources, Option<GeneratorReport>),
    simulation: &Simulation<'_>,
    sim_options: pskel_sim::SimOptions,
) -> RolloutOptions {
    let conditions = args.maps.conditions(maps);
    let large =
        |camera: &point_skeleton::geometry::Camera| camera.height > SIZE.height || camera.width > SIZE.width;
    let reduced = conditions.size.is_none() && log.rig.iter().any(|rig| large(&rig.camera));
    let out_size = conditions.out_size.or(reduced.then_some(SIZE));
    let rates = simulation.rates();
    RolloutOptions {
        conditions: ConditionOptions { out_size, ..conditions },
        selection: args.maps.selection(),
        stand_ins,
        format: args.maps.format,
        forecast_steps: args.forecast_steps(),
        sheets: args.sheets,
        log: log.name.clone(),
        sources,
        simulation: sim_options,
        sim_hz: rates.sim_hz,
        plan_hz: rates.plan_hz,
        takeover_step: simulation.takeover_step(),
        generator,
    }
}

fn outcome(args: &SimulateArgs, options: &RolloutOptions, log: &Log, run: &mut Run) -> Outcome {
    let ended = match (&run.failure, run.ended) {
        (Some(_), _) => format!(" of {}, then it failed", args.steps),
        (None, Some(EndReason::LogEnded)) => format!(" of {}, then the log ended", args.steps),
        (None, _) => String::new(),
    };
    let beyond = |row: &&StepRow| log.frames.last().is_some_and(|last| row.t_us > last.t_us);
    let steps_beyond_log = run.rows.iter().filter(beyond).count();
    let made = options.generator.as_ref().map(GeneratorReport::fact);
    let mut facts = vec![
        format!("ego {}", args.ego_name()),
        format!("actors {}", args.actors_name()),
        format!("{} steps and {} plans a second", options.sim_hz, options.plan_hz),
        format!("{} steps{ended}", run.rows.len().saturating_sub(1)),
    ];
    facts.extend(made);
    facts.extend(summary::beyond_log(steps_beyond_log));
    Outcome {
        metrics: run.metrics.clone(),
        ended: run.ended.filter(|_| run.failure.is_none()),
        failure: run.failure.as_ref().map(super::with_causes),
        steps_beyond_log,
        notes: std::mem::take(&mut run.notes),
        facts,
        layout: std::mem::take(&mut run.layout),
        cameras: std::mem::take(&mut run.cameras),
    }
}

fn told_failure(args: &SimulateArgs, rows: &[StepRow]) -> String {
    let steps = rows.len();
    if args.dry {
        return format!("stopped after {steps} steps");
    }
    format!("stopped after {steps} steps, which are in {}", args.out.display())
}
