//! Words, numbers and folder names of other data sets in nuScenes' layout.

use std::path::Path;

use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{Class, LogLocator, LogReader, Recording};
use serde_json::{Value, json};

use super::Case;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, assert_failed};
use pskel_testing::nuplan_log::NuplanLog;

fn recording(root: &Path) -> Recording {
    NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, root))
        .unwrap()
        .recording()
        .clone()
}

fn note(log: &Recording, kind: &str) -> usize {
    log.notes.get(kind).copied().unwrap_or(0)
}

#[test]
fn plain_categories_have_the_same_classes_as_dotted_ones() {
    let Some(case) = Case::new("data/05-plain-categories") else { return };
    let [plain, dotted] = ["in/plain", "in/dotted"].map(|name| recording(&case.path().join(name)));
    let classes = |log: &Recording| log.tracks.iter().map(|track| track.class).collect::<Vec<_>>();
    assert_eq!(classes(&plain), classes(&dotted));
    assert!(classes(&plain).iter().filter(|class| **class == Class::MotorVehicle).count() > 20);
    assert_eq!(plain.notes, dotted.notes);
    let (shown, _) = case.succeed("info nuscenes:in/plain --json");
    assert!(!shown.contains("unknown category"), "{shown}");
}

/// Maps follow the words, whatever their case and separators.
#[test]
fn plain_and_dotted_categories_give_equal_maps() {
    let rendered = |words: [&str; 2]| {
        let log = TinyLog::new();
        let names = log.json("log/v1.0-mini/category.json");
        let place = |group: &str| {
            let of = |c: &Value| c["name"].as_str().unwrap().starts_with(group);
            names.as_array().unwrap().iter().position(of).unwrap()
        };
        for (group, word) in [("vehicle", words[0]), ("movable_object", words[1])] {
            log.change("category", &format!("/{}/name", place(group)), json!(word));
        }
        log.succeed("build nuscenes:log --out sk");
        log.succeed("render nuscenes:log --skeleton sk --out maps --maps class,boxes --rasterizer cpu");
        let maps = crate::tiny_log::tree(&log.path("maps"));
        maps.into_iter().filter(|(name, _)| name.ends_with(".png")).collect::<Vec<_>>()
    };
    let dotted = rendered(["vehicle.car", "movable_object.trafficcone"]);
    assert!(dotted.len() > 6);
    for words in [["car", "traffic_cone"], ["Car", "Cones"], ["TYPE_CAR", "barrier"]] {
        assert!(rendered(words) == dotted, "{words:?}");
    }
    assert!(rendered(["hovercraft", "barrier"]) != dotted);
}

#[test]
fn boxes_of_unknown_categories_are_counted() {
    let log = TinyLog::new();
    log.change("category", "/0/name", json!("hovercraft"));
    let boxes = "boxes of the unknown category hovercraft (read as objects)";
    let shown = log.run("info nuscenes:log");
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(shown.contains(&format!("{boxes}: 3")), "{shown}");
    let built = log.run("build nuscenes:log --out sk");
    let reported = [built.stdout, built.stderr].concat();
    assert!(String::from_utf8_lossy(&reported).contains(boxes), "{}", String::from_utf8_lossy(&reported));

    let nuplan = NuplanLog::new();
    nuplan.sql("UPDATE category SET name = 'Hovercraft';");
    let log = nuplan.open().unwrap();
    let count: usize = log.recording().frames.iter().map(|frame| frame.boxes.len()).sum();
    assert!(count > 0);
    assert_eq!(note(log.recording(), "boxes of the unknown category Hovercraft (read as objects)"), count);
    nuplan.sql("UPDATE category SET name = 'Car';");
    let log = nuplan.open().unwrap();
    assert!(log.recording().tracks.iter().all(|track| track.class == Class::MotorVehicle));
}

#[test]
fn numbers_of_table_tools_are_read() {
    let Some(case) = Case::new("data/07-lyft-numbers") else { return };
    let at = |name: &str| recording(&case.path().join("in").join(name));
    let times = |log: &Recording| log.frames.iter().map(|frame| frame.t_us).collect::<Vec<_>>();
    // A whole recording has the same times.
    let usual = at("null-points");
    for name in ["whole-float-times", "fractional-times"] {
        assert_eq!(times(&at(name)), times(&usual), "{name}");
    }
    let boxes: usize = usual.frames.iter().map(|frame| frame.boxes.len()).sum();
    let unknown = "boxes with an unknown number of LiDAR points";
    for (name, count) in [("null-points", boxes), ("minus-one-points", boxes), ("float-points", 0)] {
        assert_eq!(note(&at(name), unknown), count, "{name}");
        let (shown, _) = case.succeed(&format!("info nuscenes:in/{name} --json"));
        let shown: Value = serde_json::from_str(&shown).unwrap();
        assert_eq!(shown["boxes_without_points"].is_null(), count > 0, "{name}");
    }
    let (shown, _) = case.succeed("info nuscenes:in/version-folder --json");
    let shown: Value = serde_json::from_str(&shown).unwrap();
    assert_eq!((&shown["frames"], &shown["boxes"]), (&json!(4), &json!(boxes)));
}

/// Each of these values occurs in data sets of converters.
#[test]
fn reported_counts_do_not_affect_the_result() {
    let path = "/0/num_lidar_pts";
    for value in [json!(-1), json!(2.5), json!(1e300), json!("many"), json!([]), json!(null), json!("7")] {
        let log = TinyLog::new();
        log.change("sample_annotation", path, value.clone());
        let known = usize::from(value != json!("7"));
        let log = recording(&log.path("log"));
        assert_eq!(note(&log, "boxes with an unknown number of LiDAR points"), known, "{value}");
    }
    // Sizes of LiDAR records are not read, sizes of images are.
    let log = TinyLog::new();
    let data = log.json("log/v1.0-mini/sample_data.json");
    let is_image = |r: &Value| r["filename"].as_str().unwrap().ends_with(".png");
    for (place, record) in data.as_array().unwrap().iter().enumerate() {
        let value = if is_image(record) { json!(96.0) } else { json!("none") };
        log.change("sample_data", &format!("/{place}/width"), value);
    }
    assert_eq!(recording(&log.path("log")).cameras.len(), 2);
    let place = data.as_array().unwrap().iter().position(is_image).unwrap();
    log.change("sample_data", &format!("/{place}/width"), json!(-1));
    let token = data[place]["token"].as_str().unwrap();
    let expected = format!("expected width and height of an image, found -1 and 64 in sample_data {token}");
    assert_failed(&log.run("info nuscenes:log"), 1, &[&expected]);
}

#[test]
fn tables_are_found_in_a_folder_of_any_name() {
    let Some(case) = Case::new("data/13-version-folder") else { return };
    let (shown, _) = case.succeed("info nuscenes:in --json");
    assert_eq!(shown, case.succeed("info nuscenes:in@annotation --json").0);
}

#[test]
fn several_folders_of_tables_are_listed() {
    for name in ["v1.01-train", "v2.0", "annotation", "data"] {
        let log = TinyLog::new();
        std::fs::rename(log.path("log/v1.0-mini"), log.path("log").join(name)).unwrap();
        assert!(log.run("info nuscenes:log").status.success(), "{name}");
        assert!(log.run(&format!("info nuscenes:log@{name}#tiny")).status.success(), "{name}");
    }
    let log = TinyLog::new();
    for name in ["a", "v2.0"] {
        std::fs::create_dir(log.path("log").join(name)).unwrap();
        let tables = std::fs::read_dir(log.path("log/v1.0-mini")).unwrap();
        for table in tables.map(|entry| entry.unwrap().path()).filter(|_| name != "a") {
            std::fs::copy(&table, log.path("log").join(name).join(table.file_name().unwrap())).unwrap();
        }
    }
    let message = "expected @VERSION to name one of v1.0-mini, v2.0, found ";
    assert_failed(&log.run("info nuscenes:log"), 1, &[&format!("{message}none")]);
    assert_failed(&log.run("info nuscenes:log@v3"), 1, &[&format!("{message}v3")]);
    assert_failed(&log.run("info nuscenes:log@a"), 1, &["cannot read", "a/scene.json"]);
    // One folder too far up or down.
    let message = "expected a folder of tables (with scene.json), found ";
    let below = "tables one folder further down, in log/v1.0-mini, log/v2.0";
    assert_failed(&log.run("info nuscenes:."), 1, &[message, below]);
    assert_failed(&log.run("info nuscenes:log/v2.0"), 1, &[message, "scene.json in the folder itself"]);
    assert_failed(&log.run("info nuscenes:log/a"), 1, &[&format!("{message}none")]);
}
