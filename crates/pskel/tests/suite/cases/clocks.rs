//! Clocks and calibration that contradict the rest of a log.

use arrow_array::Int64Array;
use serde_json::{Value, json};

use super::Case;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FIRST_US, FRAMES, STEP_US, TinyLog};
use pskel_testing::av2_log::{TinyAv2, integers};
use pskel_testing::nuplan_log::NuplanLog;

const HOUR_US: i64 = 3_600_000_000;

/// Runs a description and a build that must fail, and returns their messages.
#[track_caller]
fn refused(case: &Case, name: &str) -> [String; 2] {
    [format!("info nuscenes:in/{name}"), format!("build nuscenes:in/{name} --out none")].map(|args| {
        let ended = case.run(&args);
        assert_eq!(ended.code, Some(1), "{args}: {}", ended.stderr);
        ended.stderr
    })
}

#[test]
fn rejects_key_frames_with_another_clock_than_their_sample() {
    let Some(case) = Case::new("data/17-lidar-clock") else { return };
    case.succeed("build nuscenes:in/right --out right");
    let report = &case.json("right/skeleton.json");
    let actors = report["actors"].as_array().unwrap();
    let points: u64 = actors.iter().map(|actor| actor["points"].as_u64().unwrap()).sum();
    assert_eq!((actors.len(), points), (75, 14_766));
    let data = case.json("in/right/v1.0-mini/sample_data.json");
    for (name, cause) in
        [("milliseconds", "milliseconds instead of"), ("an-hour-late", "3600.000 s later (1 h")]
    {
        for message in refused(&case, name) {
            let record = data
                .as_array()
                .unwrap()
                .iter()
                .find(|record| message.contains(record["token"].as_str().unwrap()));
            assert!(
                record.is_some_and(|record| record["filename"].as_str().unwrap().contains("LIDAR")),
                "{message}"
            );
            for part in [cause, "LIDAR_TOP", "sample_data.json", "within a second of their sample"] {
                assert!(message.contains(part), "{message} without {part}");
            }
        }
    }
}

/// Times of sweeps, images or samples of a tiny log, changed by a function.
fn change_times(log: &TinyLog, table: &str, kind: &str, of: impl Fn(i64) -> i64) {
    let records = log.json(&format!("log/v1.0-mini/{table}.json"));
    for (i, record) in records.as_array().unwrap().iter().enumerate() {
        if record["token"].as_str().unwrap().contains(kind) {
            let t_us = record["timestamp"].as_i64().unwrap();
            log.change(table, &format!("/{i}/timestamp"), json!(of(t_us)));
        }
    }
}

/// Moves all times of a tiny log to the present, so that units are told apart.
fn modern() -> TinyLog {
    let log = TinyLog::new();
    for table in ["sample", "sample_data"] {
        change_times(&log, table, "", |t_us| t_us - FIRST_US + 1_557_539_956_000_000);
    }
    log
}

#[test]
fn rejects_other_clocks_of_samples_sweeps_and_images() {
    type Change = fn(i64) -> i64;
    let changes: [(&str, &str, Change, &str); 8] = [
        ("sample_data", "LIDAR", |t| t / 1_000_000, "seconds instead of microseconds"),
        ("sample_data", "LIDAR", |t| t - HOUR_US, "3600.000 s earlier (1 h"),
        ("sample_data", "CAM_BACK", |t| t / 1000, "milliseconds instead"),
        ("sample_data", "CAM_FRONT", |t| t + 9 * HOUR_US, "(9 h, another time zone?)"),
        ("sample_data", "LIDAR", |t| t + 18_000_000, "GPS time"),
        ("sample", "", |t| t - HOUR_US, "3600.000 s later"),
        ("sample_data", "LIDAR", |_| 1_557_539_956_500_000, "grow from sample to sample"),
        ("sample_data", "CAM", |_| 1_557_539_956_500_000, "grow from sample to sample"),
    ];
    for (table, kind, change, found) in changes {
        let log = modern();
        change_times(&log, table, kind, change);
        log.fail("build nuscenes:log --out out/sk", 1, &[found, "sample_data d", "sample_data.json"]);
    }
    // Nanoseconds are refused as no time at all.
    let log = modern();
    change_times(&log, "sample_data", "LIDAR", |t| t * 1000);
    log.fail("build nuscenes:log --out out/sk", 1, &["a thousand years from 1970", "sample_data.json"]);
    // Differences of clocks are usual.
    let log = modern();
    change_times(&log, "sample_data", "LIDAR", |t| t + 20_000);
    change_times(&log, "sample_data", "CAM", |t| t - 60_000);
    log.succeed("build nuscenes:log --out out/sk");
}

#[test]
fn ego_poses_of_another_time_are_noted() {
    let log = TinyLog::new();
    for i in 0..FRAMES {
        let t_us = FIRST_US + STEP_US * i as i64;
        log.change("ego_pose", &format!("/{i}"), {
            let mut pose = log.json("log/v1.0-mini/ego_pose.json")[i].clone();
            pose["timestamp"] = json!(if i == 1 { t_us + HOUR_US } else { t_us });
            pose
        });
    }
    for args in ["info nuscenes:log", "build nuscenes:log --out out/sk"] {
        let output = log.run(args);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("ego_pose e1 is 3600.000 s later (1 h"), "{text}");
    }
}

#[test]
fn frames_of_another_unit_are_noted() {
    let log = TinyLog::new();
    for table in ["sample", "sample_data"] {
        change_times(&log, table, "", |t_us| t_us / 1000);
    }
    let text = String::from_utf8(log.run("info nuscenes:log").stdout).unwrap();
    assert!(text.contains("frames 0.0005 s apart (are their times microseconds?): 3"), "{text}");
}

#[test]
fn key_frames_with_another_time_than_their_frame_are_noted() {
    for (kind, offset_us, text) in [
        (
            "LIDAR",
            400_000,
            "3 key frames of LIDAR_TOP of another time than their boxes (used; median 0.400 s later)",
        ),
        (
            "CAM_BACK",
            -150_000,
            "3 key frames of CAM_BACK of another time than their boxes (used; median 0.150 s earlier)",
        ),
    ] {
        let log = modern();
        change_times(&log, "sample_data", kind, |t| t + offset_us);
        let summary = log.succeed("build nuscenes:log --out out/sk");
        assert!(summary.contains(text) && summary.matches("of another time than").count() == 1, "{summary}");
    }
    // A rotation of a LiDAR lies between.
    let log = modern();
    change_times(&log, "sample_data", "CAM", |t| t - 100_000);
    let summary = log.succeed("build nuscenes:log --out out/sk");
    assert!(!summary.contains("of another time than"), "{summary}");
}

#[test]
fn notes_if_no_box_has_a_point() {
    let log = TinyLog::new();
    let note = "boxes of a log of which none has a colored point";
    assert!(!log.succeed("build nuscenes:log --out out/usual").contains(note));
    let boxes = log.json("log/v1.0-mini/sample_annotation.json").as_array().unwrap().len();
    for i in 0..boxes {
        log.change("sample_annotation", &format!("/{i}/translation/2"), json!(90.0));
    }
    let summary = log.succeed("build nuscenes:log --out out/sk");
    assert!(summary.contains(&format!("{boxes} {note}")), "{summary}");
}

#[test]
fn units_are_named_in_all_tables() {
    // All times of the log.
    let all = |of: &dyn Fn(i64) -> i64| {
        let log = modern();
        ["sample", "sample_data"].iter().for_each(|table| change_times(&log, table, "", of));
        let output = log.run("info nuscenes:log");
        String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
    };
    let text = all(&|t| t / 1_000_000);
    assert!(text.contains("seconds instead of microseconds?") && text.contains("in sample s"), "{text}");
    assert!(all(&|t| t * 1000).contains("nanoseconds instead of microseconds?"));
    let text = all(&|t| t / 1000);
    assert!(text.contains("frames 0.0005 s apart (milliseconds instead of microseconds?): 3"), "{text}");

    let nuplan = NuplanLog::new();
    nuplan.sql("UPDATE lidar_pc SET timestamp = timestamp / 1000000");
    nuplan.refuses(&["frame to frame", "(seconds instead of microseconds?)"]);
    let nuplan = NuplanLog::new();
    nuplan.sql("UPDATE image SET timestamp = timestamp * 1000");
    nuplan.refuses(&["of 1970", "(nanoseconds instead of microseconds?)"]);

    let times = |table: &str, divisor: i64| {
        let log = TinyAv2::new();
        log.edit(table, |columns| {
            let (_, column) = columns.iter_mut().find(|(name, _)| name == "timestamp_ns").unwrap();
            let times: &Int64Array = column.as_any().downcast_ref().unwrap();
            *column = integers(times.values().iter().map(|t_ns| t_ns / divisor).collect());
        });
        log
    };
    let seconds = "(seconds instead of nanoseconds?)";
    times("annotations.feather", 1_000_000_000).refuses(&["two of ", seconds], "annotations.feather");
    times("city_SE3_egovehicle.feather", 1_000_000_000).refuses(&["grow", seconds], "egovehicle.feather");
    let micros = "(microseconds instead of nanoseconds?)";
    times("annotations.feather", 1000).refuses(&["the first", micros], "annotations.feather");
}

#[test]
fn unused_distortion_coefficients_are_noted_or_applied() {
    let Some(case) = Case::new("data/06-distorted-images") else { return };
    let note =
        "6 cameras with camera_distortion, whose images are read as rectified (--image-distortion apply";
    let (stdout, _) = case.succeed("build nuscenes:in --out usual");
    assert!(stdout.contains(note), "{stdout}");
    let (stdout, _) = case.succeed("info nuscenes:in");
    assert!(stdout.contains("--image-distortion apply if they are not): 6"), "{stdout}");
    let render = "render nuscenes:in --skeleton usual --out maps --frames 0..1 --size 54x96 --rasterizer cpu";
    let (_, stderr) = case.succeed(render);
    assert!(stderr.contains(note), "{stderr}");
    let (ignored, _) = case.succeed("build nuscenes:in --out ignored --image-distortion ignore");
    assert!(!ignored.contains("camera_distortion"), "{ignored}");
    let (applied, _) = case.succeed("build nuscenes:in --out applied --image-distortion apply");
    assert!(!applied.contains("camera_distortion"), "{applied}");
    let clouds = |name: &str| case.json(&format!("{name}/skeleton.json"))["background"].clone();
    assert_eq!(clouds("ignored"), clouds("usual"));
    assert_ne!(clouds("applied"), clouds("usual"));
}

/// Returns a tiny log whose cameras have distortion coefficients.
fn distorted(coefficients: &Value) -> TinyLog {
    let log = TinyLog::new();
    let table = log.json("log/v1.0-mini/calibrated_sensor.json");
    for (i, record) in table.as_array().unwrap().iter().enumerate() {
        let mut record = record.clone();
        record["camera_distortion"] = coefficients.clone();
        log.change("calibrated_sensor", &format!("/{i}"), record);
    }
    log
}

#[test]
fn coefficients_of_any_form_are_noted_and_applied_only_if_valid() {
    for (coefficients, applies) in [
        (json!([-0.3, 0.1, 0.0, 0.0]), true),
        (json!([-0.3, 0.1, 0.0, 0.0, 0.01]), true),
        (json!([-0.3, 0.1, 0.0, 0.0, 0.01, 0.2]), false),
        (json!([-0.3, null, 0.0, 0.0, 0.01]), false),
        (json!([-0.3]), false),
        (json!("plumb_bob"), false),
    ] {
        let log = distorted(&coefficients);
        let summary = log.succeed("build nuscenes:log --out out/sk");
        assert!(summary.contains("2 cameras with camera_distortion"), "{coefficients}: {summary}");
        if applies {
            let summary = log.succeed("build nuscenes:log --out out/applied --image-distortion apply");
            assert!(!summary.contains("camera_distortion"), "{summary}");
        } else {
            let output = log.run("build nuscenes:log --out out/applied --image-distortion apply");
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            let found = format!("found {coefficients} in calibrated_sensor c");
            assert!(message.contains(&found) && message.contains("calibrated_sensor.json"), "{message}");
        }
    }
    for coefficients in [json!([]), json!([0, 0, 0, 0, 0]), json!(null)] {
        let summary =
            distorted(&coefficients).succeed("build nuscenes:log --out out/sk --image-distortion apply");
        assert!(!summary.contains("camera_distortion"), "{summary}");
    }
}

#[test]
fn data_marked_as_invalid_is_not_used() {
    let log = TinyLog::new();
    let table = log.json("log/v1.0-mini/sample_data.json");
    let place = table.as_array().unwrap().iter().position(|r| r["token"] == "d1CAM_BACK").unwrap();
    let mut record = table[place].clone();
    record["is_valid"] = json!(false);
    log.change("sample_data", &format!("/{place}"), record.clone());
    // What is marked as invalid may be missing or damaged.
    std::fs::write(log.path("log/samples/1-CAM_BACK.png"), "").unwrap();
    let summary = log.succeed("build nuscenes:log --out out/sk");
    assert!(summary.contains("1 sweeps and images that are marked as invalid"), "{summary}");
    assert_eq!(log.json("out/sk/skeleton.json")["report"]["images"], json!(2 * FRAMES - 1));
    record["is_valid"] = json!(true);
    log.change("sample_data", &format!("/{place}"), record);
    assert!(!log.run("build nuscenes:log --out out/all --missing error").status.success());
}
