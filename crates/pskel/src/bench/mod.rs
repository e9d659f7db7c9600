//! `pskel bench`: [`args`] defines the options, [`report`] formats the result.

mod args;
mod report;

pub(super) use args::BenchArgs;

use std::collections::BTreeMap;
use std::path::PathBuf;

use pskel_eval::bench::{bench, check_trace_file};

use super::progress::Progress;
use super::say;

/// Runs the command: loads the workload, measures, prints the report.
pub(super) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    args.check()?;
    if let Some(path) = &args.trace {
        let inputs = [&args.points, &args.cameras].into_iter().flatten().map(PathBuf::as_path);
        check_trace_file(path, inputs)?;
    }
    let workload = args.workload()?;
    let options = args.options()?;
    let mut progress = Progress::new(options.frames(workload.frame_count()));
    let result = bench(workload, &options, &mut |name| progress.step(name))?;
    drop(progress);
    if let Some(path) = &args.trace {
        result.write_trace(path)?;
    }
    if args.json {
        say(&serde_json::to_string(&result)?);
        return Ok(());
    }
    let frames = format!("after {} to warm up, {} in flight", args.warm_up, args.in_flight);
    let mut notes = BTreeMap::from([("frames", frames)]);
    if result.non_finite > 0 {
        notes.insert("points", format!("{} not finite, never drawn", result.non_finite));
    }
    say(report::table(&result, &notes).trim_end());
    say(&report::summary(&result));
    Ok(())
}
