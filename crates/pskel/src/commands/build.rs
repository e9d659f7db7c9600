use std::cell::RefCell;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Instant;

use clap::Args;
use point_skeleton::Log;
use point_skeleton::cloud::Point;
use point_skeleton::dataset::{LogLocator, expand};
use point_skeleton::files::Inputs;
use point_skeleton::files::text::printable;
use point_skeleton::named::UnknownName;
use point_skeleton::skeleton::{
    self, Asset, BuildInput, BuildOptions, BuildRun, Coloring, Manifest, SkeletonWriter, TemplateCloud,
    TemplateKind, TemplateLibrary, TemplateSources,
};

use super::{info, templates};
use crate::args::frames::FrameArgs;
use crate::args::log::{self, LogRoots};
use crate::args::names::names;
use crate::args::numbers;
use crate::args::outputs::FolderArgs;
use crate::logs;
use crate::progress::StageProgress;
use crate::{WrongUsage, print_notes, print_result, warn};

/// Build a point skeleton from recordings: colored background, and an asset per tracked actor
///
/// Writes a folder with skeleton.json (content, options, and counts of dropped points by reason) and three
/// files of points. An older skeleton in that folder is replaced once the new one is complete. Until then, a
/// folder SKEL.partial holds the finished part; after an interruption, --resume continues it.
#[derive(Debug, Args)]
pub(crate) struct BuildArgs {
    /// Recording: [FORMAT:]PATH[@VERSION][#SCENE], like /data/nuscenes#scene-0061; several
    /// recordings of one place share a background
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    folder: FolderArgs,
    /// Side of the voxels in which points are merged, meters; 0 retains all points [default: 0.01; 0 with
    /// --coloring every-camera]
    #[arg(long, value_name = "M", value_parser = numbers::voxel_m, allow_negative_numbers = true)]
    voxel: Option<f64>,
    /// Side of the voxels for actors' points, meters; 0 retains all points, as in the paper [default:
    /// --voxel]
    #[arg(long, value_name = "M", value_parser = numbers::voxel_m, allow_negative_numbers = true)]
    actor_voxel: Option<f64>,
    /// Continue an interrupted build of the same logs, frames and options, if there is one
    #[arg(long)]
    resume: bool,
    /// Number of frames between checkpoints
    #[arg(long, value_name = "N", default_value = "20", value_parser = clap::value_parser!(u32).range(1..))]
    checkpoint: u32,
    /// Use only every N-th frame
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    #[command(flatten)]
    frames: FrameArgs,
    /// Also use the sweeps between annotated frames, with interpolated boxes
    #[arg(long)]
    sweeps: bool,
    /// Grow boxes by this margin on every side before points are assigned to actors, meters [default: depends
    /// on --coloring]
    #[arg(long, value_name = "M", value_parser = numbers::margin_m, allow_negative_numbers = true)]
    box_margin: Option<f64>,
    /// How points are colored; every-camera reproduces existing scripts, for comparison
    #[arg(long, value_parser = names::<Coloring>(), default_value = "agreed")]
    coloring: Coloring,
    /// Template for actors of a kind (sedan, suv, pickup, pedestrian, bike, truck, bus, trailer,
    /// construction): points with x forward and z up; at most once per kind
    #[arg(long = "template", value_name = "KIND=FILE.npy|ply")]
    templates: Vec<TemplateFile>,
    /// Create templates from the log's own actors; --template takes precedence
    #[arg(long = "templates")]
    own_templates: bool,
    /// Folder of `pskel templates`, used for kinds that have no template yet
    #[arg(long, value_name = "DIR")]
    templates_from: Option<PathBuf>,
    #[command(flatten)]
    roots: LogRoots,
}

/// Argument `KIND=FILE`.
#[derive(Clone, Debug)]
struct TemplateFile {
    kind: TemplateKind,
    path: PathBuf,
}

impl FromStr for TemplateFile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, path) = text.split_once('=').ok_or("expected KIND=FILE")?;
        let kind = kind.parse().map_err(|error: UnknownName| error.to_string())?;
        Ok(Self { kind, path: path.into() })
    }
}

/// Runs the command: opens the logs, builds and writes the skeleton.
pub(crate) fn run(args: BuildArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    SkeletonWriter::check_target(&args.folder.out, &args.inputs())?;
    if let Some(frames) = skeleton::unfinished_frames(&args.folder.out).filter(|_| !args.resume) {
        warn(&format!(
            "an unfinished build with {frames} frames done is discarded; pass --resume to continue it"
        ));
    }
    if args.resume && skeleton::unfinished_frames(&args.folder.out).is_none() {
        warn("--resume: found no unfinished build, starting with the first frame");
    }
    let given = read_templates(&args.templates)?;
    let library = args.templates_from.as_deref().map(TemplateLibrary::open).transpose()?.unwrap_or_default();
    let logs = args.open()?;
    let inputs = logs.iter().map(|log| args.input(log));
    let inputs: Vec<BuildInput> = inputs.collect::<anyhow::Result<_>>()?;
    let progress = StageProgress::default();
    let run =
        BuildRun { resume: args.resume, checkpoint_frames: args.checkpoint as usize, progress: &progress };
    let sources = TemplateSources { given, own: args.own_templates, library: library.clouds };
    let own = RefCell::new(String::new());
    let templates = |assets: &[(&Asset, &[Point])]| {
        let (templates, report) = sources.templates(assets);
        own.replace(report.as_ref().map_or(String::new(), templates::of_actors));
        Ok(templates)
    };
    let built = skeleton::build(&args.folder.out, &inputs, &args.options(), &templates, &run)?;
    drop(progress);
    let seconds = start.elapsed().as_secs_f64();
    print_result(&format!(
        "{}{} in {seconds:.2} s: {}",
        summary(&built.manifest),
        own.take(),
        args.folder.out.display()
    ));
    Ok(())
}

impl BuildArgs {
    /// Returns everything that is read.
    fn inputs(&self) -> Inputs {
        let logs = self.logs.iter().map(|log| self.roots.locate(log)).collect::<Vec<_>>();
        let templates = self.templates.iter().map(|file| &file.path);
        Inputs::new(logs.iter().flat_map(LogLocator::inputs)).and(templates).and(&self.templates_from)
    }

    fn open(&self) -> anyhow::Result<Vec<Log>> {
        let mut opened = Vec::new();
        for log in &self.logs {
            for log in expand(&self.roots.locate(log))? {
                let log = logs::open(&log)?;
                log::warn_of_gaps(log.recording());
                opened.push(log);
            }
        }
        Ok(opened)
    }

    fn input<'a>(&self, log: &'a Log) -> anyhow::Result<BuildInput<'a>> {
        let frames = self.frames.of(log.recording().frames.len())?;
        Ok(BuildInput { reader: log.reader(), frames: frames.step_by(self.every as usize).collect() })
    }

    fn options(&self) -> BuildOptions {
        let mut options = BuildOptions::of(self.coloring);
        options.voxel_m = self.voxel.unwrap_or(options.voxel_m);
        options.actor_voxel_m = self.actor_voxel;
        options.split.margin_m = self.box_margin.unwrap_or(options.split.margin_m);
        options.between_sweeps = self.sweeps;
        options
    }
}

fn read_templates(files: &[TemplateFile]) -> anyhow::Result<Vec<TemplateCloud>> {
    for (i, file) in files.iter().enumerate() {
        if files[..i].iter().any(|other| other.kind == file.kind) {
            return Err(
                WrongUsage(format!("expected one --template a kind, found {:?} twice", file.kind)).into()
            );
        }
    }
    let read = |file: &TemplateFile| {
        let (template, notes) = skeleton::read_template(file.kind, &file.path)?;
        print_notes(&file.path, &notes);
        Ok(template)
    };
    files.iter().map(read).collect()
}

fn summary(built: &Manifest) -> String {
    let report = &built.report;
    let (background, actors) = (built.background_points(), built.actor_points());
    let merged = report.background_points + report.actor_points - background - actors;
    let notes: Vec<String> = report.notes.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    let notes = if notes.is_empty() { String::new() } else { format!("; the log has {}", notes.join(", ")) };
    let logs: Vec<_> = built.sources.iter().map(|source| printable(&source.log)).collect();
    format!(
        "built {} from {} frames ({} points of {} sweeps, {} images): {background} background points in {} \
            chunks, \
         {actors} points of {} actors, {} templates; {merged} merged in voxels; dropped \
         {}{notes}",
        logs.join(", "),
        built.sources.iter().map(|source| source.frames).sum::<usize>(),
        report.points_read,
        report.sweeps,
        report.images,
        built.background.len(),
        built.actors.len(),
        built.templates.len(),
        info::dropped(report),
    )
}
