//! `pskel evaluate`: scores generated images of rollouts against ground truth. [`rollout`] reads a rollout,
//! [`segmentor`] segments vehicles, [`features`] reads features of other networks, [`report`] outputs the results.

mod features;
mod picture;
mod report;
mod rollout;
mod segmentor;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::anyhow;
use clap::Args;
use point_skeleton::files::{check_output_file, write_json};
use pskel_eval::{CollectedFeatures, RandomConvNet, RolloutScores, ScoredFrame, Scores};

use self::report::{Report, ScoredRollout};
use self::rollout::GeneratedRollout;
use self::segmentor::Segmentors;
use super::progress::Progress;
use super::{WrongUsage, say, tell};

/// Score the generated images of rollouts against ground truth
///
/// For each rollout of simulate --generator: PSNR, SSIM and sharpness by step with their drift, motion of moving
/// actors, and the IoU of vehicles in class maps and in images. For all rollouts: means with 95 % confidence
/// intervals over rollouts, and Fréchet distances of images and videos by a network of fixed random convolutions (not
/// Inception, so not comparable with published FID and FVD). Reference images are not scored. Metrics whose ground
/// truth or maps are missing are null.
#[derive(Debug, Args)]
pub(super) struct EvaluateArgs {
    /// Folders of rollouts with generated images
    #[arg(required = true, value_name = "DIR")]
    rollouts: Vec<PathBuf>,
    /// Also write all numbers to this file
    #[arg(long, value_name = "F.json")]
    out: Option<PathBuf>,
    /// Vehicle masks of a segmentor, in DIR/NNNNNN/CAM.png of any size, vehicles not 0; once for each rollout, in
    /// order
    #[arg(long, value_name = "DIR")]
    masks: Vec<PathBuf>,
    /// Train the patch classifier on ground-truth images and class maps of this rollout, may be repeated [default: on
    /// the other half of the steps]
    #[arg(long, value_name = "DIR")]
    classifier_from: Vec<PathBuf>,
    /// Also compute a Fréchet distance of features of another network: NPY files of f32 or f64 [N, D], for generated
    /// and for ground-truth images
    #[arg(long, value_names = ["GEN.npy", "TRUE.npy"], num_args = 2)]
    features: Vec<PathBuf>,
    /// Seed of the random convolutions and of the patch classifier
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// Runs the command: reads rollouts, scores them, prints and writes the report.
pub(super) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let (rollouts, masks) = (args.rollouts.len(), args.masks.len());
    if masks != 0 && masks != rollouts {
        let message = format!("expected --masks once for each of {rollouts} rollouts, found {masks}");
        return Err(WrongUsage(message).into());
    }
    if let Some(out) = &args.out {
        check_output_file(out, args.features.iter().map(PathBuf::as_path))?;
    }
    let features = match args.features.as_slice() {
        [generated, truth] => Some(features::distance(generated, truth)?),
        _ => None,
    };
    let rollouts = GeneratedRollout::open_all(&args.rollouts)?;
    let segmentors = Segmentors::new(&rollouts, &args.masks, &args.classifier_from, args.seed)?;
    let net = RandomConvNet::new(args.seed);
    let steps = rollouts.iter().map(|rollout| rollout.steps.len()).sum();
    let mut progress = Progress::new(steps);
    let mut collected = CollectedFeatures::default();
    let mut scored = Vec::new();
    for (number, rollout) in rollouts.iter().enumerate() {
        let (scores, features) = score(rollout, number, &net, &segmentors, &mut progress)?;
        collected.append(&features);
        scored.push(ScoredRollout::new(rollout, scores));
    }
    drop(progress);
    let report = Report::new(scored, &collected, &segmentors, features, args.seed)?;
    args.out.as_ref().map_or(Ok(()), |out| write_json(out, &report))?;
    say(report.table().trim_end());
    for note in report.notes() {
        tell(&format!("note: {note}"));
    }
    let seconds = start.elapsed().as_secs_f64();
    let out = args.out.as_ref().map_or(String::new(), |out| format!(": {}", out.display()));
    say(&format!("{} in {seconds:.2} s{out}", report.summary()));
    Ok(())
}

fn score(
    rollout: &GeneratedRollout,
    number: usize,
    net: &RandomConvNet,
    segmentors: &Segmentors,
    progress: &mut Progress,
) -> anyhow::Result<(Scores, CollectedFeatures)> {
    let mut scores = RolloutScores::new(net.clone());
    for (index, step) in rollout.steps.iter().enumerate() {
        let frame = rollout.read(step)?;
        let masks = segmentors.masks(rollout, number, index, &frame)?;
        let segmented: Vec<_> = masks.iter().map(segmentor::Masks::borrowed).collect();
        let scored = ScoredFrame {
            t_s: step.t_s,
            generated: &frame.generated,
            truth: frame.truth.as_deref(),
            class: frame.class.as_deref(),
            moving: frame.moving.as_deref(),
            segmented: &segmented,
        };
        scores.push(&scored).map_err(|error| anyhow!("{error}: {}", step.folder.display()))?;
        progress.step(&format!("{}, step {}", rollout.folder.display(), step.name));
    }
    Ok(scores.finish())
}
