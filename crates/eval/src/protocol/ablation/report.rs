//! Results: tables with means and 95 % confidence intervals over scenes, differences from the full generator,
//! and curves over the horizon.

use std::collections::BTreeMap;
use std::fmt::Write;

use point_skeleton::error::FileError;
use point_skeleton::files::{OutputFolder, write_json, write_whole};
use serde::Serialize;

use super::rows::{Row, Table};
use super::run::RunResult;
use crate::plot::{Curve, Plot};
use crate::table::interval;
use crate::{MeanInterval, mean_interval, paired_difference};

/// Reported metrics: name in the results, column, digits.
const COLUMNS: [(&str, &str, usize); 6] = [
    ("psnr_db", "PSNR (dB)", 2),
    ("psnr_db_slope_per_s", "PSNR slope (dB/s)", 3),
    ("ssim", "SSIM", 3),
    ("sharpness_ratio", "sharpness ratio", 2),
    ("motion_slope", "motion", 2),
    ("flicker", "flicker", 2),
];

/// Results of all variants.
#[derive(Debug, Serialize)]
pub struct Report {
    #[serde(skip)]
    tables: Vec<Table>,
    scenes: Vec<String>,
    rows: Vec<RowReport>,
}

/// Results of a variant over all scenes.
#[derive(Debug, Serialize)]
struct RowReport {
    name: String,
    title: String,
    #[serde(skip)]
    tables: &'static [Table],
    /// Means by metric name.
    mean: BTreeMap<String, Option<MeanInterval>>,
    /// Differences from the first row, paired by scene.
    difference: BTreeMap<String, Option<MeanInterval>>,
    /// Mean PSNR over scenes by step: seconds and dB.
    psnr_db: Vec<[f64; 2]>,
}

impl Report {
    /// Creates the report with the given tables, or with all tables if none are given.
    pub(super) fn new(tables: &[Table], rows: &[Row], results: &[RunResult]) -> Self {
        let of = |row: &Row| results.iter().filter(|result| result.row == row.name).collect::<Vec<_>>();
        let first = rows.first().map(of).unwrap_or_default();
        let row = |row: &Row| RowReport::new(row, &of(row), &first);
        Self {
            tables: Table::ALL.into_iter().filter(|t| tables.is_empty() || tables.contains(t)).collect(),
            scenes: first.iter().map(|result| result.scene.clone()).collect(),
            rows: rows.iter().map(row).collect(),
        }
    }

    /// Returns the names of the files that [`Self::write`] may write.
    pub(super) fn files(tables: &[Table]) -> Vec<String> {
        let is_asked = |table: &Table| tables.is_empty() || tables.contains(table);
        let curves = Table::ALL.into_iter().filter(is_asked).map(|table| format!("{}.svg", table.name()));
        ["results.json", "table.md"].map(str::to_owned).into_iter().chain(curves).collect()
    }

    /// Writes results.json, table.md and a curve for each table.
    pub(super) fn write(&self, files: &OutputFolder) -> Result<(), FileError> {
        write_json(&files.claim("results.json")?, self)?;
        let path = files.claim("table.md")?;
        write_whole(&path, |out| {
            std::io::Write::write_all(out, self.table().as_bytes()).map_err(FileError::io("write", &path))
        })?;
        for &table in &self.tables {
            let curve = |row: &RowReport| Curve {
                name: row.title.clone(),
                points: row.psnr_db.clone(),
                is_faint: false,
            };
            let curves: Vec<Curve> = self.of_table(table).map(curve).collect();
            if curves.len() > 1 {
                let plot = Plot { title: table.title(), axes: ["seconds", "PSNR (dB)"], curves };
                plot.write(&files.claim(format!("{}.svg", table.name()))?)?;
            }
        }
        Ok(())
    }

    fn of_table(&self, table: Table) -> impl Iterator<Item = &RowReport> {
        self.rows.iter().filter(move |row| row.tables.contains(&table))
    }

    /// Formats the tables as Markdown.
    pub fn table(&self) -> String {
        let mut text = String::new();
        for &table in self.tables.iter().filter(|table| self.of_table(**table).count() > 1) {
            let head: Vec<&str> = COLUMNS.iter().map(|(_, column, _)| *column).collect();
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{}\n\n| | {} |", table.title(), head.join(" | "));
            let _ = writeln!(text, "|---|{}", "---|".repeat(COLUMNS.len()));
            for row in self.of_table(table) {
                let _ = writeln!(text, "| {} | {} |", row.title, cells(&row.mean).join(" | "));
            }
            for row in self.of_table(table).skip(1) {
                let _ =
                    writeln!(text, "| {}, difference | {} |", row.title, cells(&row.difference).join(" | "));
            }
            text.push('\n');
        }
        let _ = writeln!(text, "Means and 95 % confidence intervals over {} scenes.", self.scenes.len());
        text
    }
}

impl RowReport {
    fn new(row: &Row, results: &[&RunResult], first: &[&RunResult]) -> Self {
        let values = |results: &[&RunResult], name: &str| -> Vec<Option<f64>> {
            results.iter().map(|result| result.numbers.get(name).copied().flatten()).collect()
        };
        let names = || results.iter().flat_map(|result| result.numbers.keys());
        let mean = |name: &String| {
            let known: Vec<f64> = values(results, name).into_iter().flatten().collect();
            (name.clone(), mean_interval(&known))
        };
        let difference =
            |name: &String| (name.clone(), paired_difference(&values(results, name), &values(first, name)));
        let steps = results.first().map_or(&[][..], |result| &result.t_s);
        let at = |(step, t_s): (usize, &f64)| {
            let known: Vec<f64> =
                results.iter().filter_map(|result| result.psnr_db.get(step).copied().flatten()).collect();
            Some([*t_s, mean_interval(&known)?.mean])
        };
        Self {
            name: row.name.clone(),
            title: row.title.clone(),
            tables: row.tables,
            mean: names().map(mean).collect(),
            difference: names().map(difference).collect(),
            psnr_db: steps.iter().enumerate().filter_map(at).collect(),
        }
    }
}

fn cells(numbers: &BTreeMap<String, Option<MeanInterval>>) -> Vec<String> {
    let cell = |(name, _, digits)| interval(numbers.get(name).copied().flatten(), digits);
    COLUMNS.map(cell).to_vec()
}

#[cfg(test)]
mod tests {
    use super::super::options::{AblationOptions, Choice, Origin};
    use super::*;
    use point_skeleton::files::Inputs;
    use pskel_generate::{DroppedConditions, Strategy};

    fn row(name: &str) -> Row {
        Row {
            name: name.into(),
            title: name.into(),
            tables: &[Table::Strategies],
            strategy: Strategy::ResetAndRoll,
            dropped: DroppedConditions::default(),
            network: Choice::Main,
            times_steps: 1,
            expects_standstill: false,
        }
    }

    fn result(scene: &str, row: &str, psnr_db: f64) -> RunResult {
        RunResult {
            scene: scene.into(),
            row: row.into(),
            origin: Origin { settings: AblationOptions { steps: 2, seed: 0 }, weights: String::new() },
            numbers: [("psnr_db".to_owned(), Some(psnr_db)), ("ssim".to_owned(), None)].into(),
            t_s: vec![0.6, 0.8],
            psnr_db: vec![Some(psnr_db), Some(psnr_db - 1.0)],
        }
    }

    #[test]
    fn rows_are_compared_per_scene() {
        let rows = [row("a"), row("b")];
        let results =
            [result("x", "a", 20.0), result("x", "b", 19.0), result("y", "a", 24.0), result("y", "b", 23.0)];
        let report = Report::new(&[], &rows, &results);
        let table = report.table();
        // 12.706 * sqrt(8 / 2): one degree of freedom.
        assert!(table.contains("| a | 22.00 ± 25.41 | - | - |"), "{table}");
        assert!(table.contains("| b, difference | -1.00 ± 0.00 | - |"), "{table}");
        assert!(table.ends_with("over 2 scenes.\n"), "{table}");
        assert_eq!(report.rows[1].psnr_db, [[0.6, 21.0], [0.8, 20.0]]);
        let folder = tempfile::tempdir().unwrap();
        report.write(&OutputFolder::open(folder.path(), "ablation", &Inputs::default()).unwrap()).unwrap();
        let svg = std::fs::read_to_string(folder.path().join("strategies.svg")).unwrap();
        assert!(svg.contains("PSNR (dB)") && !folder.path().join("conditions.svg").exists());
    }
}
