use std::collections::BTreeMap;

use serde::Serialize;

use super::super::{Drift, Motion};

/// Series of a metric over a rollout.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Series {
    /// Mean over the steps that have a value.
    pub mean: Option<f64>,
    /// Change over the rollout.
    pub drift: Option<Drift>,
    /// Value per step, at the times [`Scores::t_s`].
    pub steps: Vec<Option<f64>>,
}

impl Series {
    pub(super) fn new(t_s: &[f64], steps: Vec<Option<f64>>) -> Self {
        Self { mean: super::mean(steps.iter().flatten().copied()), drift: Drift::of(t_s, &steps), steps }
    }
}

/// Intersection over union of vehicles in class maps and in the masks of a segmentation model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VehicleIou {
    /// IoU over all pixels of a rollout; `None` without class maps or vehicles.
    pub generated: Option<f64>,
    /// IoU per step.
    pub steps: Series,
}

/// Scores of a rollout.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Number of steps scored.
    pub steps: usize,
    /// Number of images per step.
    pub cameras: usize,
    /// Number of steps with ground truth; metrics that need it are `None` at the others.
    pub steps_with_truth: usize,
    /// Number of images that equal the ground truth. Their PSNR is infinite, so its means exclude them.
    pub equal_images: usize,
    /// PSNR, see [`psnr_db`](crate::psnr_db); mean over cameras, dB.
    pub psnr_db: Series,
    /// SSIM, see [`ssim`](crate::images::ssim::ssim); mean over cameras.
    pub ssim: Series,
    /// Sharpness of generated images, see [`sharpness`](crate::images::sharpness::sharpness); mean over
    /// cameras, levels per pixel.
    pub sharpness: Series,
    /// Sharpness of ground-truth images.
    pub sharpness_truth: Series,
    /// Sharpness of generated images divided by the sharpness of ground-truth images, per step.
    pub sharpness_ratio: Series,
    /// Differences between pixels across the borders of blocks, relative to those elsewhere, by the side of
    /// the blocks; see [`SeamSums::ratio`](crate::SeamSums::ratio).
    pub seams: BTreeMap<usize, Option<f64>>,
    /// Motion of actors; `None` without two consecutive steps with ground truth and moving pixels.
    pub motion: Option<Motion>,
    /// Vehicle IoU, `masks`; empty without masks.
    pub iou: BTreeMap<&'static str, VehicleIou>,
    /// Times of the steps, seconds.
    pub t_s: Vec<f64>,
}

/// Function that extracts a number from the scores, if present.
type Number = fn(&Scores) -> Option<f64>;

/// Names and functions of [`Scores::numbers`], without the IoU.
const NUMBERS: [(&str, Number); 16] = [
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
    ("seam_ratio_4", |s| s.seams.get(&4).copied().flatten()),
    ("seam_ratio_8", |s| s.seams.get(&8).copied().flatten()),
    ("motion_slope", |s| s.motion.and_then(|m| m.slope)),
    ("flicker", |s| s.motion.and_then(|m| m.flicker)),
    ("static_generated_rms", |s| s.motion.and_then(|m| m.static_generated_rms)),
];

impl Scores {
    /// Returns the numbers that are averaged over rollouts, by name; `iou_masks` only with masks.
    pub fn numbers(&self) -> BTreeMap<String, Option<f64>> {
        let own = NUMBERS.iter().map(|(name, of)| ((*name).to_owned(), of(self)));
        own.chain(self.iou.iter().map(|(name, iou)| (format!("iou_{name}"), iou.generated))).collect()
    }
}
