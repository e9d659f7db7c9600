//! Description of a log as text and as JSON.

use std::fmt::Write;

use point_skeleton::Log;
use point_skeleton::dataset::{LogSummary, Recording, TrackSummary};
use point_skeleton::files::text::printable_line;
use point_skeleton::scene::frame_rate_hz;
use serde_json::{Value, json};

/// Maximum length of a list in the text, items.
const SHOWN: usize = 20;

/// Describes a log as JSON.
pub(super) fn describe(log: &Log) -> serde_json::Result<Value> {
    let mut json = serde_json::to_value(LogSummary::new(log.reader()))?;
    json["kind"] = json!("log");
    json["frame_rate_hz"] = json!(frame_rate_hz(&log.recording().frames));
    Ok(json)
}

/// Formats the description as lines for the terminal.
pub(super) fn text(json: &Value) -> String {
    let mut lines = String::new();
    // Writing to a string cannot fail.
    let mut line = |name: &str, rest: String| {
        let _ = writeln!(lines, "{name:<10} {}", printable_line(&rest));
    };
    let plain = |key: &str| json[key].as_str().unwrap_or_default();
    let number = |value: &Value| value.as_f64().map_or_else(|| "?".to_owned(), |v| format!("{v:.1}"));
    let location = Some(plain("location")).filter(|location| !location.is_empty());
    let location = location.map_or(String::new(), |location| format!("({location})"));
    let parts = [plain("name"), &location, plain("description")];
    line("log", parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" "));
    let (seconds, rate) = (number(&json["seconds"]), number(&json["frame_rate_hz"]));
    let frames = format!("{} over {seconds} s at {rate} Hz", json["frames"]);
    line("frames", if json["frames"] == 0 { "none".to_owned() } else { frames });
    let points =
        json["points"].as_u64().map_or("generated when read".to_owned(), |n| format!("with {n} points"));
    line("sweeps", format!("{} {points}", json["sweeps"]));
    for camera in json["cameras"].as_array().into_iter().flatten() {
        let (name, size) = (camera["name"].as_str().unwrap_or("?"), camera["size"].as_str().unwrap_or("?"));
        let focal = number(&camera["focal_px"]);
        let (images, between) = (&camera["images"], &camera["between_images"]);
        line(
            "camera",
            format!("{name:<18} {size} focal {focal} px, {images} images ({between} between frames)"),
        );
    }
    if json["cameras"].as_array().is_none_or(Vec::is_empty) {
        line("camera", "none".to_owned());
    }
    let empty =
        json["boxes_without_points"].as_u64().map_or(String::new(), |n| format!(", {n} without points"));
    line("boxes", format!("{} of {} tracks{empty}", json["boxes"], json["tracks"]));
    for (name, tally) in json["categories"].as_object().into_iter().flatten() {
        line("", format!("{name:<34} {} boxes of {} tracks", tally["boxes"], tally["tracks"]));
    }
    let ego = &json["ego"];
    let path =
        format!("{} m, within {} and {}", number(&ego["path_m"]), corner(&ego["min"]), corner(&ego["max"]));
    line("ego", if json["frames"] == 0 { "no poses".to_owned() } else { path });
    line("map", map_line(&json["map"]));
    for (kind, frames) in json["scenarios"].as_object().into_iter().flatten() {
        line("scenario", format!("{kind:<34} {frames} frames"));
    }
    for (color, count) in json["traffic_lights"].as_object().into_iter().flatten() {
        line("lights", format!("{color:<34} {count} times"));
    }
    for (what, count) in json["left_out"].as_object().into_iter().flatten() {
        line("noted", format!("{what}: {count}"));
    }
    for gap in first(&json["gaps"]) {
        line("", gap);
    }
    let damaged = damaged(json);
    let files = match damaged {
        0 => "nothing".to_owned(),
        1 => "1 file, missing or damaged".to_owned(),
        _ => format!("{damaged} files, missing or damaged"),
    };
    line("damaged", files);
    for problem in first(&json["damaged"]) {
        line("", problem);
    }
    lines
}

/// Formats a line per track for the terminal, with times after the first frame.
pub(super) fn tracks_text(log: &Recording, tracks: &[TrackSummary]) -> String {
    let first_us = log.frames.first().map_or(0, |frame| frame.t_us);
    let line = |summary: &TrackSummary| {
        let TrackSummary { track, category, size_m: [length, width, height], t_us, path_m, .. } = summary;
        let [from_s, to_s] = t_us.map(|t_us| (t_us - first_us) as f64 / 1e6);
        let text = format!(
            "{:<10} {track} {category}, {length:.1} x {width:.1} x {height:.1} m, {from_s:.1} to \
                {to_s:.1} s, path {path_m:.1} m",
            "track"
        );
        format!("{}\n", printable_line(&text))
    };
    tracks.iter().map(line).collect()
}

/// Returns the number of missing and damaged files.
pub(super) fn damaged(json: &Value) -> usize {
    json["damaged"].as_array().map_or(0, Vec::len)
}

/// Returns the first texts of a list, and the number of the others.
fn first(list: &Value) -> Vec<String> {
    let all: Vec<&str> = list.as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let mut shown: Vec<String> = all.iter().take(SHOWN).map(|text| (*text).to_owned()).collect();
    if all.len() > SHOWN {
        shown.push(format!("and {} more (--json lists all)", all.len() - SHOWN));
    }
    shown
}

fn map_line(map: &Value) -> String {
    let Some(counts) = map.as_object() else { return "none".to_owned() };
    let count =
        |(name, count): (&String, &Value)| Some(format!("{} {}", count.as_u64()?, name.replace('_', " ")));
    let counts: Vec<String> = counts.iter().filter_map(count).collect();
    format!("{} with {}", map["location"].as_str().unwrap_or_default(), counts.join(", "))
}

/// Formats a corner of bounds, meters.
fn corner(value: &Value) -> String {
    let numbers: Vec<String> = value
        .as_array()
        .into_iter()
        .flatten()
        .map(|v| format!("{:.1}", v.as_f64().unwrap_or(f64::NAN)))
        .collect();
    format!("({})", numbers.join(", "))
}
