//! Vehicle segmentation: masks of an external segmentor on disk, and a patch classifier that is trained here.

use std::path::PathBuf;

use crate::{PatchClassifier, PatchOptions, PatchTrainer, SegmentationMasks, vehicle_mask};
use image::RgbImage;
use point_skeleton::conditions::reduce::nearest;
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use rayon::prelude::*;
use serde::Serialize;

use super::error::EvaluateError;
use super::picture;
use super::rollout::{Frame, GeneratedRollout, Step};

/// Names of the segmentors in the result.
pub(super) const GIVEN: &str = "masks";
pub(super) const PATCHES: &str = "patch_classifier";

/// All segmentors.
pub(super) struct Segmentors {
    /// Mask folders: one per rollout, or none.
    folders: Vec<PathBuf>,
    patches: Patches,
    pub(super) about: PatchesAbout,
}

/// Patch classifiers.
enum Patches {
    /// No classifier.
    None,
    /// Classifier trained on other rollouts.
    One(PatchClassifier),
    /// Classifiers for the first and the second half of each rollout's steps, each trained on the other
    /// halves.
    Halves([PatchClassifier; 2]),
}

/// Report on the patch classifier.
#[derive(Clone, Debug, Serialize)]
pub(super) struct PatchesAbout {
    /// Description of the method.
    what: &'static str,
    /// Training data.
    pub(super) trained_on: Vec<String>,
    /// Number of ground-truth training images, by classifier.
    images: Vec<u64>,
    /// Reason if there is no classifier.
    pub(super) missing: Option<String>,
    options: PatchOptions,
}

/// Masks of a step by one segmentor.
pub(super) struct Masks {
    name: &'static str,
    generated: Vec<Vec<bool>>,
    truth: Option<Vec<Vec<bool>>>,
}

impl Masks {
    pub(super) fn borrowed(&self) -> SegmentationMasks<'_> {
        SegmentationMasks { name: self.name, generated: &self.generated, truth: self.truth.as_deref() }
    }
}

impl Segmentors {
    /// Creates the segmentors. Trains patch classifiers on the rollouts `from`, or on the other halves of the
    /// scored ones.
    pub(super) fn new(
        rollouts: &[GeneratedRollout],
        masks: &[PathBuf],
        from: &[PathBuf],
        seed: u64,
    ) -> Result<Self, EvaluateError> {
        let options = PatchOptions { seed, ..PatchOptions::default() };
        let mut about = PatchesAbout {
            what: "a random forest on patches of colors and their place, trained on true images; no \
                segmentation network",
            trained_on: from.iter().map(|folder| folder.display().to_string()).collect(),
            images: Vec::new(),
            missing: None,
            options,
        };
        let patches = if from.is_empty() {
            about.trained_on = vec!["the other half of the steps of all rollouts".to_owned()];
            halves(rollouts, &mut about)?
        } else {
            let mut trainer = PatchTrainer::new(options);
            for rollout in GeneratedRollout::open_all(from)? {
                learn(&mut trainer, &rollout, &rollout.steps)?;
            }
            about.images = vec![trainer.images()];
            Patches::One(trainer.train().map_err(EvaluateError::in_files(about.trained_on.join(", ")))?)
        };
        Ok(Self { folders: masks.to_vec(), patches, about })
    }

    /// Returns the masks of step `index` of rollout `number` by each segmentor.
    pub(super) fn masks(
        &self,
        rollout: &GeneratedRollout,
        number: usize,
        index: usize,
        frame: &Frame,
    ) -> Result<Vec<Masks>, EvaluateError> {
        let mut all = Vec::new();
        if let Some(folder) = self.folders.get(number) {
            let folder = folder.join(&rollout.steps[index].name);
            let read = |(camera, to): (&FileName, _)| -> Result<Vec<bool>, FileError> {
                let (mask, from) = picture::mask(&folder.join(format!("{camera}.png")))?;
                Ok(nearest(&mask, from, to))
            };
            let cameras = rollout.cameras.par_iter().zip(rollout.sizes.par_iter().copied());
            all.push(Masks {
                name: GIVEN,
                generated: cameras.map(read).collect::<Result<_, _>>()?,
                truth: None,
            });
        }
        // Without class maps there is no reference to compare with.
        if let Some(classifier) = self.classifier(rollout, index).filter(|_| frame.class.is_some()) {
            let segment = |images: &[RgbImage]| -> Result<Vec<Vec<bool>>, _> {
                images.par_iter().map(|image| classifier.segment(image)).collect()
            };
            let (generated, truth) = (segment(&frame.generated)?, frame.truth.as_deref().map(segment));
            all.push(Masks { name: PATCHES, generated, truth: truth.transpose()? });
        }
        Ok(all)
    }

    fn classifier(&self, rollout: &GeneratedRollout, index: usize) -> Option<&PatchClassifier> {
        match &self.patches {
            Patches::None => None,
            Patches::One(classifier) => Some(classifier),
            Patches::Halves(classifiers) => classifiers.get(usize::from(index >= middle(rollout))),
        }
    }
}

/// Returns the index of the first step of the second half.
fn middle(rollout: &GeneratedRollout) -> usize {
    rollout.steps.len() / 2
}

/// Trains classifiers on the halves. A half without vehicles or ground truth is not an error: there are no
/// classifiers then.
fn halves(rollouts: &[GeneratedRollout], about: &mut PatchesAbout) -> Result<Patches, FileError> {
    let mut trainers = [0, 1].map(|_| PatchTrainer::new(about.options));
    for rollout in rollouts {
        let (first, second) = rollout.steps.split_at(middle(rollout));
        // The first half's classifier is trained on the second half.
        learn(&mut trainers[0], rollout, second)?;
        learn(&mut trainers[1], rollout, first)?;
    }
    about.images = trainers.iter().map(PatchTrainer::images).collect();
    match (trainers[0].train(), trainers[1].train()) {
        (Ok(first), Ok(second)) => Ok(Patches::Halves([first, second])),
        (Err(error), _) | (_, Err(error)) => {
            about.missing = Some(error.to_string());
            Ok(Patches::None)
        }
    }
}

fn learn(trainer: &mut PatchTrainer, rollout: &GeneratedRollout, steps: &[Step]) -> Result<(), FileError> {
    for step in steps {
        let Some((truth, class)) = rollout.read_truth(step)? else { continue };
        for (image, class) in truth.iter().zip(&class) {
            trainer.add(image, &vehicle_mask(class, image.width() as usize));
        }
    }
    Ok(())
}
