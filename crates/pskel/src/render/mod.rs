//! `pskel render`: [`args`] defines the options, [`steps`] the times to render, [`output`] writes the maps.

mod args;
mod output;
mod steps;

pub(super) use args::RenderArgs;

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Instant;

use anyhow::Context;
use point_skeleton::cloud;
use point_skeleton::conditions::distort::Distorter;
use point_skeleton::conditions::meta::{Index, IndexFrame, PromptParts};
use point_skeleton::conditions::{ConditionOptions, StepInFlight};
use point_skeleton::dataset::Dataset;
use point_skeleton::error::FileError;
use point_skeleton::files::OutputFolder;
use point_skeleton::files::input::read_table;
use point_skeleton::raster::{FRAMES_IN_FLIGHT, Rasterizer};
use point_skeleton::scene::{SceneClouds, SceneMap, SelectionOptions, frame_rate_hz};
use point_skeleton::skeleton::Skeleton;

use self::output::{Output, Rendered};
use self::steps::Steps;
use super::progress::Progress;
use super::{say, warn};

/// Runs the command: opens the inputs, renders and writes the maps.
pub(super) fn run(args: RenderArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    args.check()?;
    let dataset = args.roots.open(&args.log)?;
    let log = dataset.log();
    let skeleton = open_skeleton(&args.skeleton, dataset.as_ref())?;
    let views = args.cameras.as_deref().map(cloud::cameras::read).transpose()?;
    let prompt = args.annotations.as_deref().map_or(Ok(PromptParts::default()), read_prompt)?;
    let map = read_map(&args, dataset.as_ref())?;
    let maps = args.maps(map.is_some()).with_context(|| {
        format!(
            "expected an HD map of {:?} for --maps map, found none in log {}",
            log.location,
            log.shown_name()
        )
    })?;
    let steps = Steps::new(log, &args, views, map)?;
    let (stand_ins, told) = args.stand_ins.make(&skeleton, &log.name)?;
    let stage = SceneClouds::with(&skeleton, &log.name, &stand_ins)?;
    let mut rasterizer = args.rasterizer.create(stage.cloud_set())?;
    let options = args.options(maps, told);
    let output = Output {
        folder: OutputFolder::open(&args.out, "maps", &[&args.skeleton, &args.log.path])?,
        format: args.maps.format,
        options: &options.conditions,
        prompt: &prompt,
        fps: args.hz.or_else(|| frame_rate_hz(&log.frames).filter(|_| args.at.is_empty())),
        distort: args.distort,
        birdseye: args.birdseye,
        log: &log.name,
    };
    let distorter = args.distort.then(|| Distorter::new(&options.conditions)).transpose()?;
    output.begin(steps.names())?;
    let frames = Work { stage, steps: &steps, output: &output }.run(
        rasterizer.as_mut(),
        &options.conditions,
        &options.selection,
        distorter,
    )?;
    let summary = summary(&frames, &steps.missing_images(), rasterizer.as_mut());
    warn_of_times_outside(&frames, skeleton.manifest.times_us(&log.name));
    output.end(&Index { options: &options, frames })?;
    say(&format!("{summary} in {:.2} s: {}", start.elapsed().as_secs_f64(), args.out.display()));
    Ok(())
}

/// Opens a skeleton, which must be built from this log: its coordinates are in the log's global frame.
pub(super) fn open_skeleton(path: &Path, dataset: &dyn Dataset) -> Result<Skeleton, FileError> {
    let skeleton = Skeleton::open(path)?;
    let name = &dataset.log().name;
    if skeleton.manifest.times_us(name).is_none() {
        let logs: Vec<&str> = skeleton.manifest.sources.iter().map(|source| source.log.as_str()).collect();
        let (expected, found) =
            (format!("a skeleton of log {name}"), format!("one of log {}", logs.join(", ")));
        return Err(FileError::content(expected, found, path));
    }
    Ok(skeleton)
}

/// Reads the log's HD map if it exists and is used.
fn read_map(args: &RenderArgs, dataset: &dyn Dataset) -> anyhow::Result<Option<Arc<SceneMap>>> {
    let map = args.wants_map().then(|| dataset.read_map()).transpose()?.flatten();
    Ok(map.map(|map| Arc::new(SceneMap::new(map, dataset.log()))))
}

/// Warns of times outside those that the skeleton was built from, where it may have few points.
fn warn_of_times_outside(frames: &[IndexFrame], built_from: Option<[i64; 2]>) {
    let Some([first, last]) = built_from else { return };
    let outside: Vec<&str> =
        frames.iter().filter(|f| !(first..=last).contains(&f.t_us)).map(|f| f.name.as_str()).collect();
    if !outside.is_empty() {
        let names = outside.join(", ");
        warn(&format!("the skeleton was built from times {first} to {last}; outside of them lie: {names}"));
    }
}

pub(super) fn read_prompt(path: &Path) -> Result<PromptParts, FileError> {
    let text = read_table(path)?;
    serde_json::from_slice(&text)
        .map_err(|e| FileError::content(r#"{"weather": text, "city": text}"#, e.to_string(), path))
}

/// State shared by all steps.
struct Work<'a> {
    stage: SceneClouds<'a>,
    steps: &'a Steps<'a>,
    output: &'a Output<'a>,
}

impl Work<'_> {
    /// Renders step by step while another thread writes the previous step.
    fn run(
        &self,
        rasterizer: &mut dyn Rasterizer,
        options: &ConditionOptions,
        selection: &SelectionOptions,
        mut distorter: Option<Distorter>,
    ) -> anyhow::Result<Vec<IndexFrame>> {
        let mut frames = Vec::new();
        let mut progress = Progress::new(self.steps.len());
        std::thread::scope(|scope| {
            let (sender, receiver) = sync_channel::<Rendered>(1);
            let writer = scope.spawn(move || {
                let mut rendered = receiver.into_iter();
                rendered.try_for_each(|step| self.output.write(&step))
            });
            let mut in_flight = VecDeque::new();
            let mut states = self.steps.states();
            loop {
                // The device renders one step while the host processes the previous one.
                if let Some(state) = states.next() {
                    let state = state?;
                    let instances = self.stage.instances(&state, selection);
                    let pinholes = distorter.as_mut().map(|d| d.pinholes(&state)).transpose()?;
                    let (drawn, options) =
                        pinholes.as_ref().map_or((&state, options), |p| (&p.state, &p.options));
                    let begun = StepInFlight::new(rasterizer, &instances, drawn, options);
                    let begun = begun.with_context(|| format!("step {}", state.name))?;
                    in_flight.push_back((state, pinholes, begun));
                    if in_flight.len() < FRAMES_IN_FLIGHT {
                        continue;
                    }
                }
                let Some((state, pinholes, begun)) = in_flight.pop_front() else { break };
                let set = begun.finish(rasterizer).with_context(|| format!("step {}", state.name))?;
                let set = match pinholes {
                    Some(pinholes) => pinholes.distort(set),
                    None => set,
                };
                frames.push(IndexFrame::new(&state));
                progress.step(&state.name);
                if sender.send(Rendered { state, set }).is_err() {
                    // The writer thread has stopped; its result has the error.
                    break;
                }
            }
            drop(sender);
            match writer.join() {
                Ok(result) => Ok(result?),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })
        .map(|()| frames)
    }
}

fn summary(
    frames: &[IndexFrame],
    missing: &BTreeMap<&str, usize>,
    rasterizer: &mut dyn Rasterizer,
) -> String {
    let maps: usize = frames.iter().map(|f| f.cameras.len()).sum();
    let missing = match missing.iter().map(|(name, count)| format!("{count} of {name}")).collect::<Vec<_>>() {
        none if none.is_empty() => String::new(),
        some => format!(" (images missing, drawn from the frame's own pose: {})", some.join(", ")),
    };
    let stages = rasterizer.take_stages().0;
    let stages: Vec<String> =
        stages.iter().map(|(name, time)| format!("{name} {:.2}", time.as_secs_f64())).collect();
    let info = rasterizer.info();
    format!(
        "rendered {} frames, {maps} camera views{missing} by {} on {} (seconds: {})",
        frames.len(),
        info.rasterizer,
        info.device,
        stages.join(", ")
    )
}
