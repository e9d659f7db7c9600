//! `pskel render`: [`args`] defines the options, [`steps`] the times to render, [`output`] writes the maps.

mod args;
mod output;
mod steps;

pub(super) use args::RenderArgs;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Instant;

use anyhow::Context;
use point_skeleton::cloud;
use point_skeleton::conditions::meta::{Index, IndexFrame, PromptParts};
use point_skeleton::dataset::Dataset;
use point_skeleton::error::FileError;
use point_skeleton::files::OutputFolder;
use point_skeleton::files::input::read_table;
use point_skeleton::raster::{FRAMES_IN_FLIGHT, Rasterizer};
use point_skeleton::scene::{SceneMap, frame_rate_hz};
use point_skeleton::skeleton::Skeleton;
use point_skeleton::{Maps, RenderOptions, Renderer};

use self::output::Output;
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
    let (substitutes, substitute_report) = args.stand_ins.options().make(&skeleton, &log.name)?;
    let options = args.options(maps, substitute_report);
    let mut renderer = Renderer::new(
        &skeleton,
        RenderOptions {
            conditions: options.conditions.clone(),
            selection: options.selection,
            rasterizer: args.rasterizer.desc()?,
            substitutes: &substitutes,
            log: Some(&log.name),
            distort: args.distort,
        },
    )?;
    let output = Output {
        folder: OutputFolder::open(&args.out, "maps", &[&args.skeleton, &args.log.path])?,
        format: args.maps.format,
        bins: &options.conditions.depth_bins,
        prompt: &prompt,
        fps: args.hz.or_else(|| frame_rate_hz(&log.frames).filter(|_| args.at.is_empty())),
        birdseye: args.birdseye,
        log: &log.name,
    };
    output.begin(steps.names())?;
    let frames = render(&mut renderer, &steps, &output)?;
    let summary = summary(&frames, &steps.missing_images(), renderer.rasterizer());
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

/// Renders step by step while another thread writes the previous step.
fn render(
    renderer: &mut Renderer<'_>,
    steps: &Steps<'_>,
    output: &Output<'_>,
) -> anyhow::Result<Vec<IndexFrame>> {
    let mut frames = Vec::new();
    let mut progress = Progress::new(steps.len());
    std::thread::scope(|scope| {
        let (sender, receiver) = sync_channel::<Maps>(1);
        let writer = scope.spawn(move || {
            let mut rendered = receiver.into_iter();
            rendered.try_for_each(|maps| output.write(&maps))
        });
        let (mut states, mut names) = (steps.states(), steps.names());
        loop {
            // The device renders one step while the host processes the previous one.
            if let Some(state) = states.next() {
                let state = state?;
                renderer.begin(&state).with_context(|| format!("step {}", state.name))?;
                if renderer.in_flight() < FRAMES_IN_FLIGHT {
                    continue;
                }
            }
            if renderer.in_flight() == 0 {
                break;
            }
            let name = names.next().unwrap_or_default();
            let maps = renderer.finish().with_context(|| format!("step {name}"))?;
            frames.push(IndexFrame::new(&maps.state));
            progress.step(&maps.state.name);
            if sender.send(maps).is_err() {
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
