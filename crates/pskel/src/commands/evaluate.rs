//! `pskel evaluate`: scores generated images of rollouts against ground truth.

use std::cell::RefCell;
use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use point_skeleton::files::Inputs;
use pskel_eval::{EvaluateError, EvaluateOptions, MaskRule, SCORES, evaluate};

use crate::args::frames::HoldOutArgs;
use crate::args::names::names;
use crate::args::outputs;
use crate::progress::Progress;
use crate::{WrongUsage, print_progress, print_result};

/// Score the generated images of rollouts against ground truth
///
/// For each rollout of simulate --generator: PSNR, SSIM and sharpness by step with their drift, motion of
/// moving actors, and the IoU of vehicles in class maps and in given masks of the images. For all rollouts:
/// means with 95 % confidence intervals over rollouts. Reference images are not scored. Metrics whose ground
/// truth or maps are missing are null. FID and FVD: `pskel protocol` and `python -m pskel.metrics`.
#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// Folders of rollouts with generated images
    #[arg(required = true, value_name = "DIR")]
    rollouts: Vec<PathBuf>,
    /// Also write all numbers to this file
    #[arg(long, value_name = "F.json")]
    out: Option<PathBuf>,
    /// Vehicle masks, as `python -m pskel.metrics.masks` writes them: DIR/NNNNNN/CAM.png of any size,
    /// vehicles not 0; once for each rollout, in order
    #[arg(long, value_name = "DIR")]
    masks: Vec<PathBuf>,
    /// How the masks of vehicles are computed from class maps
    #[arg(long, requires = "masks", default_value_t, value_parser = names::<MaskRule>())]
    mask_rule: MaskRule,
    #[command(flatten)]
    held_out: HoldOutArgs,
}

/// Runs the command: scores the rollouts, prints and writes the report.
pub(crate) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let inputs = Inputs::new(args.rollouts.iter().chain(&args.masks));
    let [out] = outputs::open([("--out", args.out.as_deref(), SCORES)], &inputs, None)?;
    let options = EvaluateOptions {
        rollouts: args.rollouts.clone(),
        masks: args.masks.clone(),
        mask_rule: args.mask_rule,
        hold_out: args.held_out.hold_out.map(usize::from),
        root: None,
    };
    let progress = RefCell::new(None);
    let mut on_start = |steps| *progress.borrow_mut() = Some(Progress::new(steps));
    let mut on_step = |name: &str| progress.borrow_mut().iter_mut().for_each(|progress| progress.step(name));
    let report = evaluate(&options, &mut on_start, &mut on_step).map_err(|error| match &error {
        EvaluateError::Masks { .. } => WrongUsage(error.to_string()).into(),
        _ => anyhow::Error::new(error),
    })?;
    drop(progress);
    // Printed before the file is written, which may fail: the scores took long.
    print_result(report.table().trim_end());
    for note in report.notes() {
        print_progress(&format!("note: {note}"));
    }
    out.as_ref().map_or(Ok(()), |out| out.write_json(&report))?;
    let seconds = start.elapsed().as_secs_f64();
    let out = out.map_or(String::new(), |out| format!(": {}", out.path().display()));
    print_result(&format!("{} in {seconds:.2} s{out}", report.summary()));
    Ok(())
}
