//! `index.html`: the web page that plays a rollout.
//!
//! # How it works
//! `page/page.html` is the template; styles, plots and the data as JSON are inserted, so that the page is one
//! file. The live page shares [`BASE_CSS`] and [`PLOTS_JS`]. The page loads nothing from other sites. It
//! refers to the images in the folders of the steps beside it, so it works from a folder as well as from a
//! server.

use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::files::write_whole;
use serde::Serialize;
use serde_json::Value;

use super::view::Layout;

const TEMPLATE: &str = include_str!("page/page.html");
/// Styles that all pages share: colors, cards, buttons, chips, plots.
pub const BASE_CSS: &str = include_str!("page/base.css");
/// ES module that draws plots, shared by all pages.
pub const PLOTS_JS: &str = include_str!("page/plots.js");
/// Placeholders in the template: of the shared styles, of the module of plots, and of the data.
const BASE_MARK: &str = "/*BASE*/\n";
const PLOTS_MARK: &str = "/*PLOTS*/\n";
const MARK: &str = "/*ROLLOUT*/";

/// Template with styles and plots, without data.
fn template() -> String {
    TEMPLATE.replacen(BASE_MARK, BASE_CSS, 1).replacen(PLOTS_MARK, PLOTS_JS, 1)
}

/// Data of the page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Page {
    /// Name of the log.
    pub log: String,
    /// Short facts for the line below the title.
    pub facts: Vec<String>,
    /// Reason why the rollout stopped early, if it failed.
    pub failure: Option<String>,
    /// Simulation steps per second.
    pub sim_hz: f64,
    /// Names of the maps that can be selected.
    pub maps: Vec<String>,
    /// Arrangement of the cameras in the images.
    pub sheet: Layout,
    /// Colors and names of the lines in the bird's-eye view.
    pub traces: Vec<[String; 2]>,
    /// Steps in order.
    pub steps: Vec<PageStep>,
    /// Events of the rollout.
    pub events: Vec<PageEvent>,
    /// Names and values in the metrics table.
    pub metrics: Vec<[String; 2]>,
    /// Names of the files to link to.
    pub files: Vec<String>,
}

/// A step of [`Page`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageStep {
    /// Folder name.
    pub name: String,
    /// Number of the step.
    pub step: usize,
    /// Seconds since the start.
    pub t_s: f64,
    /// Whether the step follows the log.
    pub warm_up: bool,
    /// Speed of the ego, meters per second.
    pub speed_mps: f64,
    /// Acceleration of the ego, meters per second squared.
    pub acceleration_mps2: f64,
    /// Lateral deviation from the recorded path, to the left, meters.
    pub lateral_m: Option<f64>,
    /// Heading deviation from the recorded path, to the left, radians.
    pub heading_rad: Option<f64>,
    /// Actors visible in a camera whose own logged images around that time did not show them.
    pub fresh: Vec<PageActor>,
}

/// An actor of [`PageStep`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageActor {
    /// Track id.
    pub track: String,
    /// Category name in the dataset.
    pub category: String,
    /// Left, top, width and height in the images, one box per such camera.
    pub boxes: Vec<[f64; 4]>,
}

/// An event of the rollout.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageEvent {
    /// Number of the step at which it happened.
    pub step: usize,
    /// Description.
    pub text: String,
}

impl Page {
    /// Renders the page as HTML.
    ///
    /// # Errors
    /// Returns an error if the data cannot be serialized as JSON.
    pub fn html(&self) -> serde_json::Result<String> {
        // Escapes `<`, so that no text (such as a track id) can end the script element.
        let data = serde_json::to_string(self)?.replace('<', "\\u003c");
        Ok(template().replacen(MARK, &data, 1))
    }

    /// Writes the page to a file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        use std::io::Write;
        let html = self.html().map_err(|e| FileError::io("write", path)(e.into()))?;
        write_whole(path, |out| out.write_all(html.as_bytes()).map_err(FileError::io("write", path)))
    }
}

/// Flattens JSON into the rows of a table. Names of nested values are joined, and a unit at the end of a name
/// moves to the value. Min and max share a row, and so do mean, max and end. Numbers are rounded to three
/// decimals.
pub fn table(value: &Value) -> Vec<[String; 2]> {
    let mut rows = Vec::new();
    add_rows("", "", value, &mut rows);
    rows
}

/// Suffixes of names, and how the units are displayed.
const UNITS: [(&str, &str); 7] = [
    ("_mps3", " m/s\u{b3}"),
    ("_mps2", " m/s\u{b2}"),
    ("_mps", " m/s"),
    ("_m", " m"),
    ("_s", " s"),
    ("_radps", " rad/s"),
    ("_rad", " rad"),
];

fn add_rows(name: &str, unit: &str, value: &Value, rows: &mut Vec<[String; 2]>) {
    let Value::Object(fields) = value else {
        rows.push([name.to_owned(), format!("{}{}", text(value), if value.is_number() { unit } else { "" })]);
        return;
    };
    let field = |name: &str| fields.get(name).map(text).unwrap_or_default();
    let mut names: Vec<&str> = fields.keys().map(String::as_str).collect();
    names.sort_unstable();
    match names[..] {
        ["max", "min"] => {
            rows.push([name.to_owned(), format!("{} to {}{unit}", field("min"), field("max"))]);
            return;
        }
        ["end", "max", "mean"] => {
            let [mean, max, end] = ["mean", "max", "end"].map(field);
            rows.push([name.to_owned(), format!("mean {mean}, most {max}, last {end}{unit}")]);
            return;
        }
        _ => {}
    }
    for (field, value) in fields {
        let (field, unit) = UNITS
            .iter()
            .find_map(|(end, unit)| Some((field.strip_suffix(end)?, *unit)))
            .unwrap_or((field.as_str(), ""));
        let field = field.replace('_', " ");
        // Avoids repetition: "comfortable" instead of "comfort comfortable".
        let whole =
            if name.is_empty() || field.starts_with(name) { field } else { format!("{name} {field}") };
        add_rows(&whole, unit, value, rows);
    }
}

fn text(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::String(text) => text.clone(),
        Value::Number(number) => match number.as_f64() {
            Some(value) if number.is_f64() => rounded(value),
            _ => number.to_string(),
        },
        // Lists are shown by their length; their items are for other programs.
        Value::Array(items) => items.len().to_string(),
        Value::Object(fields) => fields.len().to_string(),
    }
}

fn rounded(value: f64) -> String {
    let text = format!("{value:.3}");
    match text.trim_end_matches('0').trim_end_matches('.') {
        "-0" => "0".to_owned(),
        text => text.to_owned(),
    }
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
            metrics: table(&serde_json::json!({"steps": 1})),
            files: vec!["metrics.json".into()],
        }
    }

    #[test]
    fn page_data_is_escaped() {
        let html = page().html().unwrap();
        let start = html.find(r#"id="rollout">"#).unwrap() + r#"id="rollout">"#.len();
        let data = &html[start..start + html[start..].find("</script>").unwrap()];
        let data: serde_json::Value = serde_json::from_str(data).unwrap();
        assert_eq!(data, serde_json::to_value(page()).unwrap());
        // The data add no tags to the template.
        let tags = |text: &str| text.matches('<').count();
        let template = template();
        assert_eq!(tags(&html), tags(&template));
        assert_eq!(template.matches(MARK).count(), 1);
        assert!(!template.contains(BASE_MARK) && !template.contains(PLOTS_MARK));
        assert!(!BASE_CSS.contains("</") && !PLOTS_JS.contains("</"), "would end its element");
        assert!(
            !template.replace("http://www.w3.org/2000/svg", "").contains("http"),
            "nothing from elsewhere"
        );
    }

    #[test]
    fn tables_are_flat_and_readable() {
        let rows = table(&serde_json::json!({
            "collisions": {"at_fault": 1, "all": [2, 3]},
            "ttc_s": 1.23456,
            "map_m": null,
            "comfort": {"comfortable": true, "jerk_mps3": {"min": -0.0001, "max": 2}},
            "off_m": {"mean": 0.5, "max": 1.25, "end": -1.0},
            "ends": {"max": 1, "min": 2, "end": 3},
        }));
        let expected = [
            ["collisions all", "2"],
            ["collisions at fault", "1"],
            ["comfortable", "yes"],
            ["comfort jerk", "0 to 2 m/s\u{b3}"],
            ["ends end", "3"],
            ["ends max", "1"],
            ["ends min", "2"],
            ["map", "none"],
            ["off", "mean 0.5, most 1.25, last -1 m"],
            ["ttc", "1.235 s"],
        ];
        assert_eq!(rows, expected.map(|row| row.map(str::to_owned)));
    }
}
