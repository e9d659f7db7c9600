//! Throughput of rendering: time per frame and per stage, points per second, peak memory.
//!
//! # How it works
//! A [`Workload`] holds clouds and the frames to render: a synthetic street, a cloud with cameras, or frames of a log
//! with its skeleton. [`bench`](fn@bench) renders them in turn, only with the rasterizer or as whole steps (`frames`),
//! and times them (`measure`). [`BenchResult`] has the statistics and writes a trace of all frames (`trace`).

mod frames;
mod measure;
mod memory;
mod options;
mod result;
mod trace;
mod workload;

pub use measure::TimedFrame;
pub use options::{BenchError, BenchOptions};
pub use result::{BenchResult, Spread};
pub use trace::TRACE;
pub use workload::Workload;

use point_skeleton::raster;

use self::frames::{Frames, Jobs};
use self::measure::{Plan, measure};

/// Renders the frames of a workload and times them. Calls `on_frame` with the name of each finished frame.
///
/// # Errors
/// Fails if no device supports the rasterizer, if points of a skeleton do not match their checksum, or if a frame
/// cannot be rendered.
pub fn bench(
    workload: Workload,
    options: &BenchOptions,
    on_frame: &mut dyn FnMut(&str),
) -> Result<BenchResult, BenchError> {
    let workload = workload.resized(options.conditions.size);
    let clouds = workload.clouds()?;
    let points: usize = clouds.iter().map(|cloud| cloud.len()).sum();
    let mut rasterizer = raster::create(&options.rasterizer, clouds)?;
    let count = workload.frames.len();
    let BenchOptions { warm_up, repeat, in_flight, .. } = *options;
    let plan = Plan { warm_up, timed: repeat * count, in_flight };
    let mut on_frame = |frame: usize| match frame < plan.warm_up {
        true => on_frame("warm-up"),
        false => on_frame(&workload.frames[plan.job_of(frame, count)].name),
    };
    let mut frames: Box<dyn Frames> = match workload.steps(&options.conditions)? {
        Some(steps) => Box::new(steps),
        None => Box::new(Jobs(workload.jobs(&options.conditions))),
    };
    let measured =
        measure(rasterizer.as_mut(), frames.as_mut(), &plan, &mut on_frame).map_err(BenchError::Render)?;
    Ok(BenchResult::new(&workload, points, options, rasterizer.info(), measured))
}
