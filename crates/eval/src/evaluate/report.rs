//! Report: JSON, a table, a summary line.

use std::collections::BTreeMap;
use std::path::Path;

use crate::table::{aligned, interval, number};
use crate::{
    CollectedFeatures, Distance, Distances, FrechetError, MeanInterval, Scores, mean_interval,
    paired_difference,
};
use point_skeleton::files::{FileKind, FileName};
use serde::Serialize;

use super::rollout::GeneratedRollout;
use super::segmentor::{GIVEN, PATCHES, PatchesAbout, Segmentors};

/// All results.
#[derive(Debug, Serialize)]
pub struct Report {
    seed: u64,
    /// Means over rollouts, by metric name; `null` if no rollout has the metric.
    mean: BTreeMap<String, Option<MeanInterval>>,
    /// Distances over the images and videos of all rollouts.
    distances: Distances,
    /// Feature distance by another network.
    given_features: Option<Distance>,
    patch_classifier: PatchesAbout,
    notes: Vec<String>,
    rollouts: Vec<ScoredRollout>,
}

/// A rollout and its scores.
#[derive(Debug, Serialize)]
pub(super) struct ScoredRollout {
    folder: String,
    cameras: Vec<FileName>,
    /// Sizes of generated images, HxW, by camera.
    sizes: Vec<String>,
    /// Number of steps with references, which are not scored.
    references: usize,
    scores: Scores,
}

const HEADER: [&str; 13] = [
    "rollout",
    "steps",
    "PSNR (dB)",
    "slope (dB/s)",
    "SSIM",
    "slope (1/s)",
    "sharpness ratio",
    "seams",
    "motion",
    "flicker",
    "IoU patches",
    "IoU ratio",
    "IoU masks",
];

impl ScoredRollout {
    pub(super) fn new(rollout: &GeneratedRollout, root: Option<&Path>, scores: Scores) -> Self {
        let below = root.and_then(|root| rollout.folder.strip_prefix(root).ok());
        Self {
            folder: below.unwrap_or(&rollout.folder).display().to_string(),
            cameras: rollout.cameras.clone(),
            sizes: rollout.sizes.iter().map(ToString::to_string).collect(),
            references: rollout.references,
            scores,
        }
    }

    /// Returns notes on missing metrics, with reasons.
    fn notes(&self) -> Vec<String> {
        let Scores { steps, steps_with_truth, equal_images, motion, iou, .. } = &self.scores;
        let mut notes = Vec::new();
        let mut note = |text: String| notes.push(format!("{text}: {}", self.folder));
        if steps_with_truth < steps {
            note(format!("the truth of {} of {steps} steps is not known", steps - steps_with_truth));
        }
        if *equal_images > 0 {
            note(format!("{equal_images} images equal the truth and have no PSNR"));
        }
        if motion.is_none() {
            note("no motion: two steps in a row need truth and instance maps as PNG".to_owned());
        }
        if iou.values().any(|iou| iou.generated.is_none()) || iou.is_empty() {
            note("no IoU: it needs class maps as PNG that show vehicles, and a segmentor".to_owned());
        }
        notes
    }

    fn row(&self) -> Vec<String> {
        let Scores { psnr_db, ssim, sharpness_ratio, seams, motion, iou, steps, .. } = &self.scores;
        let patches = iou.get(PATCHES);
        let values = [
            (psnr_db.mean, 2),
            (psnr_db.drift.map(|d| d.slope_per_s), 3),
            (ssim.mean, 3),
            (ssim.drift.map(|d| d.slope_per_s), 4),
            (sharpness_ratio.mean, 3),
            (seams.get(&4).copied().flatten(), 3),
            (motion.and_then(|m| m.slope), 3),
            (motion.and_then(|m| m.flicker), 3),
            (patches.and_then(|iou| iou.generated), 3),
            (patches.and_then(|iou| iou.ratio), 3),
            (iou.get(GIVEN).and_then(|iou| iou.generated), 3),
        ];
        let cells = values.into_iter().map(|(value, digits)| number(value, digits));
        [self.folder.clone(), steps.to_string()].into_iter().chain(cells).collect()
    }
}

/// Files of reports.
pub const SCORES: FileKind =
    FileKind { name: "scores of pskel evaluate", begin: b"{\n  \"seed\": ", marks: &[b"\n  \"mean\": {"] };

impl Report {
    pub(super) fn new(
        rollouts: Vec<ScoredRollout>,
        features: &CollectedFeatures,
        segmentors: &Segmentors,
        given_features: Option<Distance>,
        seed: u64,
    ) -> Result<Self, FrechetError> {
        let distances = features.distances()?;
        let mut notes: Vec<String> = rollouts.iter().flat_map(ScoredRollout::notes).collect();
        if let Some(missing) = &segmentors.about.missing {
            notes.push(format!("no patch classifier: {missing}"));
        }
        if distances.images.is_none() {
            notes.push("no distance of images: it needs 2 generated and 2 true ones".to_owned());
        }
        if distances.videos.is_none() {
            notes.push(format!(
                "no distance of videos: it needs 2 generated and 2 true windows of {} steps",
                distances.window_frames
            ));
        }
        Ok(Self {
            seed,
            mean: means(&rollouts),
            distances,
            given_features,
            patch_classifier: segmentors.about.clone(),
            notes,
            rollouts,
        })
    }

    /// Returns notes on missing metrics, with reasons.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the mean of a metric over rollouts; `None` if no rollout has it.
    pub fn mean(&self, metric: &str) -> Option<MeanInterval> {
        self.mean.get(metric).copied().flatten()
    }

    /// Returns the Fréchet distances over all rollouts.
    pub fn distances(&self) -> &Distances {
        &self.distances
    }

    /// Returns the number of scored steps of all rollouts.
    pub fn steps(&self) -> usize {
        self.rollouts.iter().map(|rollout| rollout.scores.steps).sum()
    }

    /// Formats a row per rollout, and one with their means and intervals.
    pub fn table(&self) -> String {
        let mut cells = vec![HEADER.map(str::to_owned).to_vec()];
        cells.extend(self.rollouts.iter().map(ScoredRollout::row));
        if self.rollouts.len() > 1 {
            let names = [
                ("psnr_db", 2),
                ("psnr_db_slope_per_s", 3),
                ("ssim", 3),
                ("ssim_slope_per_s", 4),
                ("sharpness_ratio", 3),
                ("seam_ratio_4", 3),
                ("motion_slope", 3),
                ("flicker", 3),
                ("iou_patch_classifier", 3),
                ("iou_patch_classifier_ratio", 3),
                ("iou_masks", 3),
            ];
            let cell = |(name, digits): (&str, usize)| interval(self.mean(name), digits);
            let first = ["mean, 95 %".to_owned(), self.steps().to_string()];
            cells.push(first.into_iter().chain(names.map(cell)).collect());
        }
        aligned(&cells)
    }

    /// Formats a one-line summary, without duration and path.
    pub fn summary(&self) -> String {
        let images: usize = self.rollouts.iter().map(|r| r.scores.steps * r.scores.cameras).sum();
        let count = self.rollouts.len();
        let distance = |name: &str, distance: Option<Distance>| {
            distance.map_or_else(String::new, |d| format!(", {name} {:.3}", d.distance))
        };
        format!(
            "scored {images} images of {count} rollout{}: PSNR {} dB{}{}{}",
            if count == 1 { "" } else { "s" },
            interval(self.mean("psnr_db"), 2),
            distance("Fréchet distance of images", self.distances.images),
            distance("of videos", self.distances.videos),
            distance("of given features", self.given_features),
        )
    }
}

fn means(rollouts: &[ScoredRollout]) -> BTreeMap<String, Option<MeanInterval>> {
    let numbers: Vec<_> = rollouts.iter().map(|rollout| rollout.scores.numbers()).collect();
    let all = |name: &str| -> Vec<Option<f64>> {
        numbers.iter().map(|numbers| numbers.get(name).copied().flatten()).collect()
    };
    let known = |values: &[Option<f64>]| mean_interval(&values.iter().flatten().copied().collect::<Vec<_>>());
    let names = numbers.iter().flat_map(BTreeMap::keys);
    let mut means: BTreeMap<_, _> = names.map(|name| (name.clone(), known(&all(name)))).collect();
    for name in rollouts.iter().flat_map(|rollout| rollout.scores.iou.keys()) {
        let difference = paired_difference(&all(&format!("iou_{name}")), &all(&format!("iou_{name}_truth")));
        means.insert(format!("iou_{name}_minus_truth"), difference);
    }
    means
}
