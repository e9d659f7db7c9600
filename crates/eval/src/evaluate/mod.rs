//! Scores generated images of rollouts against ground truth. `rollout` reads a rollout, `segmentor` segments
//! vehicles, `features` reads features of other networks, `report` has the results.

mod error;
mod features;
mod picture;
mod report;
mod rollout;
mod segmentor;

pub use error::EvaluateError;
pub use report::{Report, SCORES};

use std::path::PathBuf;

use rayon::prelude::*;

use self::report::ScoredRollout;
use self::rollout::GeneratedRollout;
use self::segmentor::{Masks, Segmentors};
use crate::{CollectedFeatures, RandomConvNet, RolloutScores, ScoredFrame, Scores};

/// Rollouts to score, and further inputs.
#[derive(Clone, Debug, Default)]
pub struct EvaluateOptions {
    /// Folders of rollouts with generated images.
    pub rollouts: Vec<PathBuf>,
    /// Folders with vehicle masks of a segmentor, `NNNNNN/CAM.png`: one per rollout, or none.
    pub masks: Vec<PathBuf>,
    /// Rollouts whose ground-truth images and class maps train the patch classifier; the other half of the
    /// steps if empty.
    pub classifier_from: Vec<PathBuf>,
    /// Rollouts whose ground-truth images are the reference set of the Fréchet distances; `rollouts`
    /// themselves if empty.
    pub references: Vec<PathBuf>,
    /// Features of another network for generated and for ground-truth images, NPY files `[N, D]`.
    pub features: Option<[PathBuf; 2]>,
    /// Scores only every N-th frame, N - 1, 2 N - 1, ..: those that a training with the same number left out.
    pub hold_out: Option<usize>,
    /// Seed of the random convolutions and of the patch classifier.
    pub seed: u64,
    /// Folder that the report names rollouts relative to; those outside are named as given.
    pub root: Option<PathBuf>,
}

/// Scores all steps of all rollouts. `on_start` is called with the number of steps, then `on_step` with a
/// name after each one.
///
/// # Errors
/// Fails if a folder is not a rollout with generated images, if an image is missing or damaged, if the number
/// of mask folders differs from the number of rollouts, or if the patch classifier cannot be trained.
pub fn evaluate(
    options: &EvaluateOptions,
    on_start: &mut dyn FnMut(usize),
    on_step: &mut dyn FnMut(&str),
) -> Result<Report, EvaluateError> {
    let EvaluateOptions { rollouts, masks, classifier_from, references, features, hold_out, seed, root } =
        options;
    if !masks.is_empty() && masks.len() != rollouts.len() {
        return Err(EvaluateError::Masks { rollouts: rollouts.len(), found: masks.len() });
    }
    let features = features.as_ref().map(|[generated, truth]| features::distance(generated, truth));
    let features = features.transpose()?;
    let mut rollouts = GeneratedRollout::open_all(rollouts)?;
    if let Some(every) = *hold_out {
        rollouts.iter_mut().try_for_each(|rollout| rollout.hold_out(every))?;
    }
    let references = GeneratedRollout::open_all(references)?;
    let segmentors = Segmentors::new(&rollouts, masks, classifier_from, *seed)?;
    let net = RandomConvNet::new(*seed);
    on_start(rollouts.iter().chain(&references).map(|rollout| rollout.steps.len()).sum());
    let mut collected = CollectedFeatures::default();
    let mut scored = Vec::new();
    for (number, rollout) in rollouts.iter().enumerate() {
        let (scores, features) = score(rollout, number, &net, &segmentors, on_step)?;
        collected.append(&features);
        scored.push(ScoredRollout::new(rollout, root.as_deref(), scores));
    }
    if !references.is_empty() {
        let mut reference = CollectedFeatures::default();
        for rollout in &references {
            reference.append(&truth_features(rollout, &net, on_step)?);
        }
        collected = collected.with_truth_of(&reference);
    }
    Ok(Report::new(scored, &collected, &segmentors, features, *seed)?)
}

/// Returns the features of the ground-truth images of a rollout.
fn truth_features(
    rollout: &GeneratedRollout,
    net: &RandomConvNet,
    on_step: &mut dyn FnMut(&str),
) -> Result<CollectedFeatures, EvaluateError> {
    let mut features = vec![Vec::new(); rollout.cameras.len()];
    for step in &rollout.steps {
        let truth = rollout.truth(step)?;
        let of_camera = |camera: usize| truth.as_ref().and_then(|images| net.features(&images[camera]));
        let of_step: Vec<_> = (0..features.len()).into_par_iter().map(of_camera).collect();
        features.iter_mut().zip(of_step).for_each(|(all, features)| all.push(features));
        on_step(&rollout.name_of(step));
    }
    Ok(CollectedFeatures::of(net, &[], &features))
}

/// Scores all steps of a rollout.
fn score(
    rollout: &GeneratedRollout,
    number: usize,
    net: &RandomConvNet,
    segmentors: &Segmentors,
    on_step: &mut dyn FnMut(&str),
) -> Result<(Scores, CollectedFeatures), EvaluateError> {
    let mut scores = RolloutScores::new(net.clone());
    for (index, step) in rollout.steps.iter().enumerate() {
        let frame = rollout.read(step)?;
        let masks = segmentors.masks(rollout, number, index, &frame)?;
        let segmented: Vec<_> = masks.iter().map(Masks::borrowed).collect();
        let scored = ScoredFrame {
            t_s: step.t_s,
            generated: &frame.generated,
            truth: frame.truth.as_deref(),
            class: frame.class.as_deref(),
            moving: frame.moving.as_deref(),
            segmented: &segmented,
        };
        scores.push(&scored).map_err(EvaluateError::at(&step.folder))?;
        on_step(&rollout.name_of(step));
    }
    Ok(scores.finish())
}
