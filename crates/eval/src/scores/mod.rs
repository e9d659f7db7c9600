//! [`RolloutScores`] scores the steps of a rollout. [`frame`] defines and validates its input, [`result`] its
//! output, and [`distances`] the distances over many rollouts.

mod distances;
mod frame;
mod result;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use image::RgbImage;
use rayon::prelude::*;

pub use self::distances::{CollectedFeatures, Distance, Distances};
pub use self::frame::{ScoreError, ScoredFrame, SegmentationMasks};
pub use self::result::{Scores, Series, VehicleIou};
use super::{Overlap, RandomConvNet, SeamSums, psnr_db, vehicle_mask};
use crate::images::motion::{MotionSums, MovingFrame};
use crate::images::sharpness::sharpness;
use crate::images::ssim::ssim;

/// Sides of the blocks whose seams are measured, pixels: the latents and tokens of the included network.
const SEAM_SIDES: [usize; 2] = [4, 8];

/// Scores a rollout of generated images step by step, in memory.
#[derive(Clone, Debug)]
pub struct RolloutScores {
    net: RandomConvNet,
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
    segmented: BTreeMap<String, SegmentedSums>,
    /// Features per camera and step.
    generated: Vec<Vec<Option<Vec<f64>>>>,
    truth: Vec<Vec<Option<Vec<f64>>>>,
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

/// Sums of one segmentation model.
#[derive(Clone, Debug, Default)]
struct SegmentedSums {
    generated: Overlap,
    truth: Overlap,
    steps: Vec<Option<f64>>,
}

/// Scores of one camera's images at a step.
struct CameraScores {
    psnr_db: Option<f64>,
    ssim: Option<f64>,
    sharpness: Option<f64>,
    sharpness_truth: Option<f64>,
    seams: [SeamSums; SEAM_SIDES.len()],
    features: Option<Vec<f64>>,
    truth_features: Option<Vec<f64>>,
}

impl RolloutScores {
    /// Starts a rollout without steps; `net` computes the features.
    pub fn new(net: RandomConvNet) -> Self {
        Self {
            net,
            sizes: None,
            t_s: Vec::new(),
            series: BTreeMap::new(),
            steps_with_truth: 0,
            equal_images: 0,
            seams: Default::default(),
            motion: MotionSums::default(),
            before: None,
            segmented: BTreeMap::new(),
            generated: Vec::new(),
            truth: Vec::new(),
        }
    }

    /// Adds the next step. The value of a step is the mean over its cameras.
    ///
    /// # Errors
    /// Returns an error if the number of cameras changes, or if images, maps or masks have other sizes; the
    /// step is then not added.
    pub fn push(&mut self, frame: &ScoredFrame<'_>) -> Result<(), ScoreError> {
        let sizes: Vec<(u32, u32)> = frame.generated.iter().map(RgbImage::dimensions).collect();
        frame.check(self.sizes.as_ref().unwrap_or(&sizes))?;
        self.generated.resize(sizes.len(), Vec::new());
        self.truth.resize(sizes.len(), Vec::new());
        self.sizes = Some(sizes);
        self.add_segmented(frame);
        self.t_s.push(frame.t_s);
        self.steps_with_truth += usize::from(frame.truth.is_some());
        let cameras: Vec<CameraScores> = (0..frame.generated.len())
            .into_par_iter()
            .map(|camera| self.camera(&frame.generated[camera], frame.truth.map(|truth| &truth[camera])))
            .collect();
        self.add_numbers(&cameras);
        for (camera, scores) in cameras.into_iter().enumerate() {
            self.generated[camera].push(scores.features);
            self.truth[camera].push(scores.truth_features);
        }
        self.add_motion(frame);
        Ok(())
    }

    fn camera(&self, image: &RgbImage, truth: Option<&RgbImage>) -> CameraScores {
        CameraScores {
            psnr_db: truth.and_then(|truth| psnr_db(image, truth)),
            ssim: truth.and_then(|truth| ssim(image, truth)),
            sharpness: sharpness(image),
            sharpness_truth: truth.and_then(sharpness),
            seams: SEAM_SIDES.map(|side| SeamSums::of(image, side)),
            features: self.net.features(image),
            truth_features: truth.and_then(|truth| self.net.features(truth)),
        }
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

    /// Compares the masks of each segmentation model with the masks of the class maps.
    fn add_segmented(&mut self, frame: &ScoredFrame<'_>) {
        let labels: Option<Vec<Vec<bool>>> = frame.class.map(|class| {
            let maps = class.iter().zip(frame.generated);
            maps.map(|(map, image)| vehicle_mask(map, image.width() as usize)).collect()
        });
        for masks in frame.segmented {
            let sums = self.segmented.entry(masks.name.to_owned()).or_default();
            sums.steps.resize(self.t_s.len(), None); // pads the steps before this model's first
            let Some(labels) = &labels else { continue };
            let mut step = Overlap::default();
            labels.iter().zip(masks.generated).for_each(|(label, mask)| step.add_masks(label, mask));
            sums.generated.join(&step);
            sums.steps.push(step.iou());
            for (label, mask) in labels.iter().zip(masks.truth.unwrap_or_default()) {
                sums.truth.add_masks(label, mask);
            }
        }
    }

    /// Returns the scores, and the features for distances over many rollouts.
    pub fn finish(mut self) -> (Scores, CollectedFeatures) {
        let features = CollectedFeatures::of(&self.net, &self.generated, &self.truth);
        let steps = self.t_s.len();
        let t_s = std::mem::take(&mut self.t_s);
        let mut series = |metric: Metric| Series::new(&t_s, self.series.remove(&metric).unwrap_or_default());
        let iou = |mut sums: SegmentedSums| {
            sums.steps.resize(steps, None);
            let (generated, truth) = (sums.generated.iou(), sums.truth.iou());
            let ratio = generated.zip(truth).filter(|(_, truth)| *truth > 0.0);
            VehicleIou {
                generated,
                truth,
                ratio: ratio.map(|(generated, truth)| generated / truth),
                steps: Series::new(&t_s, sums.steps),
            }
        };
        let scores = Scores {
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
            iou: self.segmented.into_iter().map(|(name, sums)| (name, iou(sums))).collect(),
            t_s: t_s.clone(),
        };
        (scores, features)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}
