//! `pskel evaluate`: scores generated images of rollouts against ground truth.

use std::cell::RefCell;
use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use point_skeleton::files::Inputs;
use pskel_eval::{EvaluateError, EvaluateOptions, SCORES, evaluate};

use crate::args::frames::HoldOutArgs;
use crate::args::outputs;
use crate::progress::Progress;
use crate::{WrongUsage, print_progress, print_result};

/// Score the generated images of rollouts against ground truth
///
/// For each rollout of simulate --generator: PSNR, SSIM and sharpness by step with their drift, motion of
/// moving actors, and the IoU of vehicles in class maps and in given masks of the images. For all rollouts:
/// means with 95 % confidence intervals over rollouts, and the Fréchet distance of given features.
/// Reference images are not scored. Metrics whose ground truth or maps are missing are null.
#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// Folders of rollouts with generated images
    #[arg(required = true, value_name = "DIR")]
    rollouts: Vec<PathBuf>,
    /// Also write all numbers to this file
    #[arg(long, value_name = "F.json")]
    out: Option<PathBuf>,
    /// Vehicle masks of a segmentor, in DIR/NNNNNN/CAM.png of any size, vehicles not 0; once for each
    /// rollout, in order
    #[arg(long, value_name = "DIR")]
    masks: Vec<PathBuf>,
    /// Also compute the Fréchet distance of features, as `python -m pskel.metrics` writes them: NPY files of
    /// f32 or f64 [N, D], for generated and for ground-truth images
    #[arg(long, value_names = ["GEN.npy", "TRUE.npy"], num_args = 2)]
    features: Vec<PathBuf>,
    #[command(flatten)]
    held_out: HoldOutArgs,
}

/// Runs the command: scores the rollouts, prints and writes the report.
pub(crate) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let inputs = Inputs::new(args.rollouts.iter().chain(&args.masks).chain(&args.features));
    let [out] = outputs::open([("--out", args.out.as_deref(), SCORES)], &inputs, None)?;
    let options = EvaluateOptions {
        rollouts: args.rollouts.clone(),
        masks: args.masks.clone(),
        features: args.features.clone().try_into().ok(),
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
