//! `pskel bench`: [`args`] defines the options, [`workload`] and [`frames`] the rendered frames, [`measure`] renders
//! and times them, [`report`] and [`trace`] output the results.

mod args;
mod frames;
mod measure;
mod memory;
mod report;
mod trace;
mod workload;

pub(super) use args::BenchArgs;

use std::collections::BTreeMap;

use anyhow::Context;
use point_skeleton::raster::RasterizerInfo;

use self::frames::{Frames, Jobs};
use self::measure::{Measured, Plan, measure};
use self::report::Report;
use self::workload::Workload;
use super::progress::Progress;
use super::say;

/// Default number of timed frames for workloads other than recordings.
const DEFAULT_FRAMES: u32 = 20;

/// Runs the command: loads the workload, measures, prints the report.
pub(super) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    args.check()?;
    if let Some(path) = &args.trace {
        trace::check(path, [&args.points, &args.cameras].into_iter().flatten())?;
    }
    let workload = Workload::new(args)?;
    let mut rasterizer = args.rasterizer.create(workload.clouds()?)?;
    let plan = plan(args, &workload);
    let name_of = |frame: usize| workload.frames[plan.job_of(frame, workload.frames.len())].name.clone();
    let mut progress = Progress::new(plan.frames());
    let mut on_frame = |frame: usize| match frame < plan.warm_up {
        true => progress.step("warm-up"),
        false => progress.step(&name_of(frame)),
    };
    let mut frames: Box<dyn Frames> = match workload.steps(args)? {
        Some(steps) => Box::new(steps),
        None => Box::new(Jobs(workload.jobs(args))),
    };
    let measured = measure(rasterizer.as_mut(), frames.as_mut(), &plan, &mut on_frame)
        .context("cannot draw the frames")?;
    drop(progress);
    if let Some(path) = &args.trace {
        trace::write(path, &measured.frames, plan.in_flight, &|number| name_of(plan.warm_up + number))?;
    }
    let report = report(args, &workload, rasterizer.info(), &measured);
    if args.json {
        say(&serde_json::to_string(&report)?);
    } else {
        say(report.table(&notes(&workload, &plan)).trim_end());
        say(&report.summary());
    }
    Ok(())
}

fn plan(args: &BenchArgs, workload: &Workload) -> Plan {
    let timed = if workload.is_drive {
        args.repeat.unwrap_or(1) as usize * workload.frames.len()
    } else {
        args.repeat.unwrap_or(DEFAULT_FRAMES) as usize
    };
    Plan { warm_up: args.warm_up as usize, timed, in_flight: args.in_flight as usize }
}

fn report(args: &BenchArgs, workload: &Workload, info: RasterizerInfo, measured: &Measured) -> Report {
    let (frames, points) = (&measured.frames, workload.points() as u64);
    Report {
        info,
        points,
        cameras: workload.cameras(),
        size: workload.sizes(),
        out_size: args.out_size,
        frames: frames.len(),
        frame_ms: report::frame_ms(frames),
        stages_ms: report::stages_ms(frames),
        points_per_s: report::points_per_s(points, frames),
        peak_rss_mb: memory::peak_rss_bytes().map(|bytes| bytes as f64 / 1e6),
        filled: measured.filled,
    }
}

/// Returns notes for lines of the table.
fn notes(workload: &Workload, plan: &Plan) -> BTreeMap<&'static str, String> {
    let Plan { warm_up, in_flight, .. } = plan;
    let mut notes =
        BTreeMap::from([("frames", format!("after {warm_up} to warm up, {in_flight} in flight"))]);
    if workload.non_finite > 0 {
        notes.insert("points", format!("{} not finite, never drawn", workload.non_finite));
    }
    notes
}
