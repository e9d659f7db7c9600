//! [`RolloutScores`] scores the steps of a rollout. [`frame`] defines and validates its input, [`result`] its
//! output.

mod frame;
mod result;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use image::RgbImage;
use rayon::prelude::*;

pub use self::frame::{ScoreError, ScoredFrame};
pub use self::result::{Scores, Series, VehicleIou};
use super::{MaskRule, Overlap, SeamSums, psnr_db, vehicle_mask};
use crate::images::motion::{MotionSums, MovingFrame};
use crate::images::sharpness::sharpness;
use crate::images::ssim::ssim;

/// Sides of the blocks whose seams are measured, pixels: the latents and tokens of the included network.
const SEAM_SIDES: [usize; 2] = [4, 8];

/// Scores a rollout of generated images step by step, in memory.
#[derive(Clone, Debug, Default)]
pub struct RolloutScores {
    mask_rule: MaskRule,
    /// Width and height per camera.
    sizes: Option<Vec<(u32, u32)>>,
    t_s: Vec<f64>,
    series: BTreeMap<Metric, Vec<Option<f64>>>,
    steps_with_truth: usize,
    equal_images: usize,
    /// Of generated images, by the side of the blocks.
    seams: [SeamSums; SEAM_SIDES.len()],
    motion: MotionSums,
    before: Option<PreviousStep>,
    /// Overlap of masks and class maps, and its IoU by step; `None` without masks.
    masked: Option<(Overlap, Vec<Option<f64>>)>,
}

/// Metrics with one value per step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Metric {
    Psnr,
    Ssim,
    Sharpness,
    SharpnessTruth,
    SharpnessRatio,
}

/// The previous step, as needed for motion.
#[derive(Clone, Debug)]
struct PreviousStep {
    generated: Vec<RgbImage>,
    truth: Vec<RgbImage>,
    moving: Vec<Vec<bool>>,
}

/// Scores of one camera's images at a step.
struct CameraScores {
    psnr_db: Option<f64>,
    ssim: Option<f64>,
    sharpness: Option<f64>,
    sharpness_truth: Option<f64>,
    seams: [SeamSums; SEAM_SIDES.len()],
}

impl CameraScores {
    fn of(image: &RgbImage, truth: Option<&RgbImage>) -> Self {
        Self {
            psnr_db: truth.and_then(|truth| psnr_db(image, truth)),
            ssim: truth.and_then(|truth| ssim(image, truth)),
            sharpness: sharpness(image),
            sharpness_truth: truth.and_then(sharpness),
            seams: SEAM_SIDES.map(|side| SeamSums::of(image, side)),
        }
    }
}

impl RolloutScores {
    /// Starts with no step. `mask_rule`: how the masks of vehicles are computed from class maps.
    pub fn new(mask_rule: MaskRule) -> Self {
        Self { mask_rule, ..Self::default() }
    }

    /// Adds the next step. The value of a step is the mean over its cameras.
    ///
    /// # Errors
    /// Returns an error if the number of cameras changes, or if images, maps or masks have other sizes; the
    /// step is then not added.
    pub fn push(&mut self, frame: &ScoredFrame<'_>) -> Result<(), ScoreError> {
        let sizes: Vec<(u32, u32)> = frame.generated.iter().map(RgbImage::dimensions).collect();
        frame.check(self.sizes.as_ref().unwrap_or(&sizes))?;
        self.sizes = Some(sizes);
        self.add_masks(frame);
        self.t_s.push(frame.t_s);
        self.steps_with_truth += usize::from(frame.truth.is_some());
        let cameras: Vec<CameraScores> = (0..frame.generated.len())
            .into_par_iter()
            .map(|camera| CameraScores::of(&frame.generated[camera], frame.truth.map(|truth| &truth[camera])))
            .collect();
        self.add_numbers(&cameras);
        self.add_motion(frame);
        Ok(())
    }

    fn add_numbers(&mut self, cameras: &[CameraScores]) {
        let mean = |of: fn(&CameraScores) -> Option<f64>| {
            mean(cameras.iter().filter_map(of).filter(|value| value.is_finite()))
        };
        let equal = |scores: &&CameraScores| scores.psnr_db == Some(f64::INFINITY);
        self.equal_images += cameras.iter().filter(equal).count();
        for scores in cameras {
            self.seams.iter_mut().zip(&scores.seams).for_each(|(all, seams)| all.join(seams));
        }
        let (here, truth) = (mean(|c| c.sharpness), mean(|c| c.sharpness_truth));
        let ratio = here.zip(truth).filter(|(_, truth)| *truth > 0.0).map(|(here, truth)| here / truth);
        let numbers = [
            (Metric::Psnr, mean(|c| c.psnr_db)),
            (Metric::Ssim, mean(|c| c.ssim)),
            (Metric::Sharpness, here),
            (Metric::SharpnessTruth, truth),
            (Metric::SharpnessRatio, ratio),
        ];
        for (metric, value) in numbers {
            self.series.entry(metric).or_default().push(value);
        }
    }

    /// Compares with the previous step, if ground truth and moving pixels of both are known.
    fn add_motion(&mut self, frame: &ScoredFrame<'_>) {
        let known = frame.truth.zip(frame.moving);
        if let Some(((truth, moving), before)) = known.zip(self.before.as_ref()) {
            let of_camera = |camera: usize| {
                let mut sums = MotionSums::default();
                let earlier = MovingFrame {
                    generated: &before.generated[camera],
                    truth: &before.truth[camera],
                    moving: &before.moving[camera],
                };
                let now = MovingFrame {
                    generated: &frame.generated[camera],
                    truth: &truth[camera],
                    moving: &moving[camera],
                };
                sums.add(&earlier, &now);
                sums
            };
            let all: Vec<MotionSums> = (0..truth.len()).into_par_iter().map(of_camera).collect();
            all.iter().for_each(|sums| self.motion.join(sums));
        }
        self.before = known.map(|(truth, moving)| PreviousStep {
            generated: frame.generated.to_vec(),
            truth: truth.to_vec(),
            moving: moving.to_vec(),
        });
    }

    /// Compares masks with the class maps.
    fn add_masks(&mut self, frame: &ScoredFrame<'_>) {
        let Some(masks) = frame.masks else { return };
        let mut step = Overlap::default();
        let images = frame.class.unwrap_or_default().iter().zip(frame.generated).zip(masks);
        for ((class, image), mask) in images {
            step.add_masks(&vehicle_mask(class, image.width() as usize, self.mask_rule), mask);
        }
        let (all, steps) = self.masked.get_or_insert_default();
        steps.resize(self.t_s.len(), None); // pads the steps without masks
        all.join(&step);
        steps.push(step.iou());
    }

    /// Returns the scores.
    pub fn finish(mut self) -> Scores {
        let steps = self.t_s.len();
        let t_s = std::mem::take(&mut self.t_s);
        let mut series = |metric: Metric| Series::new(&t_s, self.series.remove(&metric).unwrap_or_default());
        let iou = |(all, mut of_steps): (Overlap, Vec<Option<f64>>)| {
            of_steps.resize(steps, None);
            ("masks", VehicleIou { generated: all.iou(), steps: Series::new(&t_s, of_steps) })
        };
        Scores {
            steps,
            cameras: self.sizes.map_or(0, |sizes| sizes.len()),
            steps_with_truth: self.steps_with_truth,
            equal_images: self.equal_images,
            psnr_db: series(Metric::Psnr),
            ssim: series(Metric::Ssim),
            sharpness: series(Metric::Sharpness),
            sharpness_truth: series(Metric::SharpnessTruth),
            sharpness_ratio: series(Metric::SharpnessRatio),
            seams: SEAM_SIDES.into_iter().zip(self.seams.map(|seams| seams.ratio())).collect(),
            motion: self.motion.finish(),
            iou: self.masked.map(iou).into_iter().collect(),
            t_s: t_s.clone(),
        }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}
