//! Report: JSON, a table, a summary line.

use std::collections::BTreeMap;
use std::path::Path;

use crate::table::{aligned, interval, number};
use crate::{MeanInterval, Scores, mean_interval};
use point_skeleton::files::{FileKind, FileName};
use serde::Serialize;

use super::rollout::GeneratedRollout;

/// All results.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Means over rollouts, by metric name; `null` if no rollout has the metric.
    mean: BTreeMap<String, Option<MeanInterval>>,
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

/// Columns of the table: name, metric, digits.
const COLUMNS: [(&str, &str, usize); 9] = [
    ("PSNR (dB)", "psnr_db", 2),
    ("slope (dB/s)", "psnr_db_slope_per_s", 3),
    ("SSIM", "ssim", 3),
    ("slope (1/s)", "ssim_slope_per_s", 4),
    ("sharpness ratio", "sharpness_ratio", 3),
    ("seams", "seam_ratio_4", 3),
    ("motion", "motion_slope", 3),
    ("flicker", "flicker", 3),
    ("IoU masks", "iou_masks", 3),
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
            note(format!("{} of {steps} steps have no ground truth", steps - steps_with_truth));
        }
        if *equal_images > 0 {
            note(format!("{equal_images} images equal the ground truth and have no PSNR"));
        }
        if motion.is_none() {
            note(
                "no motion: requires ground truth and instance maps of two consecutive steps as PNG"
                    .to_owned(),
            );
        }
        if iou.values().any(|iou| iou.generated.is_none()) {
            note("no IoU: it needs class maps as PNG, and vehicles in these or in the masks".to_owned());
        }
        notes
    }

    fn row(&self) -> Vec<String> {
        let numbers = self.scores.numbers();
        let value = |metric: &str| numbers.get(metric).copied().flatten();
        let cells = COLUMNS.map(|(_, metric, digits)| number(value(metric), digits));
        [self.folder.clone(), self.scores.steps.to_string()].into_iter().chain(cells).collect()
    }
}

/// Files of reports.
pub const SCORES: FileKind =
    FileKind { name: "scores of pskel evaluate", begin: b"{\n  \"mean\": {\n    \"flicker\": ", marks: &[] };

impl Report {
    pub(super) fn new(rollouts: Vec<ScoredRollout>) -> Self {
        let notes = rollouts.iter().flat_map(ScoredRollout::notes).collect();
        Self { mean: means(&rollouts), notes, rollouts }
    }

    /// Returns notes on missing metrics, with reasons.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the mean of a metric over rollouts; `None` if no rollout has it.
    pub fn mean(&self, metric: &str) -> Option<MeanInterval> {
        self.mean.get(metric).copied().flatten()
    }

    /// Returns the number of scored steps of all rollouts.
    pub fn steps(&self) -> usize {
        self.rollouts.iter().map(|rollout| rollout.scores.steps).sum()
    }

    /// Returns whether every scored step has ground truth.
    pub(crate) fn has_truth(&self) -> bool {
        self.rollouts.iter().all(|rollout| rollout.scores.steps_with_truth == rollout.scores.steps)
    }

    /// Formats a row per rollout, and one with their means and intervals.
    pub fn table(&self) -> String {
        let header = ["rollout", "steps"].into_iter().chain(COLUMNS.map(|(name, ..)| name));
        let mut cells: Vec<Vec<String>> = vec![header.map(str::to_owned).collect()];
        cells.extend(self.rollouts.iter().map(ScoredRollout::row));
        if self.rollouts.len() > 1 {
            let means = COLUMNS.map(|(_, metric, digits)| interval(self.mean(metric), digits));
            let first = ["mean, 95 %".to_owned(), self.steps().to_string()];
            cells.push(first.into_iter().chain(means).collect());
        }
        aligned(&cells)
    }

    /// Formats a one-line summary, without duration and path.
    pub fn summary(&self) -> String {
        let images: usize = self.rollouts.iter().map(|r| r.scores.steps * r.scores.cameras).sum();
        let count = self.rollouts.len();
        format!(
            "scored {images} images of {count} rollout{}: PSNR {} dB",
            if count == 1 { "" } else { "s" },
            interval(self.mean("psnr_db"), 2),
        )
    }
}

fn means(rollouts: &[ScoredRollout]) -> BTreeMap<String, Option<MeanInterval>> {
    let numbers: Vec<_> = rollouts.iter().map(|rollout| rollout.scores.numbers()).collect();
    let mean = |name: &String| {
        let values = numbers.iter().filter_map(|numbers| numbers.get(name).copied().flatten());
        (name.clone(), mean_interval(&values.collect::<Vec<_>>()))
    };
    numbers.iter().flat_map(BTreeMap::keys).map(mean).collect()
}
