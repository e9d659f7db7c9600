//! `index.html`: the page that plays a rollout.
//!
//! # How it works
//! `page.html` is the whole page but for its data, which stand in it as JSON. It needs nothing from elsewhere, and
//! refers to the pictures in the folders of the steps beside it, so it works from a folder as from a server.

use std::path::Path;

use serde::Serialize;

use super::view::Layout;
use crate::error::{FileError, write_whole};

const TEMPLATE: &str = include_str!("page.html");
/// Where the data go.
const MARK: &str = "/*ROLLOUT*/";

/// What the page tells.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Page {
    /// Name of the log.
    pub log: String,
    /// Short facts for the line under the title.
    pub facts: Vec<String>,
    /// Why the rollout stopped before its end, if it failed.
    pub failure: Option<String>,
    /// Steps a second.
    pub sim_hz: f64,
    /// Maps that can be chosen.
    pub maps: Vec<String>,
    /// Where cameras stand in the pictures.
    pub sheet: Layout,
    /// Colors and names of the lines in the picture from above.
    pub traces: Vec<[String; 2]>,
    /// In order.
    pub steps: Vec<PageStep>,
    /// What happened when.
    pub events: Vec<PageEvent>,
    /// Names and values of a table.
    pub metrics: Vec<[String; 2]>,
    /// Files to link to.
    pub files: Vec<String>,
}

/// A step of [`Page`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageStep {
    /// Folder name.
    pub name: String,
    /// Its number.
    pub step: usize,
    /// Seconds since the start.
    pub t_s: f64,
    /// Whether it follows the log.
    pub warm_up: bool,
    /// Metres per second.
    pub speed_mps: f64,
    /// Metres per second squared.
    pub acceleration_mps2: f64,
    /// Left of the recorded path, metres.
    pub lateral_m: Option<f64>,
    /// Off the recorded path's direction, radians.
    pub heading_rad: Option<f64>,
    /// Who is seen that no logged image around showed.
    pub fresh: Vec<PageActor>,
}

/// An actor of [`PageStep`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageActor {
    /// Track id.
    pub track: String,
    /// The data set's category name.
    pub category: String,
    /// Left, top, width and height in the pictures, per camera that sees it.
    pub boxes: Vec<[f64; 4]>,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageEvent {
    /// At this step.
    pub step: usize,
    /// In words.
    pub text: String,
}

impl Page {
    /// The page as HTML.
    ///
    /// # Errors
    /// Numbers that JSON has no words for.
    pub fn html(&self) -> serde_json::Result<String> {
        // Within a script no name of a track may end it.
        let data = serde_json::to_string(self)?.replace('<', "\\u003c");
        Ok(TEMPLATE.replacen(MARK, &data, 1))
    }

    /// Writes the page.
    ///
    /// # Errors
    /// The system's.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        use std::io::Write;
        let html = self.html().map_err(|e| FileError::io("write", path)(e.into()))?;
        write_whole(path, |out| out.write_all(html.as_bytes()).map_err(FileError::io("write", path)))
    }
}

/// Rows of a table out of any JSON: names of nested values are joined, numbers rounded to four digits behind the point.
pub fn table(value: &serde_json::Value) -> Vec<[String; 2]> {
    let mut rows = Vec::new();
    add_rows("", value, &mut rows);
    rows
}

fn add_rows(name: &str, value: &serde_json::Value, rows: &mut Vec<[String; 2]>) {
    use serde_json::Value;
    let text = match value {
        Value::Object(fields) => {
            for (field, value) in fields {
                let space = if name.is_empty() { "" } else { " " };
                add_rows(&format!("{name}{space}{}", field.replace('_', " ")), value, rows);
            }
            return;
        }
        Value::Null => "none".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::String(text) => text.clone(),
        Value::Number(number) => match number.as_f64() {
            Some(value) if number.is_f64() => rounded(value),
            _ => number.to_string(),
        },
        // What a list holds is for other programs.
        Value::Array(items) => items.len().to_string(),
    };
    rows.push([name.to_owned(), text]);
}

fn rounded(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page() -> Page {
        let actor = PageActor {
            track: "</script><b>".into(),
            category: "vehicle.car".into(),
            boxes: vec![[1.0, 2.0, 3.5, 4.0]],
        };
        let step = PageStep {
            name: "000000".into(),
            step: 0,
            t_s: 0.0,
            warm_up: true,
            speed_mps: 5.0,
            acceleration_mps2: 0.0,
            lateral_m: None,
            heading_rad: Some(0.1),
            fresh: vec![actor],
        };
        Page {
            log: "log /*ROLLOUT*/".into(),
            facts: vec!["replay".into()],
            failure: None,
            sim_hz: 10.0,
            maps: vec!["color".into()],
            sheet: Layout::default(),
            traces: Vec::new(),
            steps: vec![step],
            events: vec![PageEvent { step: 0, text: "a & b".into() }],
            metrics: table(
                &serde_json::json!({"collisions": {"at_fault": 1, "all": [2, 3]}, "ttc_s": 1.23456, "map": null}),
            ),
            files: vec!["metrics.json".into()],
        }
    }

    #[test]
    fn data_stand_in_the_page_and_cannot_break_out() {
        let html = page().html().unwrap();
        let start = html.find(r#"id="rollout">"#).unwrap() + r#"id="rollout">"#.len();
        let data = &html[start..start + html[start..].find("</script>").unwrap()];
        let data: serde_json::Value = serde_json::from_str(data).unwrap();
        assert_eq!(data, serde_json::to_value(page()).unwrap());
        // As many tags as without data.
        let tags = |text: &str| text.matches('<').count();
        assert_eq!(tags(&html), tags(TEMPLATE));
        assert_eq!(TEMPLATE.matches(MARK).count(), 1);
        assert!(
            !TEMPLATE.replace("http://www.w3.org/2000/svg", "").contains("http"),
            "nothing from elsewhere"
        );
    }

    #[test]
    fn tables_are_flat() {
        let rows = page().metrics;
        let expected =
            [["collisions all", "2"], ["collisions at fault", "1"], ["map", "none"], ["ttc s", "1.2346"]];
        assert_eq!(rows, expected.map(|row| row.map(str::to_owned)));
    }
}
