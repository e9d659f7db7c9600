//! Steps of a rollout, and how it continues.

use std::path::PathBuf;

use clap::Args;
use pskel_sim::rollout::ResumeAfter;

/// Steps of a rollout, and its continuation, shared by all commands that write one.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct RolloutArgs {
    /// Number of steps
    #[arg(long, value_name = "N")]
    pub(crate) steps: Option<usize>,
    /// Start at this time, absolute microseconds [default: the log's first frame]
    #[arg(long, value_name = "T_US", allow_negative_numbers = true)]
    pub(crate) start: Option<i64>,
    /// Continue the rollout in --out after its last step, with the same log, skeleton and options; --steps,
    /// the time-outs, --mcap, --profile and the rasterizer may change
    #[arg(long)]
    pub(crate) resume: bool,
    /// Continue after this step; later ones are simulated again
    #[arg(long, value_name = "STEP")]
    pub(crate) resume_from: Option<usize>,
    /// Write the times of all steps and stages to this file
    #[arg(long, value_name = "F.json")]
    pub(crate) profile: Option<PathBuf>,
}

impl RolloutArgs {
    /// Returns the step after which to continue an earlier rollout.
    pub(crate) fn resume_after(&self) -> Option<ResumeAfter> {
        let step = self.resume_from.map(ResumeAfter::Step);
        step.or(self.resume.then_some(ResumeAfter::Last))
    }
}
