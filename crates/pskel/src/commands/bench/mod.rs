//! `pskel bench`: [`args`] defines the options, [`report`] formats the result.

mod args;
mod report;

pub(crate) use args::BenchArgs;

use std::collections::BTreeMap;

use pskel_eval::bench::{TRACE, bench};

use crate::args::outputs;
use crate::print_result;
use crate::progress::Progress;

/// Runs the command: loads the workload, measures, prints the report.
pub(crate) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    args.check()?;
    let [trace] = outputs::open([("--trace", args.trace.as_deref(), TRACE)], &args.inputs(), None)?;
    let workload = args.workload()?;
    let options = args.options()?;
    let mut progress = Progress::new(options.frames(workload.frame_count()));
    let result = bench(workload, &options, &mut |name| progress.step(name))?;
    drop(progress);
    trace.map_or(Ok(()), |file| result.write_trace(&file))?;
    if args.json {
        print_result(&serde_json::to_string(&result)?);
        return Ok(());
    }
    let frames = format!("after {} to warm up, {} in flight", args.warm_up, args.in_flight);
    let mut notes = BTreeMap::from([("frames", frames)]);
    if result.non_finite > 0 {
        notes.insert("points", format!("{} not finite, never drawn", result.non_finite));
    }
    print_result(report::table(&result, &notes).trim_end());
    print_result(&report::summary(&result));
    Ok(())
}
