//! Exports replace no files of others, and take no shards of other recordings or options.

use std::os::unix::fs::symlink;
use std::process::Command;

use serde_json::{Value, json};

use super::outputs::{EXPORT, assert_refused};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FIRST_US, STEP_US, TinyLog, assert_failed, tree};
use crate::untrusted::guarded;

#[test]
fn exports_do_not_replace_foreign_files() {
    for (layout, file) in [
        ("webdataset", "tiny-000000.tar"),
        ("mcap", "tiny-000000.mcap"),
        ("alpasim", "tiny.usdz"),
        ("frames", "tiny/000001/CAM_FRONT/color.png"),
        ("opendwm-preview", "tiny-000000/data.json"),
        ("pas-cache", "proj_clr/d1CAM_BACK.png"),
        ("world-scenario", "tiny-000000/obstacle/x.parquet"),
        ("cosmos-video", "captions/ftheta_camera_front_wide_120fov/tiny-000000.json"),
    ] {
        let log = TinyLog::new();
        let export = format!("{EXPORT} --layout {layout}");
        let reported = log.succeed(&export);
        let whole = tree(&log.path("out"));
        // The record is lost; the files belong to nobody then.
        let record = log.path("out/shards/tiny-000000.json");
        let record_text = std::fs::read(&record).unwrap();
        let written: Value = serde_json::from_slice(&record_text).unwrap();
        let files: Vec<&str> =
            written["files"].as_array().unwrap().iter().map(|f| f["path"].as_str().unwrap()).collect();
        let file = if files.contains(&file) { file } else { files[0] };
        std::fs::remove_file(&record).unwrap();
        std::fs::write(log.path("out").join(file), "years of work").unwrap();
        let before = tree(&log.path("out"));
        let output = log.run(&export);
        assert_failed(
            &output,
            1,
            &[
                "expected only files that pskel wrote where it is to write, found another file",
                "failed: tiny-000000",
            ],
        );
        assert!(tree(&log.path("out")) == before, "{layout}: {reported}");
        // A folder of the way is a link.
        std::fs::write(&record, &record_text).unwrap();
        let Some((folder, _)) = file.split_once('/') else {
            assert!(matches!(layout, "webdataset" | "mcap" | "alpasim"), "{layout}: {file}");
            continue;
        };
        std::fs::rename(log.path("out").join(folder), log.path("stranger")).unwrap();
        symlink(log.path("stranger"), log.path("out").join(folder)).unwrap();
        let before = tree(&log.path("stranger"));
        assert_failed(&log.run(&format!("{export} --verify")), 1, &["found a link: out/"]);
        assert!(tree(&log.path("stranger")) == before, "{layout}");
        std::fs::remove_file(log.path("out").join(folder)).unwrap();
        log.succeed(&export);
        assert!(tree(&log.path("out")) == whole, "{layout}");
    }
}

#[test]
fn links_in_an_export_are_not_followed() {
    for name in ["shards", ".unfinished"] {
        let log = TinyLog::new();
        std::fs::create_dir(log.path("stranger")).unwrap();
        log.succeed(&format!("{EXPORT} --layout webdataset"));
        std::fs::remove_dir_all(log.path("out/shards")).unwrap();
        std::fs::remove_file(log.path("out/tiny-000000.tar")).unwrap();
        symlink("../stranger", log.path("out").join(name)).unwrap();
        assert_failed(&log.run(&format!("{EXPORT} --layout webdataset")), 1, &["found a link: out/"]);
        assert_eq!(std::fs::read_dir(log.path("stranger")).unwrap().count(), 0, "{name}");
    }
}

#[test]
fn exports_of_other_frames_or_shards_are_refused() {
    let log = TinyLog::new();
    let export = |more: &str| format!("{EXPORT} --layout webdataset {more}");
    log.succeed(&export("--frames 0..2 --shard-frames 2"));
    for (more, part) in [
        ("--frames 0..2 --shard-frames 1", "--shard-frames 1, found --shard-frames 2"),
        ("--frames 0..3 --shard-frames 2", "--frames [0,3], found --frames [0,2]"),
        ("--shard-frames 2", "--frames default, found --frames [0,2]"),
        ("--frames 0..2 --shard-frames 2 --radius 50", "--radius 50.0, found"),
        ("--frames 0..2 --shard-frames 2 --map-layers dividers", "--line-width or --map-layers {"),
        ("--frames 0..2 --shard-frames 2 --images", "--images true, found --images false"),
    ] {
        assert_refused(&log, &export(more), part);
    }
    let layout = export("--frames 0..2 --shard-frames 2").replace("webdataset", "frames");
    assert_refused(&log, &layout, r#"--layout "frames", found --layout "webdataset""#);
    log.succeed(&export("--frames 0..2 --shard-frames 2 --only 0/1"));
    // An export of an earlier version has no fingerprints of its input.
    let mut earlier = log.json("out/export.json");
    earlier.as_object_mut().unwrap().remove("records");
    std::fs::write(log.path("out/export.json"), earlier.to_string()).unwrap();
    assert_refused(
        &log,
        &export("--frames 0..2 --shard-frames 2"),
        "found one of an earlier version; keep it, and export to another folder",
    );
}

/// Another recording with the same name: other poses, boxes, cameras, categories, times, or points. Stated
/// numbers of points are not part of a recording.
#[test]
fn rejects_shards_and_skeletons_of_another_recording() {
    let changes: [(&str, &str, Value); 7] = [
        ("ego_pose", "/1/translation/0", json!(664_002.5)),
        ("sample", "/1/timestamp", json!(FIRST_US + STEP_US + 1000)),
        ("sample_annotation", "/0/size/0", json!(2.5)),
        ("calibrated_sensor", "/1/camera_intrinsic/0/0", json!(30.0)),
        ("category", "/0/name", json!("human.pedestrian.adult")),
        ("instance", "/0/token", Value::Null),
        ("sample_annotation", "/0/num_lidar_pts", json!(2)),
    ];
    for (table, pointer, value) in changes {
        let log = TinyLog::new();
        let export = format!("{EXPORT} --layout webdataset");
        log.succeed(&export);
        let whole = tree(&log.path("out"));
        let shards = tree(&log.path("out/shards"));
        let is_same = pointer.ends_with("pts");
        if value.is_null() {
            // A point of a sweep: only the skeleton differs.
            let path = log.path("log/samples/1.pcd.bin");
            let mut sweep = std::fs::read(&path).unwrap();
            sweep[2] ^= 0x40;
            std::fs::write(&path, sweep).unwrap();
            std::fs::remove_dir_all(log.path("sks")).unwrap();
            log.succeed("build nuscenes:log --out sks/tiny");
        } else {
            log.change(table, pointer, value);
        }
        let output = log.run(&export);
        if is_same {
            assert!(output.status.success() && tree(&log.path("out")) == whole);
            continue;
        }
        assert_failed(
            &output,
            1,
            &["failed: tiny-000000: expected a shard of this", "use another folder, or --verify"],
        );
        assert!(tree(&log.path("out/shards")) == shards, "{table}");
        if table != "instance" {
            // The skeleton of the other recording is not taken either.
            let verified = log.run(&format!("{export} --verify"));
            assert_failed(&verified, 1, &["expected a skeleton of the recording tiny", "sks/tiny"]);
            let other = log.run(&export.replace("--out out", "--out new"));
            assert_failed(&other, 1, &["expected a skeleton of the recording tiny", "sks/tiny"]);
            std::fs::remove_dir_all(log.path("sks")).unwrap();
        }
        log.succeed(&format!("{export} --verify"));
        log.succeed(&export.replace("--out out", "--out fresh"));
        assert!(tree(&log.path("out")) == tree(&log.path("fresh")), "{table}");
    }
}

#[test]
fn malformed_records_neither_hang_nor_count() {
    let log = TinyLog::new();
    let export = format!("{EXPORT} --layout webdataset");
    log.succeed(&export);
    let whole = tree(&log.path("out"));
    let record = log.path("out/shards/tiny-000000.json");
    let args: Vec<&str> = export.split_whitespace().collect();
    for path in [record.as_path(), &log.path("out/export.json"), &log.path("out/index.json")] {
        let bytes = std::fs::read(path).unwrap();
        std::fs::remove_file(path).unwrap();
        assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
        let ended = guarded::run(&log.path(""), &args);
        ended.refused(&path.display().to_string(), &[]);
        assert!(
            ended.stderr.contains("found a FIFO") || ended.stderr.contains("found a device or pipe"),
            "{}",
            ended.stderr
        );
        std::fs::remove_file(path).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    // Without files, the shard is written again.
    let mut empty = log.json("out/shards/tiny-000000.json");
    empty["files"] = json!([]);
    std::fs::remove_file(log.path("out/tiny-000000.tar")).unwrap();
    std::fs::write(&record, empty.to_string()).unwrap();
    assert!(log.succeed(&export).starts_with("wrote 1 shards"));
    assert!(tree(&log.path("out")) == whole);
    // Files elsewhere are neither taken nor replaced.
    let mut outside = log.json("out/shards/tiny-000000.json");
    outside["files"][0]["path"] = json!("../log/v1.0-mini/scene.json");
    std::fs::write(&record, outside.to_string()).unwrap();
    assert_refused(&log, &export, "expected paths below the export");
    // Another program's file in the place of the index.
    std::fs::write(&record, &whole["shards/tiny-000000.json"]).unwrap();
    std::fs::write(log.path("out/index.json"), "{\"mine\": 1}").unwrap();
    assert_refused(&log, &export, "expected the index of an export to replace");
}
