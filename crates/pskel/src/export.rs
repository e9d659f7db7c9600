use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::Args;
use point_skeleton::conditions::MapFormat;
use point_skeleton::conditions::meta::PromptParts;
use point_skeleton::dataset::{DatasetError, LogLocator};
use point_skeleton::error::with_causes;
use point_skeleton::files::FileName;
use pskel_export::{
    Captions, Export, ExportOptions, ExportProgress, ExportReport, Layout, Part, SampleFormat, WorkList,
    export,
};

use super::log_args::{self, LogRoots};
use super::map_args::MapArgs;
use super::numbers::FrameRange;
use super::progress::Progress;
use super::rasterizer::RasterizerArgs;
use super::substitutes::SubstituteArgs;
use super::{WrongUsage, choices, say, tell};
use crate::logs;

/// Export the condition maps of many recordings in a layout that trainers read
///
/// Each recording is divided into shards of some frames. A shard is written under a temporary name and appears whole,
/// together with its record in shards/. Shards that exist are skipped, so the same command continues an interrupted
/// export, and several processes or machines may run it on one folder. Skeletons that do not exist are built. Recordings
/// that are damaged are reported at the end, and the others are exported all the same. See docs/EXPORT.md.
#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// Recordings: FORMAT:PATH[@VERSION][#SCENE]; "#*" is every scene of a nuScenes version, and a folder of nuPlan or
    /// Argoverse 2 logs is all of them
    #[arg(value_name = "LOG", required = true, value_parser = log_args::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    roots: LogRoots,
    /// Layout of the files
    #[arg(long, value_parser = choices::LAYOUT)]
    layout: Layout,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
    out: PathBuf,
    /// Folder of skeletons, one per recording and named after it; those that do not exist are built
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
    skeletons: PathBuf,
    /// Print the shards, one per line (number, name, frames, recording), and write nothing
    #[arg(long)]
    list: bool,
    /// Write only part I (counted from 0) of N parts of the list
    #[arg(long, value_name = "I/N")]
    only: Option<Part>,
    /// Number of recordings that are exported at a time, each with a device of its own
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=64))]
    jobs: u32,
    /// Key frames per shard
    #[arg(long, value_name = "N", default_value = "256", value_parser = clap::value_parser!(u32).range(1..))]
    shard_frames: u32,
    /// Range of key frames of each recording, numbered from 0, B excluded [default: all]
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    /// Also export the images between key frames (nuScenes: 12 Hz)
    #[arg(long)]
    between_images: bool,
    /// Also export the recorded images, without lens distortion and at the size of the maps
    #[arg(long)]
    images: bool,
    /// Compare the checksums of existing shards, and write those that differ again
    #[arg(long)]
    verify: bool,
    #[command(flatten)]
    maps: MapArgs,
    /// Folder of the color maps in the layout pas-cache
    #[arg(long, value_name = "NAME", default_value = "proj_clr")]
    color_folder: FileName,
    /// Captions by name of a recording or token of an image: {"scene-0061": "Parked truck, turn left"}
    #[arg(long, value_name = "F.json")]
    captions: Option<PathBuf>,
    /// Annotations for the prompt: {"weather": "Sunny", "city": "Boston"}, both optional
    #[arg(long, value_name = "F.json")]
    annotations: Option<PathBuf>,
    #[command(flatten)]
    stand_ins: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: lists the units, and exports those of this process.
pub(super) fn run(args: &ExportArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let options = args.options()?;
    let Listed { list, damaged } = args.listed()?;
    let part = args.only.map_or_else(|| list.clone(), |part| list.part(part));
    if args.list {
        print(&part);
        return finish(&damaged, &ExportReport::default());
    }
    let frames = part.logs.iter().flat_map(|log| &log.units).map(|unit| unit.frames.len()).sum();
    let progress = ShardProgress(Mutex::new(Progress::new(frames)));
    let report = export(Export {
        list: &list,
        part: &part,
        out: &args.out,
        skeletons: &args.skeletons,
        options: &options,
        open: &logs::open,
        rasterizer: &args.rasterizer.desc()?,
        jobs: args.jobs as usize,
        verify: args.verify,
        progress: &progress,
    })?;
    drop(progress);
    let seconds = start.elapsed().as_secs_f64();
    say(&format!("{} in {seconds:.1} s: {}", summary(&report, damaged.is_empty()), args.out.display()));
    finish(&damaged, &report)
}

/// Units of all logs that can be opened, and the errors of the others.
struct Listed {
    list: WorkList,
    damaged: Vec<(LogLocator, DatasetError)>,
}

impl ExportArgs {
    fn options(&self) -> anyhow::Result<ExportOptions> {
        let format = match self.maps.format {
            MapFormat::Png => SampleFormat::Png,
            MapFormat::Safetensors if self.layout == Layout::Webdataset => SampleFormat::Safetensors,
            _ => {
                let expected =
                    "expected --format png, or safetensors with --layout webdataset, found another";
                return Err(WrongUsage(expected.to_owned()).into());
            }
        };
        self.maps.check()?;
        let maps = self.maps.kinds(true).unwrap_or_default();
        let read = |path: &PathBuf| PromptParts::read(path);
        Ok(ExportOptions {
            layout: self.layout,
            conditions: self.maps.conditions(maps),
            selection: self.maps.selection(),
            substitutes: self.stand_ins.options(),
            format,
            images: self.images,
            between_images: self.between_images,
            color_folder: self.color_folder.to_string(),
            prompt: self.annotations.as_ref().map(read).transpose()?.unwrap_or_default(),
            captions: self.captions.as_deref().map(Captions::read).transpose()?.unwrap_or_default(),
        })
    }

    fn listed(&self) -> anyhow::Result<Listed> {
        let mut locators = Vec::new();
        for log in &self.logs {
            locators.extend(logs::expand(&self.roots.locate(log))?);
        }
        let (mut known, mut damaged) = (Vec::new(), Vec::new());
        for (locator, outline) in locators.iter().zip(logs::outlines(&locators)) {
            match outline {
                Ok(outline) => known.push((locator.clone(), outline)),
                Err(error) => damaged.push((locator.clone(), error)),
            }
        }
        let frames = self.frames.map(|range| range.of_any());
        Ok(Listed { list: WorkList::new(known, self.shard_frames as usize, frames)?, damaged })
    }
}

fn print(list: &WorkList) {
    let mut number = 0;
    for log in &list.logs {
        for unit in &log.units {
            let frames = &unit.frames;
            say(&format!("{number} {} {}..{} {}", unit.name, frames.start, frames.end, log.locator));
            number += 1;
        }
    }
}

/// Reports damaged logs and failed shards; any of them is a failure of the command.
fn finish(damaged: &[(LogLocator, DatasetError)], report: &ExportReport) -> anyhow::Result<()> {
    for (log, error) in damaged {
        tell(&format!("failed: {log}: {}", with_causes(error)));
    }
    for failure in &report.failures {
        tell(&format!("failed: {}: {}", failure.name, failure.error));
    }
    let count = damaged.len() + report.failures.len();
    anyhow::ensure!(
        count == 0,
        "expected every recording and shard to be exported, found {count} that failed"
    );
    Ok(())
}

fn summary(report: &ExportReport, is_whole: bool) -> String {
    let ExportReport { written, present, busy, samples, built, notes, failures, complete } = report;
    let mut parts = vec![format!("wrote {written} shards with {samples} samples")];
    let mut add = |count: usize, text: &str| {
        if count > 0 {
            parts.push(format!("{count} {text}"));
        }
    };
    add(*present, "were there already");
    add(*busy, "are being written by another process");
    add(*built, "skeletons built");
    add(failures.len(), "failures");
    if !complete {
        parts.push("no index yet, since shards are missing".to_owned());
    } else if !is_whole {
        parts.push("the index lacks recordings that cannot be opened".to_owned());
    }
    let notes: Vec<String> = notes.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    let notes =
        if notes.is_empty() { String::new() } else { format!(" (in the data: {})", notes.join(", ")) };
    format!("{}{notes}", parts.join(", "))
}

/// Progress by samples; the time left follows from their rate.
struct ShardProgress(Mutex<Progress>);

impl ExportProgress for ShardProgress {
    fn frame(&self, shard: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).step(shard);
    }

    fn skip(&self, frames: usize) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).skip(frames);
    }
}
