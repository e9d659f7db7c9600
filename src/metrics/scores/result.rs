use std::collections::BTreeMap;

use serde::Serialize;

use super::super::{Drift, Motion};

/// A metric over a rollout.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Series {
    /// Mean over the steps that have a value.
    pub mean: Option<f64>,
    /// How it changes.
    pub drift: Option<Drift>,
    /// Per step, as in [`Scores::t_s`].
    pub steps: Vec<Option<f64>>,
}

impl Series {
    pub(super) fn new(t_s: &[f64], steps: Vec<Option<f64>>) -> Self {
        Self { mean: super::mean(steps.iter().flatten().copied()), drift: Drift::of(t_s, &steps), steps }
    }
}

/// Intersection over union of class maps' vehicles and those that a segmentor sees, over all pixels of a rollout.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VehicleIou {
    /// In generated images; `None` without class maps or vehicles.
    pub generated: Option<f64>,
    /// In true images: what the segmentor makes of images that are right.
    pub truth: Option<f64>,
    /// The first by the second.
    pub ratio: Option<f64>,
    /// In generated images, by step.
    pub steps: Series,
}

/// How good a rollout is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Steps that were scored.
    pub steps: usize,
    /// Images a step.
    pub cameras: usize,
    /// Steps of which the truth is known; what needs it is `None` at the others.
    pub steps_with_truth: usize,
    /// Images that equal the truth. They have no PSNR and are left out of its means.
    pub equal_images: usize,
    /// See [`psnr_db`](crate::metrics::psnr_db); mean over cameras, dB.
    pub psnr_db: Series,
    /// See [`ssim`](crate::metrics::ssim); mean over cameras.
    pub ssim: Series,
    /// See [`sharpness`](crate::metrics::sharpness), of generated images; mean over cameras, levels per pixel.
    pub sharpness: Series,
    /// The same of true images.
    pub sharpness_truth: Series,
    /// Sharpness of generated images by that of true ones, by step.
    pub sharpness_ratio: Series,
    /// How actors move; `None` without two steps in a row that have truth and moving pixels.
    pub motion: Option<Motion>,
    /// By the segmentor's name.
    pub iou: BTreeMap<String, VehicleIou>,
    /// Times of the steps, seconds.
    pub t_s: Vec<f64>,
}
