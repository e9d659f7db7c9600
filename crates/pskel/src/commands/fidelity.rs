//! `pskel fidelity`: compares condition maps with ground truth.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, OutputFile};
use point_skeleton::{RenderOptions, Renderer};
use pskel_eval::{FidelityFiles, FidelityFrames, FidelityReport, FidelitySource, fidelity, sweep_fidelity};
use pskel_town::Town;

use crate::args::frames::{FrameArgs, HoldOutArgs};
use crate::args::lidar;
use crate::args::outputs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::size::SizeArgs;
use crate::args::source::SourceArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::print_result;
use crate::progress::Progress;

/// Measure the fidelity of condition maps against ground truth
///
/// Synthetic town: every frame is rendered from the recorded pose, from 0.5, 1, 2 and 3.5 m beside it, and
/// rotated by 5, 10 and 20 degrees. Color is compared on filled pixels, depth where both have one, masks by
/// class. Offsets are to the right, or to the left if only that is on a lane. Recorded log: color maps at the
/// times of the images are compared with these on filled pixels. With --lidar, sweeps are compared instead.
#[derive(Debug, Args)]
pub(crate) struct FidelityArgs {
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    frames: FrameArgs,
    #[command(flatten)]
    size: SizeArgs,
    #[command(flatten)]
    held_out: HoldOutArgs,
    /// Write the report: FILE.json (all numbers), FILE.csv or FILE.md (the table); may be repeated
    #[arg(long, value_name = "FILE", value_parser = Form::path)]
    out: Vec<PathBuf>,
    /// Compare LiDAR sweeps instead: the town's with beams that are cast through it, also from 2 m beside and
    /// 5 degrees turned; a log's recorded ones with rays toward their points. The spec gives timing and
    /// range: hdl-32e, vlp-32c, pandar64, pandar128, av2, nuplan, or a JSON file of devices (name.json)
    #[arg(
        long, value_name = "SPEC", value_parser = lidar::spec,
        conflicts_with_all = ["size", "out_size", "splat"],
    )]
    lidar: Option<String>,
    #[command(flatten)]
    substitutes: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
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
    let inputs = args.source.inputs().and(args.substitutes.inputs()).and(lidar::file(args.lidar.as_deref()));
    outputs::check_different(args.out.iter().map(|path| ("--out", path.as_path())))?;
    let forms = args.out.iter().filter_map(|path| Some((path, Form::of(path)?)));
    let open = |(path, form): (&PathBuf, Form)| {
        let file = OutputFile::open(path, form.kind, &inputs)?;
        anyhow::Ok((file, form.write))
    };
    let files = forms.map(open).collect::<anyhow::Result<Vec<_>>>()?;
    let (town, recorded);
    let source = if *args.source.log.format == pskel_town::FORMAT {
        town = Town::open(&args.source.roots.locate(&args.source.log))?;
        FidelitySource::Town(&town)
    } else {
        recorded = args.source.open()?;
        FidelitySource::Log(&recorded)
    };
    let log = source.recording();
    let skeleton = args.source.open_skeleton(log)?;
    let range = args.frames.of(log.frames.len())?;
    let frames = FidelityFrames { range, hold_out: args.held_out.hold_out.map(usize::from) };
    let (substitutes, _) = args.substitutes.options().make(&skeleton, &log.name)?;
    let render = RenderOptions {
        rasterizer: args.rasterizer.desc()?,
        substitutes: &substitutes,
        log: Some(&log.name),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&skeleton, render)?;
    let spec = args.lidar.as_deref().map(|text| lidar::mounted(text, log)).transpose()?;
    let poses = if spec.is_some() { source.sweep_poses() } else { source.poses() };
    let mut progress = Progress::new(poses * frames.iter().count());
    let mut on_step = |name: &str| progress.step(name);
    let report = match spec {
        Some(spec) => sweep_fidelity(source, &mut renderer, &frames, &spec, &mut on_step)?,
        None => fidelity(source, &mut renderer, &frames, args.size.conditions(), &mut on_step)?,
    };
    drop(progress);
    files.iter().try_for_each(|(file, write)| write(file, &report))?;
    print_result(report.table().trim_end());
    let ((count, what), seconds) = (report.rows.compared(), start.elapsed().as_secs_f64());
    let (name, skeleton) = (log.shown_name(), args.source.skeleton.display());
    print_result(&format!("compared {count} {what} of {name} in {seconds:.2} s: {skeleton}"));
    Ok(())
}

fn write_text(file: &OutputFile, text: &str) -> Result<(), FileError> {
    file.write(|out| out.write_all(text.as_bytes()).map_err(FileError::io("write", file.path())))
}
