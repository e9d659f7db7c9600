//! Fidelity of the color map: builds a skeleton from every other frame of a log, renders the frames in between and
//! compares them with their images.
//!
//! `cargo run --release --example fidelity -- nuscenes:DIR [--every-camera]`
#![allow(clippy::print_stdout)] // prints its results

use std::path::PathBuf;

use clap::Parser;
use point_skeleton::conditions::{self, ConditionOptions, ImageSize, MapKind, MapSet, reduce};
use point_skeleton::dataset::{Dataset, ImageRecord};
use point_skeleton::files::FileName;
use point_skeleton::raster::{Rasterizer, RasterizerKind, create};
use point_skeleton::scene::{EgoOffset, SceneClouds, SelectionOptions, state_of_frame};
use point_skeleton::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton, SplitOptions};
use pskel::logs;
use pskel_eval::{FilledError, compare_filled};

/// Builds from every other frame, renders the frames in between, compares with the ground-truth images.
#[derive(Parser)]
struct Args {
    /// The log, `FORMAT:PATH[@VERSION][#SCENE]`.
    log: String,
    /// Color points from every camera that sees them (baseline).
    #[arg(long)]
    every_camera: bool,
    /// Use only every n-th of the frames in between.
    #[arg(long, default_value_t = 1)]
    stride: usize,
    /// Rasterizer.
    #[arg(long, default_value = "auto")]
    rasterizer: RasterizerKind,
    /// Also write the color map and the ground truth of each camera here.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Number of frames before and after a point's own whose images may color it.
    #[arg(long)]
    color_window: Option<usize>,
    /// Skip the occlusion test when coloring points.
    #[arg(long)]
    no_occlusion: bool,
    /// Keep the ghosts of moving actors, the ego's own returns, and the returns of all LiDARs on moving actors.
    #[arg(long)]
    keep_ghosts: bool,
}

const SIZE: ImageSize = ImageSize { height: 900, width: 1600 };

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let log = logs::open(&logs::locate(&args.log)?)?;
    let log = log.as_ref();
    let frames = log.log().frames.len();
    let kept: Vec<usize> = (0..frames).step_by(2).collect();
    let options = build_options(&args);
    let start = std::time::Instant::now();
    let folder = tempfile::tempdir()?;
    let input = BuildInput { dataset: log, frames: kept.clone() };
    let path = folder.path().join("skeleton");
    let skeleton = skeleton::build(&path, &[input], &options, &|_| Ok(Vec::new()), &BuildRun::default())?;
    println!(
        "built in {:.1} s from {} frames: {:?}",
        start.elapsed().as_secs_f64(),
        kept.len(),
        skeleton.manifest.report
    );
    let mut rasterizer = create(&args.rasterizer.into(), SceneClouds::clouds(&skeleton)?)?;
    let mut errors = Vec::new();
    for frame in (1..frames).step_by(2 * args.stride) {
        errors.extend(compare_frame(log, frame, &skeleton, rasterizer.as_mut(), args.out.as_deref())?);
    }
    report(&log.log().cameras, &errors);
    Ok(())
}

fn build_options(args: &Args) -> BuildOptions {
    let mut options = if args.every_camera { BuildOptions::every_camera() } else { BuildOptions::default() };
    options.color_window = args.color_window.unwrap_or(options.color_window);
    options.occlusion_test &= !args.no_occlusion;
    if args.keep_ghosts {
        let theirs = BuildOptions::every_camera().split;
        options.split = SplitOptions { margin_m: options.split.margin_m, ..theirs };
    }
    options
}

fn compare_frame(
    log: &dyn Dataset,
    frame: usize,
    skeleton: &Skeleton,
    rasterizer: &mut dyn Rasterizer,
    out: Option<&std::path::Path>,
) -> anyhow::Result<Vec<(usize, FilledError)>> {
    let Some(state) = state_of_frame(log.log(), frame, EgoOffset::default()) else {
        anyhow::bail!("no frame {frame}")
    };
    let instances =
        SceneClouds::new(skeleton, &log.log().name)?.instances(&state, &SelectionOptions::default());
    let maps = MapSet::of(&[MapKind::Color]);
    let options = ConditionOptions { maps, size: Some(SIZE), ..ConditionOptions::default() };
    let set = conditions::render(rasterizer, &instances, &state, &options)?;
    let mut errors = Vec::new();
    for record in &log.log().frames[frame].images {
        let name = &log.log().cameras[record.channel];
        let maps = set.cameras.iter().find(|maps| maps.name == *name);
        let Some(map) = maps.and_then(|maps| maps.color.as_ref()) else { continue };
        let truth = truth(log, record)?;
        if let Some(out) = out {
            std::fs::create_dir_all(out)?;
            let name = format!("{frame:06}-{}", log.log().cameras[record.channel]);
            save(&out.join(format!("{name}-map.png")), map)?;
            save(&out.join(format!("{name}-true.png")), &truth)?;
        }
        errors.push((record.channel, compare_filled(map, &truth)));
    }
    Ok(errors)
}

fn save(path: &std::path::Path, pixels: &[[u8; 3]]) -> anyhow::Result<()> {
    Ok(image::save_buffer(
        path,
        bytemuck::cast_slice(pixels),
        SIZE.width,
        SIZE.height,
        image::ColorType::Rgb8,
    )?)
}

/// Returns the image at [`SIZE`], reduced with PIL's BILINEAR filter.
fn truth(log: &dyn Dataset, record: &ImageRecord) -> anyhow::Result<Vec<[u8; 3]>> {
    let image = log.read_image(record)?;
    let from = ImageSize { height: image.height(), width: image.width() };
    let pixels: Vec<[u8; 3]> = image.pixels().map(|p| p.0).collect();
    Ok(reduce::pil_bilinear(&pixels, from, SIZE))
}

fn report(cameras: &[FileName], errors: &[(usize, FilledError)]) {
    println!(
        "{:<18} {:>6} {:>8} {:>8} {:>8} {:>8}",
        "camera", "images", "PSNR dB", "mean", "median", "filled %"
    );
    for (channel, name) in cameras.iter().enumerate() {
        let of: Vec<FilledError> = errors.iter().filter(|(c, _)| *c == channel).map(|(_, e)| *e).collect();
        line(name, &of);
    }
    line("all", &errors.iter().map(|(_, e)| *e).collect::<Vec<_>>());
}

fn line(name: &str, errors: &[FilledError]) {
    let mean = |f: fn(&FilledError) -> f64| errors.iter().map(f).sum::<f64>() / errors.len() as f64;
    println!(
        "{name:<18} {:>6} {:>8.2} {:>8.2} {:>8.2} {:>8.2}",
        errors.len(),
        mean(|e| e.psnr_db),
        mean(|e| e.mean_abs),
        mean(|e| e.median_abs),
        100.0 * mean(|e| e.filled)
    );
}
