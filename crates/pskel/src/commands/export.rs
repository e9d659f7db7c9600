use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::{Args, Parser};
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::conditions::{Captions, MapFormat};
use point_skeleton::dataset::{LogLocator, LogOpener, expand};
use point_skeleton::error::with_causes;
use point_skeleton::files::FileName;
use pskel_export::{
    Completeness, Export, ExportOptions, ExportProgress, ExportReport, Failure, Layout, Part, SampleFormat,
    SampleTimes, WorkList, export, write_index,
};

use crate::args::log::{self, LogRoots};
use crate::args::maps::MapArgs;
use crate::args::names::names;
use crate::args::numbers::{self, FrameRange};
use crate::args::rasterizer::RasterizerArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::logs;
use crate::progress::Progress;
use crate::{WrongUsage, say, tell};

/// Export the condition maps of many recordings in a layout that trainers read
///
/// Each recording is divided into shards of some frames. A shard is written under a temporary name and
/// appears whole, together with its record in shards/. Shards that exist are skipped, so the same command
/// continues an interrupted export, and several processes or machines may run it on one folder. Skeletons
/// that do not exist are built. Recordings that are damaged are reported at the end, and the others are
/// exported all the same. See docs/src/guide/export.md.
#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    /// Recordings: FORMAT:PATH[@VERSION][#SCENE]; "#*" is every scene of a nuScenes version, and a folder of
    /// nuPlan or Argoverse 2 logs is all of them
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    roots: LogRoots,
    /// Layout of the files
    #[arg(long, value_parser = names::<Layout>())]
    layout: Layout,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
    out: PathBuf,
    /// Folder of skeletons, one per recording and named after it; those that do not exist are built
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
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
    #[arg(long, conflicts_with = "hz")]
    between_images: bool,
    /// Export samples at this rate (0.1 to 100 per second) instead of key frames; ego and actors are
    /// interpolated
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    hz: Option<f64>,
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

/// Runs the command: lists the shards, and exports this process's.
pub(crate) fn run(args: ExportArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let out = args.out.clone();
    let export = ExportCommand { args, opener: LogOpener::new() };
    let listed = export.list()?;
    if export.args.list {
        print(&listed.part);
        return finish(&listed.failures);
    }
    let frames = listed.part.logs.iter().flat_map(|log| &log.units).map(|unit| unit.frames.len()).sum();
    let progress = FrameProgress(Mutex::new(Progress::new(frames)));
    let report = export.run(&listed, &progress)?;
    drop(progress);
    say(&format!("{} in {:.1} s: {}", summary(&report), start.elapsed().as_secs_f64(), out.display()));
    finish(&report.failures)
}

/// An export by the arguments of `pskel export`.
pub struct ExportCommand {
    args: ExportArgs,
    /// Keeps the tables of a data set between its logs.
    opener: LogOpener,
}

/// Parser of the arguments alone.
#[derive(Debug, Parser)]
#[command(name = "export", no_binary_name = true)]
struct Standalone {
    #[command(flatten)]
    args: ExportArgs,
}

/// Shards of an export.
#[derive(Clone, Debug)]
pub struct ListedExport {
    /// All shards, for the index. Without them no index is written.
    pub list: Option<WorkList>,
    /// Shards to write: the shards of `--only`.
    pub part: WorkList,
    /// Logs that cannot be opened.
    pub failures: Vec<Failure>,
}

impl ExportCommand {
    /// Parses the arguments of `pskel export`, without the names of program and command.
    ///
    /// # Errors
    /// Fails if an argument is invalid.
    pub fn parse(args: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        Ok(Self { args: Standalone::try_parse_from(args)?.args, opener: LogOpener::new() })
    }

    /// Lists the shards.
    ///
    /// # Errors
    /// Fails if a set of logs cannot be read, or if two logs have one name.
    pub fn list(&self) -> anyhow::Result<ListedExport> {
        let args = &self.args;
        let mut locators = Vec::new();
        for log in &args.logs {
            locators.extend(expand(&args.roots.locate(log))?);
        }
        let (mut known, mut failures) = (Vec::new(), Vec::new());
        for locator in locators {
            match self.opener.outline(&locator) {
                Ok(outline) => known.push((locator, outline)),
                Err(error) => {
                    failures.push(Failure { name: locator.to_string(), error: with_causes(&error) });
                }
            }
        }
        let frames = args.frames.map(FrameRange::of_any);
        let list = WorkList::new(known, args.shard_frames as usize, frames)?;
        let part = args.only.map_or_else(|| list.clone(), |part| list.part(part));
        Ok(ListedExport { list: Some(list), part, failures })
    }

    /// Exports the shards of a part. The report includes the logs that could not be listed.
    ///
    /// # Errors
    /// Fails if options contradict each other, if the folder cannot be written, or if `progress` requests a
    /// stop.
    pub fn run(&self, listed: &ListedExport, progress: &dyn ExportProgress) -> anyhow::Result<ExportReport> {
        let args = &self.args;
        let mut report = export(Export {
            list: listed.list.as_ref(),
            part: &listed.part,
            out: &args.out,
            skeletons: &args.skeletons,
            options: &args.options()?,
            open: &|locator: &LogLocator| logs::open_by(locator, &self.opener),
            rasterizer: &args.rasterizer.desc()?,
            jobs: args.jobs as usize,
            verify: args.verify,
            progress,
        })?;
        report.complete &= listed.failures.is_empty();
        report.failures.splice(0..0, listed.failures.iter().cloned());
        Ok(report)
    }

    /// Writes the index of an export whose records are in a folder, if all of them are. Returns whether they
    /// are.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write_index(&self, listed: &ListedExport, folder: &Path) -> anyhow::Result<bool> {
        let Some(list) = &listed.list else { return Ok(false) };
        Ok(write_index(list, folder, self.args.layout, Completeness::Record)?)
    }
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
        if self.layout == Layout::PasCache && self.hz.is_some() {
            let expected = "expected no --hz with --layout pas-cache, whose files are named after images";
            return Err(WrongUsage(format!("{expected}, found one")).into());
        }
        self.maps.check()?;
        let maps = self.maps.kinds(true).unwrap_or_default();
        Ok(ExportOptions {
            layout: self.layout,
            conditions: self.maps.conditions(maps),
            selection: self.maps.selection(),
            substitutes: self.stand_ins.options(),
            format,
            frames: self.frames.map(|frames| frames.of_any()).map(|frames| [frames.start, frames.end]),
            shard_frames: self.shard_frames as usize,
            images: self.images,
            times: match self.hz {
                Some(hz) => SampleTimes::Rate { hz },
                None if self.between_images => SampleTimes::Images,
                None => SampleTimes::KeyFrames,
            },
            color_folder: self.color_folder.to_string(),
            prompt: self.annotations.as_deref().map(PromptParts::read).transpose()?.unwrap_or_default(),
            captions: self.captions.as_deref().map(Captions::read).transpose()?.unwrap_or_default(),
        })
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

/// Reports failed logs and shards; any of them is a failure of the command.
fn finish(failures: &[Failure]) -> anyhow::Result<()> {
    for failure in failures {
        tell(&format!("failed: {}: {}", failure.name, failure.error));
    }
    let count = failures.len();
    anyhow::ensure!(
        count == 0,
        "expected every recording and shard to be exported, found {count} that failed"
    );
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
    add(*present, "were there already");
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
