//! Summary of a log, and its missing or damaged files: only sizes and headers are read, no pixels or points.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use glam::DVec3;
use point_skeleton::dataset::{Dataset, Frame, ImageRecord, Recording};
use point_skeleton::files::FileName;
use point_skeleton::files::text::printable_line;
use point_skeleton::scene::frame_rate_hz;
use rayon::prelude::*;
use serde_json::{Value, json};

/// Describes a log as JSON.
pub(super) fn describe(dataset: &dyn Dataset) -> Value {
    let log = dataset.log();
    let (points, mut damaged) = sweeps(dataset);
    damaged.extend(images(dataset));
    let mut left_out = log.notes.clone();
    let map = map(dataset, &mut left_out, &mut damaged);
    let times = log.frames.first().zip(log.frames.last()).map(|(a, b)| [a.t_us, b.t_us]);
    let boxes: usize = log.frames.iter().map(|f| f.boxes.len()).sum();
    let empty = dataset.box_points().map(|counts| counts.iter().flatten().filter(|n| **n == 0).count());
    json!({
        "kind": "log",
        "name": log.name,
        "location": log.location,
        "description": log.description,
        "frames": log.frames.len(),
        "t_us": times,
        "seconds": times.map(|[a, b]| (b - a) as f64 * 1e-6),
        "frame_rate_hz": frame_rate_hz(&log.frames),
        "sweeps": log.frames.iter().map(|f| f.sweeps.len()).sum::<usize>(),
        "points": points,
        "cameras": cameras(log),
        "tracks": log.tracks.len(),
        "boxes": boxes,
        "boxes_without_points": empty,
        "categories": categories(log),
        "scenarios": log.scenarios.iter().map(|(kind, frames)| (kind, frames.len())).collect::<BTreeMap<_, _>>(),
        "traffic_lights": lights(log),
        "ego": ego_path(log),
        "map": map,
        "left_out": left_out,
        "damaged": damaged,
    })
}

/// Returns the number of points of all sweeps, derived from file sizes and `None` if they do not determine it, and
/// the errors of damaged sweep files.
fn sweeps(dataset: &dyn Dataset) -> (Option<u64>, Vec<String>) {
    let records: Vec<_> = dataset.log().frames.iter().flat_map(|f| &f.sweeps).collect();
    let results: Vec<_> = records.par_iter().map(|record| dataset.check_sweep(record)).collect();
    let points =
        results.iter().flatten().try_fold(0, |sum: u64, points| Some(sum.saturating_add((*points)?)));
    (points, results.into_iter().filter_map(Result::err).map(|e| e.to_string()).collect())
}

/// Counts the elements of the HD map; null if there is none. Adds the notes of the map's reader to `left_out`.
fn map(dataset: &dyn Dataset, left_out: &mut BTreeMap<String, usize>, damaged: &mut Vec<String>) -> Value {
    match dataset.read_map() {
        Ok(map) => map.map_or(Value::Null, |map| {
            left_out.extend(map.notes.iter().map(|(kind, count)| (format!("map: {kind}"), *count)));
            json!({
                "location": map.location,
                "lanes": map.lanes.len(),
                "lane_connectors": map.lane_connectors.len(),
                "drivable_areas": map.drivable_area.len(),
                "crossings": map.crossings.len(),
                "stop_lines": map.stop_lines.len(),
                "dividers": map.dividers.len(),
            })
        }),
        Err(error) => {
            damaged.push(error.to_string());
            Value::Null
        }
    }
}

/// Returns the errors of image files. A file that is shared by several frames is checked once.
fn images(dataset: &dyn Dataset) -> Vec<String> {
    let log = dataset.log();
    let mut seen = BTreeSet::new();
    let all = log.frames.iter().flat_map(|f| f.images.iter().chain(&f.between_images));
    let records: Vec<&ImageRecord> = all.filter(|record| seen.insert(&record.path)).collect();
    let check = |record: &&ImageRecord| dataset.check_image(record).err().map(|error| error.to_string());
    records.par_iter().filter_map(check).collect()
}

/// Describes each channel: image size, focal length, and number of images.
fn cameras(log: &Recording) -> Value {
    let channel = |(index, name): (usize, &FileName)| {
        let of = |frame: &Frame| frame.images.iter().filter(|i| i.channel == index).count();
        let camera = log.rig.iter().find(|c| c.channel == index).map(|c| &c.camera);
        json!({
            "name": name,
            "size": camera.map(|c| format!("{}x{}", c.height, c.width)),
            "focal_px": camera.map(|c| c.intrinsics.x_axis.x),
            "images": log.frames.iter().map(of).sum::<usize>(),
            "between_images": log.frames.iter().flat_map(|f| &f.between_images).filter(|i| i.channel == index).count(),
        })
    };
    log.cameras.iter().enumerate().map(channel).collect()
}

/// Counts tracks and boxes by category.
fn categories(log: &Recording) -> Value {
    let mut tally: BTreeMap<&str, (BTreeSet<usize>, usize)> = BTreeMap::new();
    for item in log.frames.iter().flat_map(|f| &f.boxes) {
        let entry = tally.entry(&log.tracks[item.track].category).or_default();
        entry.0.insert(item.track);
        entry.1 += 1;
    }
    let entry = |(name, (tracks, boxes)): (&str, (BTreeSet<usize>, usize))| {
        (name.to_owned(), json!({"tracks": tracks.len(), "boxes": boxes}))
    };
    tally.into_iter().map(entry).collect::<serde_json::Map<_, _>>().into()
}

/// Counts the states of traffic lights by color.
fn lights(log: &Recording) -> BTreeMap<&str, usize> {
    let mut tally = BTreeMap::new();
    log.lights.iter().for_each(|light| *tally.entry(light.color.as_str()).or_default() += 1);
    tally
}

/// Returns bounds and length of the ego path, global meters.
fn ego_path(log: &Recording) -> Value {
    let places: Vec<DVec3> = log.frames.iter().map(|f| f.global_from_ego.translation).collect();
    let (min, max) = (places.iter().copied().reduce(DVec3::min), places.iter().copied().reduce(DVec3::max));
    // An empty sum would be -0.
    let length = places.windows(2).map(|w| w[0].distance(w[1])).fold(0.0, |sum, m| sum + m);
    json!({"min": min.map(|v| v.to_array()), "max": max.map(|v| v.to_array()), "path_m": length})
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
    line("log", format!("{} ({}) {}", plain("name"), plain("location"), plain("description")));
    let (seconds, rate) = (number(&json["seconds"]), number(&json["frame_rate_hz"]));
    line("frames", format!("{} over {seconds} s at {rate} Hz", json["frames"]));
    let points = json["points"].as_u64().map_or("made when read".to_owned(), |n| format!("with {n} points"));
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
    let empty =
        json["boxes_without_points"].as_u64().map_or(String::new(), |n| format!(", {n} without points"));
    line("boxes", format!("{} of {} tracks{empty}", json["boxes"], json["tracks"]));
    for (name, tally) in json["categories"].as_object().into_iter().flatten() {
        line("", format!("{name:<34} {} boxes of {} tracks", tally["boxes"], tally["tracks"]));
    }
    let ego = &json["ego"];
    line(
        "ego",
        format!("{} m, within {} and {}", number(&ego["path_m"]), corner(&ego["min"]), corner(&ego["max"])),
    );
    line("map", map_line(&json["map"]));
    for (kind, frames) in json["scenarios"].as_object().into_iter().flatten() {
        line("scenario", format!("{kind:<34} {frames} frames"));
    }
    for (color, count) in json["traffic_lights"].as_object().into_iter().flatten() {
        line("lights", format!("{color:<34} {count} times"));
    }
    for (what, count) in json["left_out"].as_object().into_iter().flatten() {
        line("left out", format!("{what}: {count}"));
    }
    let damaged = json["damaged"].as_array().map_or(0, Vec::len);
    line("damaged", if damaged == 0 { "nothing".to_owned() } else { format!("{damaged} files") });
    for problem in json["damaged"].as_array().into_iter().flatten() {
        line("", problem.as_str().unwrap_or_default().to_owned());
    }
    lines
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
