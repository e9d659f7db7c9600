//! Copies of a data set with generated images: `generate --dataset`, `--generated-only`, several clips.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use glam::DVec3;
use point_skeleton::Log;
use point_skeleton::dataset::{LogLocator, nuscenes};
use pskel_generate::{CopiedLog, DatasetCopy, ImageCounts, SampleCounts};
use serde_json::{Value, json};

use crate::simulate::built;
use crate::simulate::generated::denoiser;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FIRST_US, STEP_US, TinyLog, assert_failed, tree};

/// One reference, then two generated frames.
const FILL: &str =
    "generate nuscenes:log --skeleton sk --rasterizer cpu --maps color --generator fill --window 2";

fn records(log: &TinyLog, table: &str) -> Vec<Value> {
    let Value::Array(records) = log.json(&format!("copy/v1.0-mini/{table}.json")) else { panic!("{table}") };
    records
}

fn fields<'a>(records: &'a [Value], field: &str) -> Vec<&'a str> {
    records.iter().map(|record| record[field].as_str().unwrap()).collect()
}

#[test]
fn generated_samples_alone_are_a_data_set() {
    let log = built();
    let output = log.run(&format!("{FILL} --out out --dataset copy --generated-only"));
    let printed = String::from_utf8(output.stdout).unwrap();
    let said = "2 generated samples of 1 scenes, nothing else: copy";
    assert_eq!(printed.lines().last(), Some(said), "{printed}");
    let samples = records(&log, "sample");
    assert_eq!(fields(&samples, "token"), ["s1", "s2"]);
    assert_eq!((fields(&samples, "prev"), fields(&samples, "next")), (vec!["", "s1"], vec!["s2", ""]));
    let scene = &records(&log, "scene")[0];
    assert_eq!(scene["nbr_samples"], 2);
    assert_eq!((&scene["first_sample_token"], &scene["last_sample_token"]), (&json!("s1"), &json!("s2")));
    let boxes = records(&log, "sample_annotation");
    assert_eq!(fields(&boxes, "token"), ["a1car", "a1cone", "a2car", "a2cone"]);
    assert_eq!(fields(&boxes, "prev"), ["", "", "a1car", "a1cone"]);
    assert_eq!(fields(&boxes, "next"), ["a2car", "a2cone", "", ""]);
    for instance in records(&log, "instance") {
        let ends = ["first", "last"].map(|end| instance[format!("{end}_annotation_token")].as_str().unwrap());
        let track = instance["token"].as_str().unwrap();
        assert_eq!(ends, [format!("a1{track}"), format!("a2{track}")]);
        assert_eq!(instance["nbr_annotations"], 2);
    }
    let data = records(&log, "sample_data");
    assert_eq!(fields(&data, "sample_token"), ["s1", "s1", "s1", "s2", "s2", "s2"]);
    let before = ["", "", "", "d1LIDAR_TOP", "d1CAM_FRONT", "d1CAM_BACK"];
    assert_eq!(fields(&data, "prev"), before);
    assert_eq!(fields(&records(&log, "ego_pose"), "token"), ["e1", "e2"]);
    assert_eq!(records(&log, "sensor").len(), 3);
    // Only their files are there: generated images, and links to sweeps.
    let files: BTreeSet<String> = tree(&log.path("copy")).into_keys().collect();
    let others: Vec<&String> = files.iter().filter(|name| !name.ends_with(".json")).collect();
    let mut expected: Vec<String> = fields(&data, "filename").iter().map(|&name| name.to_owned()).collect();
    expected.sort();
    assert_eq!(others, expected.iter().collect::<Vec<_>>());
    assert!(log.path("copy/samples/1.pcd.bin").is_symlink());
    for camera in CAMERAS {
        let path = log.path(&format!("copy/samples/1-{camera}.png"));
        assert!(!path.is_symlink());
        assert_ne!(bytes(&path), bytes(&log.path(&format!("log/samples/1-{camera}.png"))));
    }
    let sample = |number: i64| {
        let image = |camera: &str| format!("samples/{number}-{camera}.png");
        json!({"token": format!("s{number}"), "scene": "tiny", "timestamp": FIRST_US + number * STEP_US,
            "images": {"CAM_FRONT": image("CAM_FRONT"), "CAM_BACK": image("CAM_BACK")}})
    };
    let list = json!({"version": "v1.0-mini", "samples": [sample(1), sample(2)]});
    assert_eq!(log.json("copy/generated.json"), list);
    assert_eq!(log.json("copy/v1.0-mini/splits.json"), json!({"generated": ["tiny"]}));
    // `pskel` reads it as any data set.
    assert_eq!(opened(&log, "copy").frames().count(), 2);
    assert_failed(&log.run(&format!("{FILL} --out new --generated-only")), 2, &["--dataset"]);
}

fn opened(log: &TinyLog, folder: &str) -> Log {
    Log::open(log.path(folder).to_str().unwrap()).unwrap()
}

/// Writes both kinds of copies with the rollouts of some clips.
fn copied(log: &TinyLog, clips: &[&str]) -> (ImageCounts, SampleCounts) {
    let source = LogLocator::new(&nuscenes::FORMAT, log.path("log"));
    let opened = opened(log, "log");
    let rollouts: Vec<PathBuf> = clips.iter().map(|clip| log.path(clip)).collect();
    let logs: Vec<CopiedLog<'_>> =
        rollouts.iter().map(|rollout| CopiedLog { log: opened.recording(), rollout }).collect();
    let open = |name: &str| DatasetCopy::open(&source, &log.path(name), None).unwrap();
    (open("all").write(&logs).unwrap(), open("copy").write_generated(&logs).unwrap())
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

#[test]
fn the_earlier_clip_fills_a_sample_that_several_have() {
    let log = built();
    // The first clip has frames 1 and 2, the second one frame 2 by another network.
    log.succeed(&format!("{FILL} --out one"));
    denoiser(&log, "");
    let (other, start) = (FILL.replace("fill", "process:./denoiser.sh"), FIRST_US + STEP_US);
    log.succeed(&format!("{other} --out two --start {start}"));
    let (all, only) = copied(&log, &["one", "two"]);
    assert_eq!(all, ImageCounts { replaced: 4, retained: 2, doubled: 2, sweeps: 0 });
    assert_eq!(all.to_string(), "4 images replaced, 2 kept, 2 left out (an earlier one is in the same file)");
    assert_eq!(only, SampleCounts { samples: 2, scenes: 1, doubled: 1 });
    let image = |copy: &str, frame: usize| bytes(&log.path(&format!("{copy}/samples/{frame}-CAM_FRONT.png")));
    let first = image("all", 2);
    assert_eq!(first, image("copy", 2));
    let (all, only) = copied(&log, &["two", "one"]);
    assert_eq!(all, ImageCounts { replaced: 4, retained: 2, doubled: 2, sweeps: 0 });
    // Frame 1 of the first clip fills a sample that the other clip has not.
    assert_eq!(only, SampleCounts { samples: 2, scenes: 1, doubled: 1 });
    assert_ne!(image("copy", 2), first);
}

#[test]
fn samples_that_share_an_image_are_counted() {
    let log = built();
    let data = log.json("log/v1.0-mini/sample_data.json");
    let front = |sample: &str| {
        let is =
            |row: &Value| row["sample_token"] == sample && row["calibrated_sensor_token"] == "cCAM_FRONT";
        data.as_array().unwrap().iter().position(is).unwrap()
    };
    log.change("sample_data", &format!("/{}/filename", front("s2")), json!("samples/1-CAM_FRONT.png"));
    log.succeed(&format!("{FILL} --out one"));
    let (all, only) = copied(&log, &["one"]);
    assert_eq!(all, ImageCounts { replaced: 3, retained: 2, doubled: 1, sweeps: 0 });
    assert_eq!(only, SampleCounts { samples: 1, scenes: 1, doubled: 1 });
    assert_eq!(fields(&records(&log, "sample"), "token"), ["s1"]);
    assert_eq!(records(&log, "sample")[0]["next"], "");
}

/// The rollout's sweeps replace the recorded ones at generated frames, in the frame of the recorded LiDAR.
#[test]
fn copies_have_the_sweeps_of_the_rollout() {
    let log = built();
    let device = json!({"name": "top", "elevations_deg": [-20.0, -10.0, -4.0, 0.0], "columns": 90,
        "range_m": [1.0, 80.0]});
    std::fs::write(log.path("top.json"), json!({ "devices": [device] }).to_string()).unwrap();
    let fill = format!("{FILL} --lidar top.json --dataset copy");
    let output = log.run(&format!("{fill} --out out"));
    let printed = String::from_utf8(output.stdout).unwrap();
    let said = "4 images replaced, 2 kept, 2 LiDAR sweeps replaced: copy";
    assert_eq!(printed.lines().last(), Some(said), "{printed}");
    assert!(log.path("copy/samples/0.pcd.bin").is_symlink(), "the sweep of the reference frame");
    let (copy, recorded) = (opened(&log, "copy"), opened(&log, "log"));
    for (frame, step) in [(1, "000001"), (2, "000002")] {
        let sweep = |log: &Log| {
            let record = log.recording().frames[frame].sweeps.iter().find(|record| record.is_key).unwrap();
            let found = log.reader().read_sweep(record).unwrap();
            (record.ego_from_lidar, found.points)
        };
        let (ego_from_lidar, found) = sweep(&copy);
        let bytes = std::fs::read(log.path(&format!("out/steps/{step}/lidar.pcd.bin"))).unwrap();
        let number = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert!(found.len() > 50 && bytes.len() == 20 * found.len(), "{}", found.len());
        assert_ne!(found, sweep(&recorded).1);
        for (i, point) in found.iter().enumerate() {
            let expected = [0, 4, 8].map(|at| f64::from(number(20 * i + at)));
            let place = ego_from_lidar.transform_point(DVec3::from(point.position.map(f64::from)));
            assert!(place.distance(expected.into()) < 1e-4, "{place} {expected:?}");
            assert_eq!(f32::from(point.ring), number(20 * i + 16));
        }
    }
    let pcd = log.run(&format!("{fill} --out other --lidar-format pcd"));
    assert_failed(&pcd, 2, &["expected --lidar-format bin with a copy of the data set, found pcd"]);
}
