//! `pskel fidelity`: compares condition maps of the synthetic town with ground truth.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use point_skeleton::dataset::LogReader;
use point_skeleton::error::FileError;
use point_skeleton::files::{Inputs, OutputFile};
use point_skeleton::{RenderOptions, Renderer};
use pskel_eval::{FidelityFiles, POSES, fidelity};
use pskel_town::Town;

use crate::args::frames::FrameArgs;
use crate::args::outputs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::size::SizeArgs;
use crate::args::source::SourceArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::progress::Progress;
use crate::{WrongUsage, say};

/// Measure the fidelity of condition maps: those of the synthetic town against its ground truth
///
/// Every frame is rendered from the recorded pose, from 0.5, 1, 2 and 3.5 m beside it, and rotated by 5, 10
/// and 20 degrees. Color is compared on filled pixels, depth where both have one, masks by class. Offsets are
/// to the right, or to the left if only that is on a lane.
#[derive(Debug, Args)]
pub(crate) struct FidelityArgs {
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    frames: FrameArgs,
    #[command(flatten)]
    size: SizeArgs,
    #[command(flatten)]
    substitutes: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
    /// Write all numbers as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the table as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the table as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

/// Runs the command: renders, compares, prints the table.
pub(crate) fn run(args: &FidelityArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    if *args.source.log.format != pskel_town::FORMAT {
        let message =
            format!("expected a log town:.., of which the truth is known, found {}", args.source.log);
        return Err(WrongUsage(message).into());
    }
    let inputs = Inputs::new([&args.source.skeleton]).and(args.substitutes.inputs());
    let files = [
        ("--json", args.json.as_deref(), FidelityFiles::JSON),
        ("--csv", args.csv.as_deref(), FidelityFiles::CSV),
        ("--markdown", args.markdown.as_deref(), FidelityFiles::MARKDOWN),
    ];
    let [json, csv, markdown] = outputs::open(files, &inputs, None)?;
    let town = Town::open(&args.source.log)?;
    let log = town.recording();
    let skeleton = args.source.open_skeleton(log)?;
    let frames = args.frames.of(log.frames.len())?;
    let (substitutes, _) = args.substitutes.options().make(&skeleton, &log.name)?;
    let render = RenderOptions {
        rasterizer: args.rasterizer.desc()?,
        substitutes: &substitutes,
        log: Some(&log.name),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&skeleton, render)?;
    let mut progress = Progress::new(POSES * frames.len());
    let mut on_step = |name: &str| progress.step(name);
    let report = fidelity(&town, &mut renderer, frames, args.size.conditions(), &mut on_step)?;
    drop(progress);
    json.map_or(Ok(()), |file| file.write_json(&report))?;
    write_text(csv, &report.csv())?;
    write_text(markdown, &report.markdown())?;
    say(report.table().trim_end());
    let images = report.poses.iter().map(|row| row.images).sum::<usize>();
    let (seconds, skeleton) = (start.elapsed().as_secs_f64(), args.source.skeleton.display());
    say(&format!("compared {images} images of {} in {seconds:.2} s: {skeleton}", log.name));
    Ok(())
}

fn write_text(file: Option<OutputFile>, text: &str) -> Result<(), FileError> {
    let Some(file) = file else { return Ok(()) };
    file.write(|out| out.write_all(text.as_bytes()).map_err(FileError::io("write", file.path())))
}
