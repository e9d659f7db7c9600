//! `pskel render`: [`args`] defines the options.

mod args;

pub(crate) use args::RenderArgs;

use std::collections::BTreeMap;
use std::time::Instant;

use anyhow::Context;
use point_skeleton::cloud;
use point_skeleton::conditions::distort::uncovered;
use point_skeleton::conditions::write::meta::IndexFrame;
use point_skeleton::files::OutputFolder;
use point_skeleton::geometry::Camera;
use point_skeleton::raster::Rasterizer;
use point_skeleton::scene::{SceneSequence, SequenceError, frame_rate_hz};
use point_skeleton::sequence::SequenceWriter;
use point_skeleton::{RenderOptions, Renderer};

use crate::progress::Progress;
use crate::{WrongUsage, print_result, warn, warn_of_boxes_alone};

/// Runs the command: opens the inputs, renders and writes the maps.
pub(crate) fn run(args: RenderArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    args.check()?;
    let source = args.actors.edit(&args.source.open()?)?;
    let log = source.recording();
    if let Some(change) = log.edits.first_simulated() {
        let message = format!(
            "expected changes that need no simulation, found idm as change {change} of the \
            scenario: use pskel simulate"
        );
        return Err(WrongUsage(message).into());
    }
    for (note, count) in log.notes.iter().filter(|(note, _)| note.contains("camera_distortion")) {
        warn(&format!("{count} {note}"));
    }
    if args.distort && log.rig.iter().all(|rig| rig.camera.lens.is_none()) {
        warn(&format!("--distort has no effect: log {} has no lens distortion", log.shown_name()));
    }
    if args.distort {
        warn_of_uncovered(log.rig.iter().map(|rig| &rig.camera));
    }
    let skeleton = args.source.open_skeleton(source.unedited())?;
    let views = args.cameras.as_deref().map(cloud::cameras::read).transpose()?;
    let prompt = args.prompt.read()?;
    let map = if args.wants_map() { source.require_map()? } else { None };
    let maps = args.maps(map.is_some()).with_context(|| {
        format!(
            "expected an HD map of {:?} for --maps map, found none in log {}",
            log.location,
            log.shown_name()
        )
    })?;
    let offset = args.moved.ego_offset.unwrap_or_default();
    let states = SceneSequence::new(log, args.times(log)?, offset, views, map).map_err(usage)?;
    let states = states.hiding(args.actors.hidden()).map_err(usage)?;
    let (substitutes, substitute_report) =
        args.substitutes.options().for_log(log).make(&skeleton, &log.name)?;
    let options = args.options(log, maps, substitute_report, args.lidar.output(log)?);
    let mut renderer = Renderer::new(
        &skeleton,
        RenderOptions {
            conditions: options.conditions.clone(),
            selection: options.selection,
            rasterizer: args.rasterizer.desc()?,
            substitutes: &substitutes,
            log: Some(&log.name),
            distort: args.distort,
            ..RenderOptions::default()
        },
    )?;
    warn_of_boxes_alone(&renderer.boxes_alone(log));
    let writer = SequenceWriter {
        folder: OutputFolder::open(&args.folder.out, "maps", &args.inputs())?,
        format: args.maps.format,
        bins: &options.conditions.depth_bins,
        prompt: &prompt,
        fps: args.rate.hz.or_else(|| frame_rate_hz(&log.frames).filter(|_| args.at.is_empty())),
        birdseye: args.birdseye,
        lidar: options.lidar.as_ref(),
        log: &log.name,
    };
    let mut progress = Progress::new(states.len());
    let frames = writer.write(&mut renderer, &states, &options, &mut |name| progress.step(name))?;
    drop(progress);
    let summary = summary(&frames, &states.missing_images(), renderer.rasterizer());
    warn_of_times_outside(&frames, skeleton.manifest.times_us(&log.name));
    print_result(&format!(
        "{summary} in {:.2} s: {}",
        start.elapsed().as_secs_f64(),
        args.folder.out.display()
    ));
    Ok(())
}

/// Warns of lenses that show more than distorted maps do.
fn warn_of_uncovered<'a>(cameras: impl Iterator<Item = &'a Camera>) {
    for camera in cameras {
        let share = uncovered(camera);
        if share > 0.0 {
            let (name, percent) = (&camera.name, 100.0 * share);
            warn(&format!(
                "--distort leaves {percent:.1} % of {name} empty: its lens shows more there than a pinhole \
                    can"
            ));
        }
    }
}

/// Converts invalid options into [`WrongUsage`], which has its own exit code.
fn usage(error: SequenceError) -> anyhow::Error {
    match error {
        SequenceError::Twice { .. } | SequenceError::NoTrack { .. } => WrongUsage(error.to_string()).into(),
        _ => error.into(),
    }
}

/// Warns of times outside those that the skeleton was built from, where it may have few points.
fn warn_of_times_outside(frames: &[IndexFrame], built_from: Option<[i64; 2]>) {
    let Some([first, last]) = built_from else { return };
    let outside: Vec<&str> =
        frames.iter().filter(|f| !(first..=last).contains(&f.t_us)).map(|f| f.name.as_str()).collect();
    if !outside.is_empty() {
        let names = outside.join(", ");
        warn(&format!("the skeleton covers times {first} to {last}; outside are: {names}"));
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
        some => format!(" (missing images, rendered from the frame's pose: {})", some.join(", ")),
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
