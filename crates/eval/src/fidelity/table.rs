//! Text formats of the table.

use super::FidelityReport;
use super::measure::{MaskRow, Row};
use crate::table::{aligned, number};
use point_skeleton::files::FileKind;

const HEADER: [&str; 14] = [
    "pose",
    "images",
    "PSNR (dB)",
    "filled (%)",
    "depth median (m)",
    "depth 95 % (m)",
    "depth median (%)",
    "depth 95 % (%)",
    "IoU vehicles",
    "IoU people",
    "IoU cycles",
    "IoU cars < 40 m",
    "same, templates only",
    "same, own points only",
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
        begin: b"pose,images,PSNR (dB),filled (%),",
        marks: &[],
    };
    /// Table as Markdown.
    pub const MARKDOWN: FileKind = FileKind {
        name: "a table of pskel fidelity",
        begin: b"| pose | images | PSNR (dB) | filled (%) |",
        marks: &[],
    };
}

impl FidelityReport {
    /// Formats a row per pose, with aligned columns.
    pub fn table(&self) -> String {
        aligned(&cells(&self.poses))
    }

    /// Formats a row per pose as CSV.
    pub fn csv(&self) -> String {
        csv(&cells(&self.poses))
    }

    /// Formats a row per pose as Markdown.
    pub fn markdown(&self) -> String {
        markdown(&cells(&self.poses))
    }
}

/// Returns the cells of header and rows.
fn cells(rows: &[Row]) -> Vec<Vec<String>> {
    let header = HEADER.map(str::to_owned).to_vec();
    std::iter::once(header).chain(rows.iter().map(row)).collect()
}

fn row(row: &Row) -> Vec<String> {
    let iou = |masks: &MaskRow, class: &str| number(masks.classes.get(class).copied().flatten(), 3);
    let near = |masks: &MaskRow| number(masks.near_cars, 3);
    let depth = |of: fn(&crate::DepthSummary) -> f32| row.depth.as_ref().map(|d| f64::from(of(d)));
    vec![
        row.pose.clone(),
        row.images.to_string(),
        number(Some(row.color.psnr_db).filter(|v| !v.is_nan()), 2),
        number(Some(100.0 * row.color.filled).filter(|v| !v.is_nan()), 1),
        number(depth(|d| d.median_m), 3),
        number(depth(|d| d.p95_m), 2),
        number(depth(|d| 100.0 * d.median_relative), 2),
        number(depth(|d| 100.0 * d.p95_relative), 1),
        iou(&row.rendered, "motor_vehicle"),
        iou(&row.rendered, "pedestrian"),
        iou(&row.rendered, "cycle"),
        near(&row.rendered),
        near(&row.templates),
        near(&row.own_points),
    ]
}

fn csv(cells: &[Vec<String>]) -> String {
    cells.iter().map(|row| row.join(",") + "\n").collect()
}

fn markdown(cells: &[Vec<String>]) -> String {
    let line = |row: &Vec<String>| format!("| {} |\n", row.join(" | "));
    let Some((header, rows)) = cells.split_first() else { return String::new() };
    let rule = format!("|{}\n", "---|".repeat(header.len()));
    line(header) + &rule + &rows.iter().map(line).collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_csv_and_markdown() {
        let cells = vec![vec!["a".to_owned(), "bcd".to_owned()], vec!["ef".to_owned(), "1".to_owned()]];
        assert_eq!(csv(&cells), "a,bcd\nef,1\n");
        assert_eq!(markdown(&cells), "| a | bcd |\n|---|---|\n| ef | 1 |\n");
    }
}
