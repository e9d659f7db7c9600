//! Fidelity of the color map: builds a skeleton from every other frame of a log, renders the frames in
//! between and compares them with their images.
//!
//! `cargo run --release --example fidelity -- nuscenes:DIR [--every-camera]`
#![allow(clippy::print_stdout)] // prints its results

use std::path::PathBuf;

use clap::Parser;
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind, MapSet, reduce};
use point_skeleton::dataset::{EgoTrack, ImageRecord};
use point_skeleton::files::FileName;
use point_skeleton::raster::RasterizerKind;
use point_skeleton::scene::{EgoOffset, Substitutes, state_of_frame, state_of_images};
use point_skeleton::skeleton::{self, BuildInput, BuildOptions, BuildRun, SplitOptions};
use point_skeleton::{Log, RenderOptions, Renderer};
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
    /// Compare with actors at the frame's time instead of each image's.
    #[arg(long)]
    frame_time: bool,
    /// Keep the ghosts of moving actors and the ego's own returns.
    #[arg(long)]
    keep_ghosts: bool,
    /// Keep the returns of all LiDARs on moving actors.
    #[arg(long)]
    every_lidar: bool,
    /// Side of the voxels that merge points, meters.
    #[arg(long)]
    voxel: Option<f64>,
}

const SIZE: ImageSize = ImageSize { height: 900, width: 1600 };

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let log = logs::open(&logs::locate(&args.log)?)?;
    let frames = log.recording().frames.len();
    let kept: Vec<usize> = (0..frames).step_by(2).collect();
    let options = build_options(&args);
    let start = std::time::Instant::now();
    let folder = tempfile::tempdir()?;
    let input = BuildInput { reader: log.reader(), frames: kept.clone() };
    let path = folder.path().join("skeleton");
    let skeleton = skeleton::build(&path, &[input], &options, &|_| Ok(Vec::new()), &BuildRun::default())?;
    println!(
        "built in {:.1} s from {} frames: {:?}",
        start.elapsed().as_secs_f64(),
        kept.len(),
        skeleton.manifest.report
    );
    let maps = MapSet::of(&[MapKind::Color]);
    let render = RenderOptions {
        conditions: ConditionOptions { maps, size: Some(SIZE), ..ConditionOptions::default() },
        rasterizer: args.rasterizer.into(),
        substitutes: &Substitutes::NONE,
        log: Some(&log.recording().name),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&skeleton, render)?;
    let ego = EgoTrack::new(log.recording());
    let mut errors = Vec::new();
    for frame in (1..frames).step_by(2 * args.stride) {
        errors.extend(compare_frame((&log, &ego), frame, &mut renderer, &args)?);
    }
    report(&log.recording().cameras, &errors);
    Ok(())
}

fn build_options(args: &Args) -> BuildOptions {
    let mut options = if args.every_camera { BuildOptions::every_camera() } else { BuildOptions::default() };
    options.color_window = args.color_window.unwrap_or(options.color_window);
    options.occlusion_test &= !args.no_occlusion;
    options.voxel_m = args.voxel.unwrap_or(options.voxel_m);
    if args.every_lidar {
        options.split.primary_lidar = None;
    }
    if args.keep_ghosts {
        let theirs = BuildOptions::every_camera().split;
        let SplitOptions { margin_m, primary_lidar, .. } = options.split;
        options.split = SplitOptions { margin_m, primary_lidar, ..theirs };
    }
    options
}

/// Compares the images of a frame with the maps of the skeleton at each image's own time: actors move between
/// the images of a frame.
fn compare_frame(
    (source, ego): (&Log, &EgoTrack),
    frame: usize,
    renderer: &mut Renderer<'_>,
    args: &Args,
) -> anyhow::Result<Vec<(usize, FilledError)>> {
    let log = source.recording();
    let mut errors = Vec::new();
    for record in &log.frames[frame].images {
        let state = if args.frame_time {
            state_of_frame(log, frame, EgoOffset::default())
        } else {
            state_of_images(log, ego, record.t_us, &[record])
        };
        let Some(mut state) = state else { anyhow::bail!("no pose at {} us, frame {frame}", record.t_us) };
        let name = &log.cameras[record.channel];
        state.cameras.retain(|camera| camera.view.camera.name == *name);
        let maps = renderer.render(&state)?;
        let Some(map) = maps.cameras().first().and_then(|maps| maps.color.as_ref()) else {
            anyhow::bail!("no map of {name}, frame {frame}")
        };
        let truth = truth(source, record)?;
        if let Some(out) = &args.out {
            std::fs::create_dir_all(out)?;
            save(&out.join(format!("{frame:06}-{name}-map.png")), map)?;
            save(&out.join(format!("{frame:06}-{name}-true.png")), &truth)?;
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
fn truth(log: &Log, record: &ImageRecord) -> anyhow::Result<Vec<[u8; 3]>> {
    let image = log.reader().read_image(record)?;
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
