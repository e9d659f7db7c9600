use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::Args;
use point_skeleton::conditions::Captions;
use point_skeleton::dataset::{LogLocator, LogOpener};
use point_skeleton::files::FileName;
use pskel_export::{
    ExportError, ExportJob, ExportOptions, ExportProgress, ExportReport, Failure, Layout, Part, SampleFormat,
    SampleTimes, WorkList,
};

use crate::args::frames::{FrameArgs, RateArgs};
use crate::args::log::{self, LogRoots};
use crate::args::maps::MapArgs;
use crate::args::names::names;
use crate::args::outputs::FolderArgs;
use crate::args::prompt::PromptArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::source::SkeletonsArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::progress::Progress;
use crate::{WrongUsage, print_progress, print_result};

/// Export the condition maps of many recordings in a layout that trainers read
///
/// Each recording is divided into shards of some frames. A shard is written under a temporary name and
/// appears whole, together with its record in shards/. Shards that exist are skipped, so the same command
/// continues an interrupted export, and several processes or machines may run it on one folder. Skeletons
/// that do not exist are built. Recordings that are damaged are reported at the end, and the others are
/// exported all the same. See docs/src/guide/export.md.
#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    /// Recordings: [FORMAT:]PATH[@VERSION][#SCENE]; "#*" is every scene of a nuScenes version, and a folder
    /// of nuPlan or Argoverse 2 logs is all of them
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    /// Layout of the files
    #[arg(long, value_parser = names::<Layout>())]
    layout: Layout,
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    skeletons: SkeletonsArgs,
    /// Print the shards, one per line (number, name, frames, recording), and write nothing
    #[arg(long)]
    list: bool,
    /// Write only part I (counted from 0) of N parts of the list
    #[arg(long, value_name = "I/N")]
    only: Option<Part>,
    /// Number of recordings that are exported at a time, each with a device of its own
    #[arg(long, value_name = "N", default_value = "1")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=ExportJob::MAX_JOBS as i64))]
    jobs: u32,
    /// Key frames per shard; the layout alpasim has whole recordings
    #[arg(long, value_name = "N", default_value = "256", value_parser = clap::value_parser!(u32).range(1..))]
    shard_frames: u32,
    #[command(flatten)]
    frames: FrameArgs,
    /// Also export the images between key frames (nuScenes: 12 Hz)
    #[arg(long, conflicts_with = "hz")]
    between_images: bool,
    #[command(flatten)]
    rate: RateArgs,
    /// Also export the recorded images, without lens distortion and at the size of the maps (always with the
    /// layouts streetcrafter and freevs)
    #[arg(long)]
    images: bool,
    /// Compare the checksums of existing shards, and write those that differ again
    #[arg(long)]
    verify: bool,
    /// Folder of the color maps in the layout pas-cache
    #[arg(long, value_name = "NAME", default_value = "proj_clr")]
    color_folder: FileName,
    /// Recordings of the validation split in the layout streetcrafter, by their names in shards [default:
    /// both splits have all recordings]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    validation_logs: Vec<String>,
    /// Captions by name of a recording or token of an image: {"scene-0061": "Parked truck, turn left"}
    #[arg(long, value_name = "F.json")]
    captions: Option<PathBuf>,
    #[command(flatten)]
    prompt: PromptArgs,
    #[command(flatten)]
    roots: LogRoots,
    #[command(flatten)]
    maps: MapArgs,
    #[command(flatten)]
    substitutes: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: lists the shards, and exports this process's.
pub(crate) fn run(args: &ExportArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let job = args.job()?;
    let listed = job.list()?;
    if args.list {
        print(&listed.part);
        return finish(&listed.failures);
    }
    let frames = listed.part.logs.iter().flat_map(|log| &log.units).map(|unit| unit.frames.len()).sum();
    let progress = FrameProgress(Mutex::new(Progress::new(frames)));
    let report = job.run(&listed, &progress)?;
    drop(progress);
    print_result(&format!(
        "{} in {:.1} s: {}",
        summary(&report),
        start.elapsed().as_secs_f64(),
        job.out.display()
    ));
    finish(&report.failures)
}

impl ExportArgs {
    fn job(&self) -> anyhow::Result<ExportJob> {
        Ok(ExportJob {
            logs: self.logs.iter().map(|log| self.roots.locate(log)).collect(),
            out: self.folder.out.clone(),
            skeletons: self.skeletons.skeletons.clone(),
            options: self.options()?,
            only: self.only,
            rasterizer: self.rasterizer.desc()?,
            jobs: self.jobs as usize,
            verify: self.verify,
            opener: LogOpener::new(),
        })
    }

    fn options(&self) -> anyhow::Result<ExportOptions> {
        let maps = self.maps.kinds(true).unwrap_or_default();
        let options = ExportOptions {
            layout: self.layout,
            conditions: self.maps.conditions(maps),
            selection: self.maps.selection(),
            substitutes: self.substitutes.options(),
            format: SampleFormat::of(self.maps.format, self.layout).map_err(usage)?,
            frames: self.frames.of_any().map(|frames| [frames.start, frames.end]),
            shard_frames: self.shard_frames as usize,
            images: self.images,
            times: match self.rate.hz {
                Some(hz) => SampleTimes::Rate { hz },
                None if self.between_images => SampleTimes::Images,
                None => SampleTimes::KeyFrames,
            },
            color_folder: self.color_folder.to_string(),
            validation_logs: self.validation_logs.iter().cloned().collect(),
            prompt: self.prompt.read()?,
            captions: self.captions.as_deref().map(Captions::read).transpose()?.unwrap_or_default(),
        };
        options.check().map_err(usage)?;
        Ok(options)
    }
}

/// Converts invalid options into [`WrongUsage`], which has its own exit code.
fn usage(error: ExportError) -> anyhow::Error {
    match error {
        ExportError::Options { .. } => WrongUsage(error.to_string()).into(),
        _ => error.into(),
    }
}

fn print(list: &WorkList) {
    let mut number = 0;
    for log in &list.logs {
        for unit in &log.units {
            let frames = &unit.frames;
            print_result(&format!("{number} {} {}..{} {}", unit.name, frames.start, frames.end, log.locator));
            number += 1;
        }
    }
}

/// Reports failed logs and shards; any of them is a failure of the command.
fn finish(failures: &[Failure]) -> anyhow::Result<()> {
    for failure in failures {
        print_progress(&format!("failed: {}: {}", failure.name, failure.error));
    }
    let count = failures.len();
    anyhow::ensure!(count == 0, "failed recordings and shards: {count}");
    Ok(())
}

fn summary(report: &ExportReport) -> String {
    let ExportReport { written, present, busy, samples, built, notes, failures, complete } = report;
    let mut parts = vec![format!("wrote {written} shards with {samples} samples")];
    let mut add = |count: usize, text: &str| {
        if count > 0 {
            parts.push(format!("{count} {text}"));
        }
    };
    add(*present, "already existed");
    add(*busy, "are being written by another process");
    add(*built, "skeletons built");
    add(failures.len(), "failures");
    if !complete {
        parts.push("not complete".to_owned());
    }
    let notes: Vec<String> = notes.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    let notes =
        if notes.is_empty() { String::new() } else { format!(" (in the data: {})", notes.join(", ")) };
    format!("{}{notes}", parts.join(", "))
}

/// Progress by samples; the time left follows from their rate.
struct FrameProgress(Mutex<Progress>);

impl ExportProgress for FrameProgress {
    fn frame(&self, shard: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).step(shard);
    }

    fn skip(&self, frames: usize) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).skip(frames);
    }
}
