//! Results of several methods in one table.

mod results;

use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::named;

use self::results::{MethodName, RESULTS, Results};
use super::published::{PUBLISHED, Published};
use super::report::COLUMNS;
use crate::table::{csv, latex, markdown, number};

/// Format of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TableFormat {
    /// Markdown.
    #[default]
    Markdown,
    /// Comma-separated values.
    Csv,
    /// LaTeX.
    Latex,
}

named!(TableFormat, "format of tables" {
    Markdown => "markdown", "tables with vertical bars, one per part";
    Csv => "csv", "comma-separated values (RFC 4180), one table with a column for the part";
    Latex => "latex", "tabular environments of the package booktabs, one per part";
});

/// Results of several methods on the same clips.
#[derive(Debug)]
pub struct MethodTable {
    methods: Vec<Results>,
    /// Why rows cannot be compared.
    notes: Vec<String>,
}

impl MethodTable {
    /// Reads the results in folders of `pskel protocol`.
    ///
    /// # Errors
    /// Fails if a file cannot be read, if a folder has results of another protocol than the first one, or if
    /// two methods have the same name.
    pub fn read(folders: &[impl AsRef<Path>]) -> Result<Self, FileError> {
        let mut methods: Vec<Results> = Vec::new();
        for folder in folders.iter().map(AsRef::as_ref) {
            let found = Results::read(folder)?;
            let path = folder.join(RESULTS);
            if let Some(first) = methods.first().filter(|first| first.protocol != found.protocol) {
                let expected = format!("results of protocol {}", first.protocol);
                return Err(FileError::content(expected, format!("those of {}", found.protocol), &path));
            }
            if methods.iter().any(|other| other.method.name == found.method.name) {
                let found = format!("{} again (pskel protocol --method NAME)", found.method.name);
                return Err(FileError::content("each method once", found, &path));
            }
            methods.push(found);
        }
        let notes = methods.split_first().map_or_else(Vec::new, |(first, others)| {
            others.iter().flat_map(|other| first.differences(other)).collect()
        });
        Ok(Self { methods, notes })
    }

    /// Formats the tables. `published` adds the figures of the paper.
    pub fn format(&self, format: TableFormat, published: bool) -> String {
        let parts = self.parts().into_iter().map(|part| (part, self.cells(part, published)));
        let notes = self.remarks();
        match format {
            TableFormat::Markdown => {
                let tables: Vec<String> = parts.map(|(_, cells)| markdown(&cells)).collect();
                let notes = notes.iter().map(|note| format!("\n{note}.\n")).collect::<String>();
                tables.join("\n") + &notes
            }
            TableFormat::Csv => {
                let mut all: Vec<Vec<String>> = Vec::new();
                for (part, mut cells) in parts {
                    cells[0][0] = "method".to_owned();
                    for (number, row) in cells.iter_mut().enumerate() {
                        row.insert(0, if number == 0 { "part".to_owned() } else { part.to_owned() });
                    }
                    all.extend(cells.into_iter().skip(usize::from(!all.is_empty())));
                }
                csv(&all)
            }
            TableFormat::Latex => {
                let tables: Vec<String> = parts.map(|(_, cells)| latex(&cells)).collect();
                let notes = notes.iter().map(|note| format!("% {note}.\n")).collect::<String>();
                tables.join("\n") + &notes
            }
        }
    }

    /// Returns why rows cannot be compared.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the names of all parts, in the order of the first method.
    fn parts(&self) -> Vec<&str> {
        let mut parts = Vec::new();
        for part in self.methods.iter().flat_map(|method| &method.parts) {
            if !parts.contains(&part.name.as_str()) {
                parts.push(part.name.as_str());
            }
        }
        parts
    }

    fn remarks(&self) -> Vec<String> {
        let of_method = |method: &Results| {
            let MethodName { name, remark, .. } = &method.method;
            remark.as_ref().map(|remark| format!("{name}: {remark}"))
        };
        self.methods.iter().filter_map(of_method).chain(self.notes.iter().cloned()).collect()
    }

    /// Returns the rows of a part, after the header.
    fn cells(&self, part: &str, published: bool) -> Vec<Vec<String>> {
        let protocol = self.methods.first().map_or("", |method| method.protocol.as_str());
        let title = format!("{protocol}, {part}");
        let columns = COLUMNS.map(|(_, column, _)| column);
        let header = [title.as_str(), "clips", "frames", "size"].into_iter().chain(columns);
        let header = header.chain(["FID", "FVD", "IoU (%)", "at-fault collisions", "off-road share"]);
        let mut cells = vec![header.map(str::to_owned).collect::<Vec<_>>()];
        for method in &self.methods {
            let results = method.parts.iter().find(|found| found.name == part);
            cells.extend(results.map(|results| results.row(&method.method.name)));
        }
        let of_part = |figures: &&Published| figures.protocol == protocol && figures.part == part;
        let figures = PUBLISHED.iter().filter(of_part).filter(|_| published);
        cells.extend(figures.map(published_row));
        cells
    }
}

/// Returns the row of published figures.
fn published_row(figures: &Published) -> Vec<String> {
    let Published { method, fid, fvd, iou, .. } = figures;
    let empty = || "-".to_owned();
    let first = [format!("{method} (published)"), empty(), empty(), empty()];
    let scores = [number(Some(*fid), 2), number(*fvd, 1), number(*iou, 2)];
    let means = COLUMNS.map(|_| empty());
    first.into_iter().chain(means).chain(scores).chain([empty(), empty()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    /// Writes results of a method with one clip of this many frames.
    fn write(folder: &Path, method: &str, references: usize, steps: usize, settings: &Value) {
        let mean = |mean: f64| json!({"count": 2, "mean": mean, "half_width": 0.5});
        let results = json!({
            "protocol": "nuscenes-val",
            "method": {"name": method, "references": references},
            "logs": {"defined": 150, "present": 1, "other": 0},
            "networks": {"inception": "w.pth", "i3d": null, "segmentor": null},
            "mask_rule": "closing",
            "parts": [{
                "name": "2hz", "clips": 1, "frames": 16,
                "driving": {"at_fault_collisions": 0, "off_road_share": null},
                "fid": {"distance": 12.345, "samples": [96, 96], "features": 2048}, "fvd": null, "notes": [],
                "images": {
                    "mean": {"psnr_db": mean(20.0), "iou_masks": mean(0.5), "ssim": null},
                    "notes": [],
                    "rollouts": [{"folder": "2hz/scene-0003", "cameras": ["C"], "sizes": ["256x448"],
                                  "references": 3, "scores": {"steps": steps}}],
                },
            }],
        });
        std::fs::create_dir_all(folder).unwrap();
        std::fs::write(folder.join("results.json"), results.to_string()).unwrap();
        std::fs::write(folder.join("protocol.json"), settings.to_string()).unwrap();
    }

    #[test]
    fn methods_are_joined() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b, c] = ["a", "b", "c"].map(|name| folder.path().join(name));
        let settings = |generator: &str, actors: &str| json!({"generator": generator, "actors": actors});
        write(&a, "one_a", 3, 16, &settings("fill", "replay"));
        write(&b, "two", 3, 16, &settings("network", "replay"));
        let both = MethodTable::read(&[&a, &b]).unwrap();
        assert_eq!(both.notes(), [""; 0]);
        let table = both.format(TableFormat::Markdown, true);
        let lines: Vec<&str> = table.lines().collect();
        let first = "| one_a | 1 | 16 | 256x448 | 20.00 ± 0.50 | - | - | - | - | - ";
        assert_eq!(lines[2], format!("{first}| 12.35 | - | 50.0 ± 50.0 | 0 | - |"));
        assert!(lines[4].starts_with("| Point as Skeleton, image network (published) | - |"), "{table}");
        assert!(lines[4].contains("| 7.09 | 69.5 | - |"), "{table}");
        assert_eq!((lines.len(), both.format(TableFormat::Markdown, false).lines().count()), (5, 4));
        let text = both.format(TableFormat::Csv, false);
        assert!(text.starts_with("part,method,clips,frames,size,PSNR (dB),"), "{text}");
        assert!(text.contains("\r\n2hz,two,1,16,256x448,20.00 ± 0.50,-,"), "{text}");
        let text = both.format(TableFormat::Latex, true);
        assert!(text.contains("one\\_a & 1 & 16 & 256x448 & $20.00 \\pm 0.50$ & - &"), "{text}");

        write(&c, "three", 0, 5, &settings("x", "idm"));
        let notes = MethodTable::read(&[&a, &c]).unwrap().notes().join("\n");
        assert!(notes.contains("one_a and three differ in the option actors"), "{notes}");
        assert!(notes.contains("one_a begins with 3 recorded frames, three with 0"), "{notes}");
        assert!(notes.contains("frames of 1 of 1 clips of 2hz, first 2hz/scene-0003"), "{notes}");
        let error = MethodTable::read(&[&a, &a]).unwrap_err().to_string();
        assert!(error.starts_with("expected each method once, found one_a again"), "{error}");
        let other =
            std::fs::read_to_string(b.join("results.json")).unwrap().replace("nuscenes-val", "lane-change");
        std::fs::write(b.join("results.json"), other).unwrap();
        let error = MethodTable::read(&[&a, &b]).unwrap_err().to_string();
        assert!(error.starts_with("expected results of protocol nuscenes-val, found those of lane-change"));
    }
}
