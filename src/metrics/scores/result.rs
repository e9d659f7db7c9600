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

/// A number of a rollout, where it has one.
type Number = fn(&Scores) -> Option<f64>;

/// [`Scores::numbers`], without segmentors.
const NUMBERS: [(&str, Number); 14] = [
    ("psnr_db", |s| s.psnr_db.mean),
    ("psnr_db_slope_per_s", |s| s.psnr_db.drift.map(|d| d.slope_per_s)),
    ("psnr_db_last_minus_first_third", |s| s.psnr_db.drift.map(|d| d.last_minus_first_third)),
    ("ssim", |s| s.ssim.mean),
    ("ssim_slope_per_s", |s| s.ssim.drift.map(|d| d.slope_per_s)),
    ("ssim_last_minus_first_third", |s| s.ssim.drift.map(|d| d.last_minus_first_third)),
    ("sharpness", |s| s.sharpness.mean),
    ("sharpness_truth", |s| s.sharpness_truth.mean),
    ("sharpness_ratio", |s| s.sharpness_ratio.mean),
    ("sharpness_ratio_slope_per_s", |s| s.sharpness_ratio.drift.map(|d| d.slope_per_s)),
    ("sharpness_ratio_last_minus_first_third", |s| s.sharpness_ratio.drift.map(|d| d.last_minus_first_third)),
    ("motion_slope", |s| s.motion.and_then(|m| m.slope)),
    ("flicker", |s| s.motion.and_then(|m| m.flicker)),
    ("static_generated_rms", |s| s.motion.and_then(|m| m.static_generated_rms)),
];

impl Scores {
    /// What means over rollouts are taken of, by name; `iou_NAME`, `iou_NAME_truth` and `iou_NAME_ratio` of each segmentor.
    pub fn numbers(&self) -> BTreeMap<String, Option<f64>> {
        let own = NUMBERS.iter().map(|(name, of)| ((*name).to_owned(), of(self)));
        let segmented = self.iou.iter().flat_map(|(name, iou)| {
            [
                (format!("iou_{name}"), iou.generated),
                (format!("iou_{name}_truth"), iou.truth),
                (format!("iou_{name}_ratio"), iou.ratio),
            ]
        });
        own.chain(segmented).collect()
    }
}
