//! `pskel simulate`: [`args`] and [`policies`] define the options, [`generation`] opens the network,
//! [`summary`] formats the last line.

mod args;
mod generation;
mod inputs;
mod policies;
mod summary;

#[cfg(feature = "network")]
pub(crate) use args::ClipArgs;
pub(crate) use args::SimulateArgs;

use std::time::Instant;

use point_skeleton::conditions::{ConditionOptions, MapSet};
use point_skeleton::dataset::Recording;
use point_skeleton::error::with_causes;
use point_skeleton::files::{OutputFile, check_place};
use point_skeleton::geometry::{Camera, ImageSize};
use point_skeleton::{RenderOptions, Renderer};
use pskel_sim::rollout::{
    ImageGenerator, InputPaths, Rollout, RolloutError, RolloutInputs, RolloutOptions, RolloutReport,
    rollout_extra,
};
use pskel_sim::{Rates, Scenario, SimOptions};
use serde_json::{Map, Value};

use self::args::OutputFiles;
pub(crate) use self::generation::Opened;
#[cfg(feature = "drive")]
pub(crate) use self::generation::{GeneratorArgs, GivenImages};
use self::inputs::Inputs;
use self::summary::{Planned, summary};
use crate::progress::Progress;
use crate::{WrongUsage, print_result, warn, warn_of_boxes_alone};

/// Default size of maps if cameras are larger.
const SIZE: ImageSize = ImageSize { height: 256, width: 448 };

/// Runs the command: simulates, renders, writes, and prints the summary.
pub(crate) fn run(args: SimulateArgs) -> anyhow::Result<()> {
    print_result(&rollout(args)?);
    Ok(())
}

/// Simulates, renders and writes a rollout. Returns its summary.
pub(crate) fn rollout(args: SimulateArgs) -> anyhow::Result<String> {
    let start = Instant::now();
    args.check()?;
    let read = args.input_paths();
    let files = args.open_files(&read)?;
    if !args.dry {
        check_place(&args.folder.out, &read)?; // before the log is read
    }
    if let Some(note) = args.note_on_maps() {
        warn(note);
    }
    let inputs = args.inputs()?;
    let Inputs { log, skeleton, prompt, map, maps } = &inputs;
    let log = log.recording();
    let scenario = Scenario { log, map: map.clone(), rates: Rates::of(args.source.log.format, log) };
    let mut simulation = args.sim_options(&scenario)?;
    let rates = simulation.rates(scenario.rates, log).map_err(|error| usage(error.into()))?;
    let opened = Opened::open(&args.generator, &args.images, &inputs.log, rates.plan_hz)?;
    args.check_steps(simulation.steps, opened.as_ref().map(Opened::window))?;
    simulation.warmup_frames = args.warmup_frames(opened.as_ref().map(Opened::window))?;
    let planned = Planned {
        steps: simulation.steps,
        ego: simulation.ego.name(),
        actors: simulation.actors.name(),
        is_open_loop: args.is_open_loop(),
    };
    let (substitutes, substitute_report) =
        args.substitutes.options().for_log(log).make(skeleton, &log.name)?;
    let generator = opened.as_ref().map(Opened::record).transpose()?.unwrap_or(Value::Null);
    let extra = rollout_extra(&substitute_report, generator)?;
    let facts = opened.iter().map(Opened::fact).collect();
    let lidar = args.lidar.output(log)?;
    let options = RolloutOptions { lidar, ..options(&args, &files, log, *maps, simulation, extra, facts) };
    let paths = InputPaths {
        log: &args.source.log.path,
        skeleton: &args.source.skeleton,
        prompt: args.prompt.annotations.as_deref(),
    };
    let rollout_inputs = RolloutInputs { scenario: &scenario, skeleton, prompt, paths };
    let out = (!args.dry).then_some((args.folder.out.as_path(), &read));
    let rollout = Rollout::open(rollout_inputs, options, out, args.rollout.resume_after()).map_err(usage)?;
    if args.rollout.resume_after().is_some() && rollout.steps_done() == 0 {
        warn("--resume: found no earlier steps, starting at step 0");
    }
    if let Some(note) = args.note_on_warmup(log, rollout.takeover_step(), planned.steps) {
        warn(&note);
    }
    let render = RenderOptions {
        rasterizer: args.rasterizer.desc()?,
        substitutes: &substitutes,
        log: Some(&log.name),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(skeleton, render)?;
    warn_of_boxes_alone(&renderer.boxes_alone(log));
    let generate = |opened: Opened| {
        opened.session(&inputs.log, inputs.map.is_some(), &inputs.prompt, args.follow_log(log))
    };
    let mut generator = opened.map(generate).transpose()?;
    let mut progress = Progress::new(rollout.steps_left());
    let mut on_step = |name: &str| progress.step(name);
    let generator = generator.as_mut().map(|generator| generator.as_mut() as &mut dyn ImageGenerator);
    let report = rollout.run(&mut renderer, generator, &mut on_step)?;
    drop(progress);
    let report = checked(report, &args, files.profile.as_ref())?;
    let text = summary(&planned, &report, &renderer.rasterizer().info());
    Ok(format!("{text} in {:.2} s: {}", start.elapsed().as_secs_f64(), args.folder.out.display()))
}

/// Writes the profile, and returns the report of a rollout without failures.
fn checked(
    mut report: RolloutReport,
    args: &SimulateArgs,
    profile: Option<&OutputFile>,
) -> anyhow::Result<RolloutReport> {
    let profiled = profile.map_or(Ok(()), |file| report.profile.write(file));
    let written = report.summary_failure.take().map_or(profiled.map_err(RolloutError::from), Err);
    let Some(failure) = report.failure.take() else {
        written?;
        return Ok(report);
    };
    // The first error is the result.
    if let Err(error) = written {
        warn(&format!("after the rollout had failed: {}", with_causes(&error)));
    }
    let steps = report.rows.len();
    let place =
        if args.dry { String::new() } else { format!(", which are in {}", args.folder.out.display()) };
    Err(anyhow::Error::new(failure).context(format!("stopped after {steps} steps{place}")))
}

/// Converts invalid options into [`WrongUsage`], which has its own exit code.
fn usage(error: RolloutError) -> anyhow::Error {
    match &error {
        RolloutError::Simulation(wrong) if wrong.is_usage() => WrongUsage(error.to_string()).into(),
        _ => error.into(),
    }
}

fn options(
    args: &SimulateArgs,
    files: &OutputFiles,
    log: &Recording,
    maps: MapSet,
    simulation: SimOptions,
    extra: Map<String, Value>,
    facts: Vec<String>,
) -> RolloutOptions {
    #[cfg(not(feature = "mcap"))]
    let _ = files; // of interest to the MCAP file alone
    let conditions = args.maps.conditions(maps);
    let large = |camera: &Camera| camera.height > SIZE.height || camera.width > SIZE.width;
    let reduced = conditions.size.is_none() && log.rig.iter().any(|rig| large(&rig.camera));
    let out_size = conditions.out_size.or(reduced.then_some(SIZE));
    RolloutOptions {
        simulation,
        conditions: ConditionOptions { out_size, ..conditions },
        selection: args.maps.selection(),
        hide: args.actors.hidden(),
        format: args.maps.format,
        forecast_steps: args.forecast_steps(),
        sheets: args.sheets,
        lidar: None,
        extra,
        facts,
        #[cfg(feature = "mcap")]
        mcap: files.mcap.clone(),
    }
}
