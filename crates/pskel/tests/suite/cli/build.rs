//! `pskel build` and `pskel convert` through the command line.

use std::process::Command;

use point_skeleton::cloud;
use point_skeleton::dataset::SweepPoint;
use point_skeleton::dataset::nuscenes::write_sweep_file;
use point_skeleton::skeleton::{Skeleton, TemplateKind};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FRAMES, PSKEL, TinyLog, assert_failed, picture, sweep, tree};

const BUILD: &str = "build nuscenes:log --out out/sk";

#[test]
fn builds_a_skeleton_and_accounts_for_every_point() {
    let log = TinyLog::new();
    let summary = log.succeed(BUILD);
    assert!(summary.starts_with("built tiny from 3 frames") && summary.contains("dropped"), "{summary}");
    let manifest = log.json("out/sk/skeleton.json");
    let report = manifest["report"].as_object().unwrap();
    let count = |name: &str| report[name].as_u64().unwrap();
    let dropped: u64 =
        report.iter().filter(|(n, _)| n.starts_with("dropped")).map(|(_, c)| c.as_u64().unwrap()).sum();
    assert_eq!(dropped + count("background_points") + count("actor_points"), count("points_read"));
    assert_eq!((count("sweeps"), count("images")), (FRAMES as u64, (FRAMES * CAMERAS.len()) as u64));
    assert_eq!(manifest["sources"][0]["log"], "tiny");
    let tracks: Vec<_> = manifest["actors"].as_array().unwrap().iter().map(|a| a["track"].clone()).collect();
    assert_eq!(tracks, ["car", "cone"]);
    assert_eq!(manifest["actors"][0]["sweeps"], 3);
    // A single frame; then every other frame.
    log.succeed("build nuscenes:log --out out/sk --frames 1..2 --voxel 0 --box-margin 0.2");
    let one = log.json("out/sk/skeleton.json");
    assert_eq!((&one["sources"][0]["frames"], &one["options"]["voxel_m"]), (&json!(1), &json!(0.0)));
    assert_eq!(one["options"]["split"]["margin_m"], 0.2);
    // Actor points are retained, background points merged.
    log.succeed("build nuscenes:log --out out/sk --voxel 0.5 --actor-voxel 0");
    let mixed = log.json("out/sk/skeleton.json");
    let points = |of: &str| {
        mixed[of].as_array().unwrap().iter().map(|part| part["points"].as_u64().unwrap()).sum::<u64>()
    };
    assert_eq!(points("actors"), mixed["report"]["actor_points"].as_u64().unwrap());
    assert!(points("background") < mixed["report"]["background_points"].as_u64().unwrap());
    log.succeed("build nuscenes:log --out out/sk --every 2 --coloring every-camera --sweeps");
    assert_eq!(log.json("out/sk/skeleton.json")["sources"][0]["frames"], 2);
    assert_eq!(std::fs::read_dir(log.path("out")).unwrap().count(), 1);
}

#[test]
fn builds_are_identical_for_any_number_of_threads() {
    let log = TinyLog::new();
    assert!(log.run_with(BUILD, "1").status.success());
    let first = tree(&log.path("out/sk"));
    for threads in ["1", "2"] {
        assert!(log.run_with("build nuscenes:log --out out/again", threads).status.success());
        assert!(first == tree(&log.path("out/again")), "{threads} threads");
    }
    assert_eq!(first.len(), 7);
}

#[test]
fn damaged_logs_are_errors_that_leave_nothing() {
    let damage = |break_it: &dyn Fn(&TinyLog), parts: &[&str]| {
        let log = TinyLog::new();
        break_it(&log);
        log.fail(&format!("{BUILD} --missing error"), 1, parts);
    };
    let cut = |log: &TinyLog| {
        let file = std::fs::OpenOptions::new().write(true).open(log.path(&sweep(1))).unwrap();
        file.set_len(1234).unwrap();
    };
    damage(&cut, &["1.pcd.bin", "a multiple of 20 bytes", "found 1234 bytes"]);
    damage(&|log| std::fs::write(log.path(&sweep(2)), "").unwrap(), &["2.pcd.bin", "an empty file"]);
    let image = picture(1, CAMERAS[1]);
    damage(
        &|log| std::fs::remove_file(log.path(&image)).unwrap(),
        &["1-CAM_BACK.png", "missing image files"],
    );
    damage(
        &|log| std::fs::write(log.path(&image), "no image").unwrap(),
        &["1-CAM_BACK.png", "a JPEG or PNG"],
    );
    let table = |log: &TinyLog| std::fs::remove_file(log.path("log/v1.0-mini/ego_pose.json")).unwrap();
    damage(&table, &["ego_pose.json", "cannot read"]);
    damage(
        &|log| log.change("sample_data", "/4/ego_pose_token", json!("gone")),
        &["ego_pose.json", "whose ego_pose gone is missing", "d1CAM_FRONT"],
    );
    damage(
        &|log| log.change("sample_annotation", "/2/size/1", json!(0.0)),
        &["sample_annotation.json", "boxes without a size", "a1car"],
    );
    damage(
        &|log| log.change("sample_annotation", "/2/size/1", json!(-4.0)),
        &["sample_annotation.json", "boxes without a size", "a1car"],
    );
    damage(
        &|log| log.change("ego_pose", "/1/rotation/0", json!(0.5)),
        &["ego_pose.json", "a unit quaternion", "found length 0.5"],
    );
    damage(
        &|log| log.change("calibrated_sensor", "/1/camera_intrinsic/1/1", json!(0.0)),
        &["calibrated_sensor.json", "invertible intrinsics", "fy 0"],
    );
    damage(
        &|log| log.change("sample_annotation", "/2/instance_token", json!("nobody")),
        &["instance.json", "whose instance nobody is missing", "a1car"],
    );
    damage(
        &|log| log.change("sample", "/1/next", json!("nowhere")),
        &["sample.json", "token nowhere, found none"],
    );
    damage(&|log| log.change("sample", "/2/timestamp", json!(1)), &["sample.json", "expected", "found"]);
    damage(
        &|log| std::fs::write(log.path("log/v1.0-mini/sensor.json"), "[{\n\"token\": 5}]").unwrap(),
        &["sensor.json", "a JSON array of sensor records", "found 5 instead of text in [0].token"],
    );
    let above = SweepPoint { position: [3.0, 0.0, 100.0], intensity: 1.0, ring: 0 };
    let unseen =
        |log: &TinyLog| (0..FRAMES).for_each(|i| write_sweep_file(&log.path(&sweep(i)), &[above]).unwrap());
    damage(&unseen, &["at least one point that an image colors", "3 sweeps (3 points read)"]);
    let version = |log: &TinyLog| {
        std::fs::create_dir(log.path("log/v1.0-x")).unwrap();
        std::fs::write(log.path("log/v1.0-x/scene.json"), "[]").unwrap();
    };
    damage(&version, &["@VERSION", "v1.0-mini, v1.0-x"]);
}

#[test]
fn points_that_are_not_finite_are_dropped_and_counted() {
    let log = TinyLog::new();
    let mut bytes = std::fs::read(log.path(&sweep(0))).unwrap();
    bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    bytes[44..48].copy_from_slice(&f32::INFINITY.to_le_bytes());
    std::fs::write(log.path(&sweep(0)), bytes).unwrap();
    assert!(log.succeed(BUILD).contains("2 not finite"));
    assert_eq!(log.json("out/sk/skeleton.json")["report"]["dropped_not_finite"], 2);
}

#[test]
fn a_file_size_limit_leaves_no_skeleton() {
    let log = TinyLog::new();
    let script = format!("ulimit -f 8; exec '{PSKEL}' {BUILD}");
    let output = Command::new("bash").arg("-c").arg(script).current_dir(log.path("")).output().unwrap();
    assert_failed(&output, 1, &["sk.partial/run-000000.sums", "cannot write"]);
    log.assert_out_is_empty();
}

#[test]
fn wrong_usage_exits_with_2_and_frames_out_of_the_log_with_1() {
    let log = TinyLog::new();
    for (extra, part) in [
        ("--voxel -1", "at least 0.0001"),
        ("--voxel 0.00001", "at least 0.0001"),
        ("--voxel nan", "at least 0.0001"),
        ("--every 0", "--every"),
        ("--frames 2..2", "A..B with A < B"),
        ("--frames x", "A..B with A < B"),
        ("--box-margin -0.1", "0 or more"),
        ("--template van=a.npy", "expected the template sedan, suv"),
        ("--template suv=a.npy --template suv=b.npy", "one --template a kind"),
        ("--no-such-option", "Usage"),
    ] {
        log.fail(&format!("{BUILD} {extra}"), 2, &[part]);
    }
    log.fail("build kitti:log --out out/sk", 2, &["FORMAT:PATH[@VERSION][#SCENE]", "kitti:log"]);
    log.fail(&format!("{BUILD} --frames 1..4"), 1, &["within 0..3, found 1..4"]);
    log.fail(&format!("{BUILD} --template suv=none.npy"), 1, &["none.npy"]);
    log.fail("build nuscenes:none --out out/sk", 1, &["none"]);
    log.fail("build nuscenes:log#other --out out/sk", 1, &["one of tiny, found other", "scene.json"]);
    assert_failed(
        &log.run("build nuscenes:log --out log"),
        1,
        &["expected only files that pskel wrote", "another file: log/samples"],
    );
}

#[test]
fn converted_points_are_read_back() {
    let log = TinyLog::new();
    log.succeed(BUILD);
    log.succeed("convert out/sk --out out/npy");
    log.succeed("convert out/sk --out out/ply --format ply");
    let origins = log.json("out/npy/origins.json");
    let skeleton = Skeleton::open(&log.path("out/sk")).unwrap();
    let background = cloud::read(&log.path("out/npy/background.npy")).unwrap().points;
    assert_eq!(background, cloud::read(&log.path("out/ply/background.ply")).unwrap().points);
    let origin: Vec<f64> = serde_json::from_value(origins["background"]["origin"].clone()).unwrap();
    let chunks = skeleton.manifest.background.iter().zip(skeleton.background().unwrap());
    let expected = chunks.flat_map(|(c, points)| points.iter().map(|p| (c.origin, *p)));
    for (point, (chunk, source)) in background.iter().zip(expected) {
        for axis in 0..3 {
            let global = chunk[axis] + f64::from(source.position[axis]);
            assert!((origin[axis] + f64::from(point.position[axis]) - global).abs() < 1e-5);
        }
        assert_eq!(point.rgb(), source.rgb());
    }
    assert_eq!(origins["actors"][0]["file"], "actors/car.npy");
    let car = cloud::read(&log.path("out/npy/actors/car.npy")).unwrap().points;
    assert_eq!(car.len(), skeleton.manifest.actors[0].points);
    // Converts a file to the other format and back.
    log.succeed("convert out/npy/actors/car.npy --out out/car.ply");
    log.succeed("convert out/car.ply --out out/car.npy");
    let bytes = |name: &str| std::fs::read(log.path(name)).unwrap();
    assert_eq!(bytes("out/car.npy"), bytes("out/npy/actors/car.npy"));
    assert_failed(&log.run("convert out/car.npy --out out/car"), 2, &["ending in .npy or .ply"]);
    assert_failed(
        &log.run("convert out/sk --out log"),
        1,
        &["expected only files that pskel wrote", "another file: log/samples"],
    );
}

#[test]
fn a_template_is_centered_and_has_its_kinds_class() {
    let log = TinyLog::new();
    log.succeed(BUILD);
    log.succeed("convert out/sk --out out/npy");
    log.succeed(&format!("{BUILD} --template sedan=out/npy/actors/car.npy"));
    let skeleton = Skeleton::open(&log.path("out/sk")).unwrap();
    let [template] = skeleton.manifest.templates.as_slice() else { panic!("one template") };
    assert_eq!((template.kind, template.points), (TemplateKind::Sedan, skeleton.manifest.actors[0].points));
    for axis in 0..3 {
        assert!((template.bounds.min[axis] + template.bounds.max[axis]).abs() < 1e-5);
    }
    assert!(skeleton.templates().unwrap()[0].iter().all(|p| p.class() == 1));
}

#[test]
fn rejects_too_many_threads() {
    let log = TinyLog::new();
    let output = log.run_with("build nuscenes:log --out out/sk", "100000");
    assert_failed(&output, 2, &["threads in RAYON_NUM_THREADS, found 100000"]);
    log.assert_out_is_empty();
    assert!(log.run_with("build nuscenes:log --out out/sk", "64").status.success());
}
