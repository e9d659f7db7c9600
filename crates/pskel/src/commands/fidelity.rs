//! `pskel fidelity`: compares condition maps with ground truth.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use point_skeleton::conditions::{ConditionOptions, ImageSize};
use point_skeleton::dataset::LogLocator;
use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, Inputs, OutputFile};
use point_skeleton::raster::SplatSchedule;
use point_skeleton::{RenderOptions, Renderer};
use pskel_eval::{FidelityFiles, FidelityFrames, FidelityReport, FidelitySource, fidelity};
use pskel_town::Town;

use crate::args::log::{self, LogRoots};
use crate::args::numbers::FrameRange;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::skeletons;
use crate::args::substitutes::SubstituteArgs;
use crate::progress::Progress;
use crate::say;

/// Measure the fidelity of condition maps against ground truth
///
/// Synthetic town: every frame is rendered from the recorded pose, from 0.5, 1, 2 and 3.5 m beside it, and
/// rotated by 5, 10 and 20 degrees. Color is compared on filled pixels, depth where both have one, masks by
/// class. Offsets are to the right, or to the left if only that is on a lane. Recorded log: color maps at the
/// times of the images are compared with these on filled pixels.
#[derive(Debug, Args)]
pub(crate) struct FidelityArgs {
    /// Synthetic town, town:seed=7,frames=40[,..], or a recording: FORMAT:PATH[@VERSION][#SCENE]
    #[arg(value_parser = log::log)]
    log: LogLocator,
    #[command(flatten)]
    roots: LogRoots,
    /// Skeleton that was built from the log
    #[arg(long, value_name = "SKEL")]
    skeleton: PathBuf,
    /// Range of frames, numbered from 0 in log order, B excluded [default: all]
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    /// Compare only every N-th frame: N - 1, 2 N - 1, .., none of those of a skeleton of `build --every N`
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(2..))]
    hold_out: Option<u16>,
    /// Render at this size; scales the intrinsics [default: the size of the cameras]
    #[arg(long, value_name = "HxW")]
    size: Option<ImageSize>,
    /// Reduce maps and ground truth to this size after rendering [default: no reduction]
    #[arg(long, value_name = "HxW")]
    out_size: Option<ImageSize>,
    /// Splat radius by depth: up to Z meters a point covers (2R+1) x (2R+1) pixels; points beyond the last Z
    /// are culled
    #[arg(long, value_name = "Z:R,..", default_value_t)]
    splat: SplatSchedule,
    #[command(flatten)]
    stand_ins: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
    /// Write the report: FILE.json (all numbers), FILE.csv or FILE.md (the table); may be repeated
    #[arg(long, value_name = "FILE", value_parser = Form::path)]
    out: Vec<PathBuf>,
}

/// Form of a written report.
struct Form {
    extension: &'static str,
    kind: FileKind,
    write: fn(&OutputFile, &FidelityReport) -> Result<(), FileError>,
}

impl Form {
    const ALL: [Self; 3] = [
        Self { extension: "json", kind: FidelityFiles::JSON, write: |file, report| file.write_json(report) },
        Self {
            extension: "csv",
            kind: FidelityFiles::CSV,
            write: |file, report| write_text(file, &report.csv()),
        },
        Self {
            extension: "md",
            kind: FidelityFiles::MARKDOWN,
            write: |file, report| write_text(file, &report.markdown()),
        },
    ];

    /// Returns the form of a file by its extension.
    fn of(path: &Path) -> Option<Self> {
        Self::ALL.into_iter().find(|form| path.extension().is_some_and(|other| other == form.extension))
    }

    /// Argument parser for the path of a report.
    fn path(text: &str) -> Result<PathBuf, String> {
        let path = PathBuf::from(text);
        let expected = || "expected a file .json, .csv or .md".to_owned();
        Self::of(&path).is_some().then_some(path).ok_or_else(expected)
    }
}

/// Runs the command: renders, compares, prints the table.
pub(crate) fn run(args: &FidelityArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let locator = args.roots.locate(&args.log);
    let inputs = Inputs::new(locator.inputs()).and([&args.skeleton]).and(args.stand_ins.inputs());
    let forms = args.out.iter().filter_map(|path| Some((path, Form::of(path)?)));
    let open = |(path, form): (&PathBuf, Form)| {
        let file = OutputFile::open(path, form.kind, &inputs)?;
        anyhow::Ok((file, form.write))
    };
    let files = forms.map(open).collect::<anyhow::Result<Vec<_>>>()?;
    let (town, recorded);
    let source = if *locator.format == pskel_town::FORMAT {
        town = Town::open(&locator)?;
        FidelitySource::Town(&town)
    } else {
        recorded = args.roots.open(&args.log)?;
        FidelitySource::Log(&recorded)
    };
    let log = source.recording();
    let skeleton = skeletons::open_for(&args.skeleton, log)?;
    let range = FrameRange::of(args.frames, log.frames.len())?;
    let frames = FidelityFrames { range, hold_out: args.hold_out.map(usize::from) };
    let (substitutes, _) = args.stand_ins.options().make(&skeleton, &log.name)?;
    let render = RenderOptions {
        rasterizer: args.rasterizer.desc()?,
        substitutes: &substitutes,
        log: Some(&log.name),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&skeleton, render)?;
    let options = ConditionOptions {
        splat: args.splat.clone(),
        size: args.size,
        out_size: args.out_size,
        ..ConditionOptions::default()
    };
    let mut progress = Progress::new(source.poses() * frames.iter().count());
    let mut on_step = |name: &str| progress.step(name);
    let report = fidelity(source, &mut renderer, &frames, options, &mut on_step)?;
    drop(progress);
    files.iter().try_for_each(|(file, write)| write(file, &report))?;
    say(report.table().trim_end());
    let images = report.rows.images();
    let (seconds, skeleton) = (start.elapsed().as_secs_f64(), args.skeleton.display());
    say(&format!("compared {images} images of {} in {seconds:.2} s: {skeleton}", log.shown_name()));
    Ok(())
}

fn write_text(file: &OutputFile, text: &str) -> Result<(), FileError> {
    file.write(|out| out.write_all(text.as_bytes()).map_err(FileError::io("write", file.path())))
}
