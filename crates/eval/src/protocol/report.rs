use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::json;
use pskel_sim::rollout::METRICS;
use serde::{Deserialize, Serialize};

use super::definition::{Part, Protocol};
use crate::networks::Distances;
use crate::table::{interval, markdown, number};
use crate::{
    Distance, EvaluateError, EvaluateOptions, MaskRule, MeanInterval, MetricNetworks, NetworkPaths, Report,
    evaluate, mean_interval,
};
use pskel_sim::EgoPolicy;

/// Metrics of generated images: name in [`Report::mean`], column, digits.
pub(super) const COLUMNS: [(&str, &str, usize); 6] = [
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

/// Method that generated the images.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Method {
    /// Name in tables.
    pub name: String,
    /// Number of leading frames of each clip that it was given.
    pub references: usize,
    /// What is unusual about its images, for tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remark: Option<String>,
    /// Images of another program: where they are, and counts of those that are missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub images: Option<serde_json::Value>,
}

/// How rollouts are scored.
pub struct ScoreOptions<'a> {
    /// Method that generated the images.
    pub method: Method,
    /// Folder that contains all rollouts.
    pub root: &'a Path,
    /// Networks for FID, FVD and masks of vehicles.
    pub networks: MetricNetworks,
    /// How the masks of vehicles are computed from class maps.
    pub mask_rule: MaskRule,
    /// Folder for features and masks.
    pub cache: &'a Path,
}

/// Results of a protocol.
#[derive(Debug, Serialize)]
pub struct ProtocolReport {
    protocol: &'static str,
    method: Method,
    logs: Logs,
    networks: NetworkPaths,
    mask_rule: MaskRule,
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
    fid: Option<Distance>,
    fvd: Option<Distance>,
    /// Reasons of missing distances.
    notes: Vec<String>,
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
    /// Scores the rollouts of all parts; `logs` are the names of their logs. `on_start` and `on_step` are
    /// passed to [`evaluate`] for each part.
    ///
    /// # Errors
    /// Fails as [`evaluate`], if the metrics of a rollout cannot be read, or if a network fails.
    pub fn score(
        protocol: Protocol,
        logs: &[String],
        parts: &[PartRollouts],
        options: ScoreOptions<'_>,
        on_start: &mut dyn FnMut(usize),
        on_step: &mut dyn FnMut(&str),
    ) -> Result<Self, EvaluateError> {
        let defined = protocol.logs();
        let present = logs.iter().filter(|log| defined.contains(log)).count();
        let logs = Logs { defined: defined.len(), present, other: logs.len() - present };
        let ScoreOptions { method, root, mut networks, mask_rule, cache } = options;
        let recorded = parts.iter().find(|part| part.part.ego == EgoPolicy::Replay);
        let recorded = recorded.map(|part| part.folders.as_slice());
        let mut reports = Vec::new();
        for PartRollouts { part, folders: rollouts, frames } in parts {
            let masks = write_masks(&mut networks, rollouts, (root, cache))?;
            let (rollouts, root) = (rollouts.clone(), Some(root.to_owned()));
            let evaluated =
                EvaluateOptions { rollouts, masks, mask_rule, root, ..EvaluateOptions::default() };
            let images = evaluate(&evaluated, on_start, on_step)?;
            let rollouts = evaluated.rollouts;
            let driving = Driving::read(&rollouts)?;
            // Rollouts that leave the log have its images as the reference, if they have no ground truth.
            let recorded = recorded.filter(|_| part.ego != EgoPolicy::Replay);
            let Distances { fid, fvd, notes } =
                distances(&mut networks, &rollouts, &images, recorded, cache)?;
            let (name, clips, frames) = (part.name, rollouts.len(), *frames);
            reports.push(PartReport { name, clips, frames, driving, fid, fvd, notes, images });
        }
        let networks = networks.paths().clone();
        Ok(Self { protocol: protocol.name(), method, logs, networks, mask_rule, parts: reports })
    }

    /// Returns notes on missing distances, with the names of their parts.
    pub fn notes(&self) -> impl Iterator<Item = String> {
        self.parts.iter().flat_map(|part| part.notes.iter().map(move |note| format!("{}: {note}", part.name)))
    }

    /// Formats a row per part as Markdown, with means and 95 % confidence intervals over clips.
    pub fn table(&self) -> String {
        let columns = COLUMNS.map(|(_, column, _)| column);
        let header = [self.protocol, "clips", "frames"].into_iter().chain(columns);
        let header = header.chain(["FID", "FVD", "IoU (%)", "at-fault collisions", "off-road share"]);
        let header = header.map(str::to_owned);
        let row = |part: &PartReport| -> Vec<String> {
            let PartReport { name, clips, frames, driving, fid, fvd, images, .. } = part;
            let generated = match images.steps() {
                all if all == *frames => all.to_string(),
                fewer => format!("{fewer} of {frames}"),
            };
            let means = COLUMNS.map(|(metric, _, digits)| interval(images.mean(metric), digits));
            let [fid, fvd] = [fid, fvd].map(|found| number(found.map(|found| found.distance), 2));
            let iou = images.mean("iou_masks").map(|iou| iou.scaled(100.0));
            let Driving { at_fault_collisions, off_road_share } = driving;
            let last = [at_fault_collisions.to_string(), interval(*off_road_share, 3)];
            let first = [(*name).to_owned(), clips.to_string(), generated];
            first.into_iter().chain(means).chain([fid, fvd, interval(iou, 1)]).chain(last).collect()
        };
        let cells: Vec<_> = std::iter::once(header.collect()).chain(self.parts.iter().map(row)).collect();
        let NetworkPaths { inception, i3d, segmentor, .. } = &self.networks;
        let columns = [
            ("FID needs --inception", inception.is_none()),
            ("FVD needs --i3d", i3d.is_none()),
            ("IoU needs --segmentor", segmentor.is_none()),
        ];
        let missing: Vec<&str> =
            columns.into_iter().filter(|(_, is_missing)| *is_missing).map(|(text, _)| text).collect();
        let missing = if missing.is_empty() { String::new() } else { format!(" {}.", missing.join(", ")) };
        let Method { name, remark, .. } = &self.method;
        let remark = remark.as_ref().map_or(String::new(), |remark| format!(" ({remark})"));
        let logs = self.logs.sentence();
        markdown(&cells) + &format!("\nMethod {name}{remark}. {logs}{missing}\n")
    }
}

/// Writes the masks of the vehicles in all rollouts below `root`. Returns their folders; none without a
/// segmentor.
fn write_masks(
    networks: &mut MetricNetworks,
    rollouts: &[PathBuf],
    (root, cache): (&Path, &Path),
) -> Result<Vec<PathBuf>, EvaluateError> {
    if networks.paths().segmentor.is_none() {
        return Ok(Vec::new());
    }
    let write = |rollout: &PathBuf| {
        let out = cache.join("masks").join(rollout.strip_prefix(root).unwrap_or(rollout));
        networks.masks(rollout, &out)?;
        Ok(out)
    };
    rollouts.iter().map(write).collect()
}

/// Compares the images of rollouts with their ground truth, or, off the log, with the ground truth of the
/// `recorded` rollouts, which follow the log.
fn distances(
    networks: &mut MetricNetworks,
    rollouts: &[PathBuf],
    images: &Report,
    recorded: Option<&[PathBuf]>,
    cache: &Path,
) -> Result<Distances, EvaluateError> {
    let NetworkPaths { inception, i3d, .. } = networks.paths();
    let references = if images.has_truth() { None } else { recorded };
    if references.is_none() && !images.has_truth() && (inception.is_some() || i3d.is_some()) {
        let note = "no FID and FVD: without ground truth they need the images of a part that follows the log";
        return Ok(Distances { notes: vec![note.to_owned()], ..Distances::default() });
    }
    Ok(networks.distances(rollouts, references, &cache.join("features"))?)
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
