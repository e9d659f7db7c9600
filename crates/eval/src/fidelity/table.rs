//! Text formats of the table.

use super::differences::MaskBand;
use super::measure::{MaskRow, Row};
use super::recorded::CameraRow;
use super::sweeps::SweepRow;
use super::{FidelityReport, Rows};
use crate::table::{aligned, markdown, number};
use crate::{FilledError, MaskDifference, MaskRule};
use point_skeleton::files::FileKind;

const POSE_HEADER: [&str; 16] = [
    "pose",
    "images",
    "PSNR (dB)",
    "filled (%)",
    "depth median (m)",
    "depth 95 % (m)",
    "depth median (%)",
    "depth 95 % (%)",
    "IoU vehicles",
    "mask rule closing",
    "mask rule paper",
    "IoU people",
    "IoU cycles",
    "IoU cars < 40 m",
    "same, templates only",
    "same, own points only",
];

const CAMERA_HEADER: [&str; 6] =
    ["camera", "images", "PSNR (dB)", "filled (%)", "mean error (levels)", "median error (levels)"];

const SWEEP_HEADER: [&str; 9] = [
    "sweep",
    "sweeps",
    "returns",
    "true returns",
    "range median (m)",
    "precision 10 cm",
    "recall 10 cm",
    "F-score",
    "behind (%)",
];

/// File kinds of a report.
pub struct FidelityFiles;

impl FidelityFiles {
    /// All numbers.
    pub const JSON: FileKind = FileKind {
        name: "a report of pskel fidelity",
        begin: b"{\n  \"log\": ",
        marks: &[b"\n  \"description\": "],
    };
    /// Table as CSV.
    pub const CSV: FileKind = FileKind {
        name: "a table of pskel fidelity",
        begin: b"",
        marks: &[b",images,PSNR (dB),filled (%),", b",sweeps,returns,true returns,"],
    };
    /// Table as Markdown.
    pub const MARKDOWN: FileKind = FileKind {
        name: "a table of pskel fidelity",
        begin: b"| ",
        marks: &[b" | images | PSNR (dB) | filled (%) |", b" | sweeps | returns | true returns |"],
    };
}

impl FidelityReport {
    /// Formats the rows with aligned columns; of a town also where masks of vehicles differ.
    pub fn table(&self) -> String {
        let differences = self.rows.differences().map(|cells| format!("\n{}", aligned(&cells)));
        aligned(&self.rows.cells()) + &differences.unwrap_or_default()
    }

    /// Formats the rows as CSV.
    pub fn csv(&self) -> String {
        self.rows.cells().iter().map(|row| row.join(",") + "\n").collect()
    }

    /// Formats the rows as Markdown; of a town also where masks of vehicles differ.
    pub fn markdown(&self) -> String {
        let differences = self.rows.differences().map(|cells| format!("\n{}", markdown(&cells)));
        markdown(&self.rows.cells()) + &differences.unwrap_or_default()
    }
}

impl Rows {
    /// Returns the cells of header and rows.
    fn cells(&self) -> Vec<Vec<String>> {
        let (header, rows): (&[&str], Vec<_>) = match self {
            Self::Poses(rows) => (&POSE_HEADER, rows.iter().map(pose_row).collect()),
            Self::Cameras(rows) => (&CAMERA_HEADER, rows.iter().map(camera_row).collect()),
            Self::Sweeps(rows) => (&SWEEP_HEADER, rows.iter().map(sweep_row).collect()),
        };
        let header = header.iter().map(|&cell| cell.to_owned()).collect();
        std::iter::once(header).chain(rows).collect()
    }
}

impl Rows {
    /// Returns the cells of the differences at the recorded poses: shares of the union of both masks.
    fn differences(&self) -> Option<Vec<Vec<String>>> {
        let Self::Poses(rows) = self else { return None };
        let causes = MaskDifference::ALL.map(|cause| format!("{cause} (%)"));
        let header = ["masks of vehicles", "depth", "pixels", "IoU"].map(str::to_owned);
        let header = header.into_iter().chain(causes).collect();
        Some(std::iter::once(header).chain(rows.first()?.differences.iter().map(band_row)).collect())
    }
}

fn band_row(band: &MaskBand) -> Vec<String> {
    let MaskBand { rule, differences, .. } = band;
    let percent = |count: u64| number(differences.share(count).map(|share| 100.0 * share), 2);
    let iou = number(differences.share(differences.both), 3);
    let cells = [rule.name().to_owned(), band.depth(), differences.either().to_string(), iou];
    cells.into_iter().chain(differences.causes.map(percent)).collect()
}

fn defined(value: f64, digits: usize) -> String {
    number(Some(value).filter(|value| !value.is_nan()), digits)
}

fn camera_row(row: &CameraRow) -> Vec<String> {
    let FilledError { psnr_db, mean_abs, median_abs, filled } = row.color;
    vec![
        row.camera.clone(),
        row.images.to_string(),
        defined(psnr_db, 2),
        defined(100.0 * filled, 2),
        defined(mean_abs, 2),
        defined(median_abs, 2),
    ]
}

fn sweep_row(row: &SweepRow) -> Vec<String> {
    vec![
        row.sweep.clone(),
        row.sweeps.to_string(),
        row.returns.to_string(),
        row.true_returns.to_string(),
        number(row.median_m, 4),
        number(row.precision, 4),
        number(row.recall, 4),
        number(row.f_score, 4),
        number(row.behind.map(|share| 100.0 * share), 2),
    ]
}

fn pose_row(row: &Row) -> Vec<String> {
    let iou = |masks: &MaskRow, class: &str| number(masks.classes.get(class).copied().flatten(), 3);
    let by_rule = |rule: MaskRule| number(row.rendered.vehicles.get(rule.name()).copied().flatten(), 3);
    let near = |masks: &MaskRow| number(masks.near_cars, 3);
    let depth = |of: fn(&crate::DepthSummary) -> f32| row.depth.as_ref().map(|d| f64::from(of(d)));
    vec![
        row.pose.clone(),
        row.images.to_string(),
        defined(row.color.psnr_db, 2),
        defined(100.0 * row.color.filled, 1),
        number(depth(|d| d.median_m), 3),
        number(depth(|d| d.p95_m), 2),
        number(depth(|d| 100.0 * d.median_relative), 2),
        number(depth(|d| 100.0 * d.p95_relative), 1),
        iou(&row.rendered, "motor_vehicle"),
        by_rule(MaskRule::Closing),
        by_rule(MaskRule::Paper),
        iou(&row.rendered, "pedestrian"),
        iou(&row.rendered, "cycle"),
        near(&row.rendered),
        near(&row.templates),
        near(&row.own_points),
    ]
}
