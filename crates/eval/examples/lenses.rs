//! Compares colors of points from images of other lenses: `cargo run --release -p pskel-eval --features town
//! --example lenses -- LOG FRAMES OUT`.
//!
//! Builds three skeletons of every second frame: from the images of a log of pinholes, and from these images
//! warped to a fisheye (MEI) and an f-theta lens of about the same field of view. Compares color maps of the
//! frames between with the log's own images, as `pskel fidelity --hold-out 2`.

#![allow(clippy::print_stdout, reason = "a program")]

use std::path::Path;
use std::sync::Arc;

use point_skeleton::conditions::{ConditionOptions, ImageSize};
use point_skeleton::dataset::{LogReader, open};
use point_skeleton::geometry::{FTheta, LensModel, Mei};
use point_skeleton::skeleton::{BuildInput, BuildRun, build};
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_eval::{FidelityFrames, FidelitySource, fidelity};
use pskel_testing::warped_log::{WarpedLog, covered};

type Failure = Box<dyn std::error::Error>;

/// Prints the fidelity of a skeleton built from the images of a reader.
fn measure(name: &str, reader: &dyn LogReader, log: &Log, frames: usize, out: &Path) -> Result<(), Failure> {
    let input = BuildInput { reader, frames: (0..frames).step_by(2).collect() };
    let (folder, run) = (out.join(name), BuildRun::default());
    let skeleton = build(&folder, &[input], &Default::default(), &|_| Ok(Vec::new()), &run)?;
    let mut renderer = Renderer::new(&skeleton, RenderOptions::default())?;
    let size = |height, width| Some(ImageSize { height, width });
    let options =
        ConditionOptions { size: size(450, 800), out_size: size(256, 448), ..ConditionOptions::default() };
    let frames = FidelityFrames { range: 0..frames, hold_out: Some(2) };
    let report = fidelity(FidelitySource::Log(log), &mut renderer, &frames, options, &mut |_| {})?;
    println!("{name}\n{}", report.table());
    Ok(())
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().collect();
    let [_, name, frames, out] = args.as_slice() else { return Err("expected LOG FRAMES OUT".into()) };
    let (locator, frames, out) = (name.parse()?, frames.parse()?, Path::new(out));
    let (log, original): (_, Arc<dyn LogReader>) = (Log::open(name)?, Arc::from(open(&locator)?));
    measure("pinhole", &*original, &log, frames, out)?;
    let mei =
        LensModel::Mei(Mei::new(2.213_404_750_785_489, [0.016_798_235_660_113_68, 1.654_877_324_337_352_2])?);
    let f_theta = LensModel::FTheta(FTheta::new([0.0, 900.0, 5.0, -30.0, 2.0, 0.0])?);
    for (name, lens) in [("mei", mei), ("f-theta", f_theta)] {
        let warped = WarpedLog::new(Arc::clone(&original), |camera| covered(camera, lens));
        measure(name, &warped, &log, frames, out)?;
    }
    Ok(())
}
