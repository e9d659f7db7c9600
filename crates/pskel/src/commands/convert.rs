use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use point_skeleton::cloud::{self, PointFormat};
use point_skeleton::dataset::nuscenes::{self, InterpolatedCounts};
use point_skeleton::error::FileError;
use point_skeleton::files::Inputs;
use point_skeleton::skeleton::Skeleton;

use crate::args::names::names;
use crate::args::{log, outputs};
use crate::{WrongUsage, print_notes, print_progress, print_result};

/// Convert points: a skeleton to NPY or PLY files, or one such file to the other format; or annotations of
/// nuScenes to a higher rate
///
/// A skeleton becomes a folder with background, actors/TRACK and templates/KIND, floats Nx6 (x y z r g b),
/// and origins.json, which holds the origin of the background's coordinates and the file of each track. With
/// --hz, the annotations of a nuScenes version are interpolated: to ROOT/interp_12Hz_trainval, for instance.
#[derive(Debug, Args)]
pub(crate) struct ConvertArgs {
    /// Skeleton folder, or a file of points; with --hz nuscenes:ROOT[@VERSION]
    #[arg(value_name = "SKEL|P.npy|P.ply|DATASET")]
    input: PathBuf,
    /// Samples per second of new tables in the layout of ASAP, a multiple of 2: N / 2 frames between two
    /// annotated samples, whatever the time between them
    #[arg(long, value_name = "N", conflicts_with = "format")]
    hz: Option<u8>,
    /// Folder or file to write
    #[arg(long, value_name = "PATH", value_parser = outputs::output_folder())]
    out: PathBuf,
    /// Format to write [default: npy for a skeleton; for a file, the extension of --out]
    #[arg(long, value_parser = names::<PointFormat>())]
    format: Option<PointFormat>,
}

/// Runs the command: reads and writes points.
pub(crate) fn run(args: ConvertArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let what = if let Some(hz) = args.hz {
        convert_tables(&args.input, hz, &args.out)?
    } else if args.input.is_dir() {
        convert_skeleton(&args.input, &args.out, args.format.unwrap_or(PointFormat::Npy))?
    } else {
        convert_file(&args)?
    };
    print_result(&format!(
        "converted {what} in {:.2} s: {}",
        start.elapsed().as_secs_f64(),
        args.out.display()
    ));
    Ok(())
}

fn convert_tables(input: &Path, hz: u8, out: &Path) -> anyhow::Result<String> {
    let text = input.to_string_lossy();
    let locator = log::log(&text).ok().filter(|locator| *locator.format == nuscenes::FORMAT);
    let locator = locator
        .ok_or_else(|| WrongUsage(format!("expected nuscenes:ROOT[@VERSION] with --hz, found {text}")))?;
    let counts = nuscenes::interpolate_tables(&locator, hz, out)?;
    let InterpolatedCounts { samples, annotations, files, repeated } = counts;
    if repeated > 0 {
        print_progress(&format!(
            "note: {repeated} of {files} images and sweeps repeat an annotated sample's, since no other was \
                recorded closer"
        ));
    }
    Ok(format!("tables to {samples} samples, {annotations} annotations, {files} images and sweeps"))
}

fn convert_skeleton(input: &Path, out: &Path, format: PointFormat) -> Result<String, FileError> {
    let skeleton = Skeleton::open(input)?;
    let notes = skeleton.export(out, format)?;
    print_notes(input, &notes);
    let manifest = &skeleton.manifest;
    let (points, actors, templates) =
        (manifest.background_points(), manifest.actors.len(), manifest.templates.len());
    Ok(format!("{points} background points, {actors} actors, {templates} templates"))
}

fn convert_file(args: &ConvertArgs) -> anyhow::Result<String> {
    let format = match (args.format, PointFormat::of(&args.out)) {
        (None, None) => {
            return Err(WrongUsage("expected --out ending in .npy or .ply, or --format".to_owned()).into());
        }
        (Some(format), Some(ending)) if format != ending => {
            let message =
                format!("expected --out ending in .{}, found .{}", format.extension(), ending.extension());
            return Err(WrongUsage(message).into());
        }
        (format, ending) => format.or(ending).unwrap_or(PointFormat::Npy),
    };
    let out = format.open_files(&args.out, &Inputs::new([&args.input]))?;
    let file = cloud::read(&args.input)?;
    print_notes(&args.input, &file.notes);
    let origin = match out.write(&file)? {
        Some(path) => format!(", relative to the origin in {}", path.display()),
        None => String::new(),
    };
    Ok(format!("{} points{origin}", file.points.len()))
}
