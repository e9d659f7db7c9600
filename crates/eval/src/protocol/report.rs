use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::json;
use pskel_sim::rollout::METRICS;
use serde::{Deserialize, Serialize};

use super::definition::{Part, Protocol};
use crate::table::{interval, markdown};
use crate::{EvaluateError, EvaluateOptions, MeanInterval, Report, evaluate, mean_interval};

/// Metrics of generated images: name in [`Report::mean`], column, digits.
const COLUMNS: [(&str, &str, usize); 6] = [
    ("psnr_db", "PSNR (dB)", 2),
    ("ssim", "SSIM", 3),
    ("sharpness_ratio", "sharpness ratio", 2),
    ("seam_ratio_4", "seams", 2),
    ("motion_slope", "motion", 2),
    ("flicker", "flicker", 2),
];

/// Rollouts of a part.
#[derive(Clone, Debug)]
pub struct PartRollouts {
    /// The part.
    pub part: Part,
    /// Folders of its rollouts, one per clip.
    pub folders: Vec<PathBuf>,
    /// Number of frames to generate in all clips; fewer are generated if a log ends earlier.
    pub frames: usize,
}

/// Results of a protocol.
#[derive(Debug, Serialize)]
pub struct ProtocolReport {
    protocol: &'static str,
    logs: Logs,
    parts: Vec<PartReport>,
}

/// Counts of logs.
#[derive(Clone, Copy, Debug, Serialize)]
struct Logs {
    /// Number of logs in the protocol; 0 if it is defined for any logs.
    defined: usize,
    /// Number of its logs that have results.
    present: usize,
    /// Number of logs with results that are not among its logs.
    other: usize,
}

/// Results of a part.
#[derive(Debug, Serialize)]
struct PartReport {
    name: &'static str,
    clips: usize,
    /// Number of frames to generate.
    frames: usize,
    driving: Driving,
    images: Report,
}

/// Driving of the ego in the rollouts of a part.
#[derive(Clone, Copy, Debug, Serialize)]
struct Driving {
    /// Number of collisions that are the ego's fault, in all rollouts.
    at_fault_collisions: usize,
    /// Share of the ego's footprint outside the drivable area, 0 to 1; `None` without HD maps.
    off_road_share: Option<MeanInterval>,
}

/// Content of `metrics.json` that is used here.
#[derive(Deserialize)]
struct Metrics {
    at_fault_collisions: usize,
    off_road: Option<OffRoad>,
}

#[derive(Deserialize)]
struct OffRoad {
    share: f64,
}

impl ProtocolReport {
    /// Scores the rollouts of all parts in the folder `root`; `logs` are the names of their logs. `on_start`
    /// and `on_step` are passed to [`evaluate`] for each part.
    ///
    /// # Errors
    /// Fails as [`evaluate`], and if the metrics of a rollout cannot be read.
    pub fn score(
        protocol: Protocol,
        logs: &[String],
        (root, parts): (&Path, &[PartRollouts]),
        on_start: &mut dyn FnMut(usize),
        on_step: &mut dyn FnMut(&str),
    ) -> Result<Self, EvaluateError> {
        let defined = protocol.logs();
        let present = logs.iter().filter(|log| defined.contains(log)).count();
        let logs = Logs { defined: defined.len(), present, other: logs.len() - present };
        let mut reports = Vec::new();
        for PartRollouts { part, folders: rollouts, frames } in parts {
            let (folders, root) = (rollouts.clone(), Some(root.to_owned()));
            let options = EvaluateOptions { rollouts: folders, root, ..EvaluateOptions::default() };
            let driving = Driving::read(rollouts)?;
            let images = evaluate(&options, on_start, on_step)?;
            let (name, clips, frames) = (part.name, rollouts.len(), *frames);
            reports.push(PartReport { name, clips, frames, driving, images });
        }
        Ok(Self { protocol: protocol.name(), logs, parts: reports })
    }

    /// Formats a row per part as Markdown, with means and 95 % confidence intervals over clips.
    pub fn table(&self) -> String {
        let columns = COLUMNS.map(|(_, column, _)| column);
        let header = [self.protocol, "clips", "frames"].into_iter().chain(columns);
        let header = header.chain(["at-fault collisions", "off-road share"]).map(str::to_owned);
        let row = |part: &PartReport| -> Vec<String> {
            let PartReport { name, clips, frames, driving, images } = part;
            let generated = match images.steps() {
                all if all == *frames => all.to_string(),
                fewer => format!("{fewer} of {frames}"),
            };
            let means = COLUMNS.map(|(metric, _, digits)| interval(images.mean(metric), digits));
            let Driving { at_fault_collisions, off_road_share } = driving;
            let last = [at_fault_collisions.to_string(), interval(*off_road_share, 3)];
            let first = [(*name).to_owned(), clips.to_string(), generated];
            first.into_iter().chain(means).chain(last).collect()
        };
        let cells: Vec<_> = std::iter::once(header.collect()).chain(self.parts.iter().map(row)).collect();
        markdown(&cells) + "\n" + &self.logs.sentence() + "\n"
    }
}

impl Logs {
    fn sentence(self) -> String {
        match self {
            Self { defined: 0, other: 1, .. } => "One log.".to_owned(),
            Self { defined: 0, other, .. } => format!("{other} logs."),
            Self { defined, present, other: 0 } if present == defined => {
                format!("All {defined} logs of the protocol.")
            }
            Self { defined, present, other } => {
                format!("Not comparable with the protocol: {present} of its {defined} logs, {other} others.")
            }
        }
    }
}

impl Driving {
    fn read(rollouts: &[PathBuf]) -> Result<Self, FileError> {
        let read = |folder: &PathBuf| Metrics::read(&folder.join(METRICS));
        let metrics = rollouts.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let shares: Vec<f64> = metrics
            .iter()
            .filter_map(|metrics| metrics.off_road.as_ref())
            .map(|off_road| off_road.share)
            .collect();
        Ok(Self {
            at_fault_collisions: metrics.iter().map(|metrics| metrics.at_fault_collisions).sum(),
            off_road_share: mean_interval(&shares),
        })
    }
}

impl Metrics {
    fn read(path: &Path) -> Result<Self, FileError> {
        json::read(path, "metrics of a rollout")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_states_missing_logs() {
        let sentence = |defined, present, other| Logs { defined, present, other }.sentence();
        assert_eq!([sentence(0, 0, 1), sentence(0, 0, 3)], ["One log.", "3 logs."]);
        assert_eq!(sentence(10, 10, 0), "All 10 logs of the protocol.");
        assert_eq!(sentence(10, 9, 0), "Not comparable with the protocol: 9 of its 10 logs, 0 others.");
        assert_eq!(sentence(10, 10, 1), "Not comparable with the protocol: 10 of its 10 logs, 1 others.");
    }
}
