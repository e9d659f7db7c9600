//! Throughput of rendering: time per frame and per stage, points per second, peak memory.
//!
//! # How it works
//! A [`Workload`] holds clouds and the frames to render: a synthetic street, a location of many on disk, a
//! cloud with cameras, or frames of a log with its skeleton. [`bench`](fn@bench) renders them in turn, only
//! with the rasterizer or as whole steps (`frames`), and times them (`measure`). [`BenchResult`] has the
//! statistics and writes a trace of all frames (`trace`).

mod frames;
mod location;
mod measure;
mod memory;
mod options;
mod result;
mod street;
mod trace;
mod workload;

pub use measure::TimedFrame;
pub use options::{BenchError, BenchOptions};
pub use result::{BenchResult, Spread};
pub use street::{street_cloud, street_views};
pub use trace::TRACE;
pub use workload::Workload;

use point_skeleton::conditions::MapKind;
use point_skeleton::raster;
use point_skeleton::scene::SceneInstances;
use point_skeleton::{RenderOptions, Renderer};

use self::frames::{Frames, Jobs, Steps};
use self::measure::{Plan, measure};
use self::workload::Content;

/// Renders the frames of a workload and times them. Calls `on_frame` with the name of each finished frame.
///
/// # Errors
/// Fails if no device supports the rasterizer, if points of a skeleton do not match their checksum, or if a
/// frame cannot be rendered.
pub fn bench(
    workload: Workload,
    options: &BenchOptions,
    on_frame: &mut dyn FnMut(&str),
) -> Result<BenchResult, BenchError> {
    let workload = workload.resized(options.conditions.size);
    let count = workload.frames.len();
    let BenchOptions { warm_up, repeat, in_flight, .. } = *options;
    let plan = Plan { warm_up, timed: repeat * count, in_flight };
    let mut on_frame = |frame: usize| match frame < plan.warm_up {
        true => on_frame("warm-up"),
        false => on_frame(&workload.frames[plan.job_of(frame, count)].name),
    };
    let mut run = |points, frames: &mut dyn Frames| {
        let measured = measure(frames, &plan, &mut on_frame).map_err(BenchError::Render)?;
        Ok(BenchResult::new(&workload, points, options, frames.rasterizer().info(), measured))
    };
    let conditions = &options.conditions;
    match &workload.content {
        Content::Cloud(points, placed) => {
            let mut rasterizer = raster::create(&options.rasterizer, vec![points.into()])?;
            let jobs = workload.jobs(std::slice::from_ref(placed), conditions);
            run(points.len(), &mut Jobs { rasterizer: rasterizer.as_mut(), jobs })
        }
        Content::Location(skeleton, placed) => {
            let mut rasterizer = raster::create(&options.rasterizer, skeleton.clouds())?;
            let jobs = workload.jobs(std::slice::from_ref(placed), conditions);
            run(skeleton.manifest.points(), &mut Jobs { rasterizer: rasterizer.as_mut(), jobs })
        }
        Content::Log(content, log) => {
            let (skeleton, substitutes) = &**content;
            let mut renderer = Renderer::new(
                skeleton,
                RenderOptions {
                    conditions: conditions.clone(),
                    rasterizer: options.rasterizer.clone(),
                    substitutes,
                    log: Some(log),
                    ..RenderOptions::default()
                },
            )
            .map_err(BenchError::Render)?;
            let (points, states) = (renderer.points(), workload.states());
            if BenchOptions::has_whole_steps(conditions.maps) {
                let have_depth = conditions.maps.contains(MapKind::Depth);
                return run(points, &mut Steps { renderer: &mut renderer, states, have_depth });
            }
            let placed: Vec<SceneInstances> = states.iter().map(|state| renderer.instances(state)).collect();
            let jobs = workload.jobs(&placed, conditions);
            run(points, &mut Jobs { rasterizer: renderer.rasterizer(), jobs })
        }
    }
}
