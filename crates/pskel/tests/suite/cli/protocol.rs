//! `pskel protocol` through the command line.

use serde_json::{Value, json};

use crate::simulate::built;
use crate::simulate::generated::{at_call, denoiser};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FRAMES, TinyLog, assert_failed, picture, tree};

const VAL: &str = "protocol nuscenes-val nuscenes:log#* --other-logs --parts 2hz --skeletons sk --out out \
                   --rasterizer cpu --maps color --window 2 --generator process:./denoiser.sh";

/// Adds a second scene with the same content and images of its own to the tables.
fn add_scene(log: &TinyLog) {
    for table in ["scene", "sample", "sample_data", "ego_pose", "instance", "sample_annotation"] {
        let path = format!("log/v1.0-mini/{table}.json");
        let Value::Array(mut records) = log.json(&path) else { panic!("{table}") };
        for mut record in records.clone() {
            for (key, value) in record.as_object_mut().unwrap() {
                let shared =
                    ["calibrated_sensor_token", "category_token", "log_token"].contains(&key.as_str());
                let is_token = key.ends_with("token") || key == "next";
                match value.as_str() {
                    Some(token) if is_token && !shared && !token.is_empty() => {
                        *value = json!(format!("b{token}"))
                    }
                    Some(name) if key == "name" => *value = json!(format!("{name}-b")),
                    Some(file) if key == "filename" => {
                        let new = file.replace("samples/", "samples/b");
                        std::fs::copy(log.path(&format!("log/{file}")), log.path(&format!("log/{new}")))
                            .unwrap();
                        *value = json!(new);
                    }
                    _ => {}
                }
            }
            records.push(record);
        }
        std::fs::write(log.path(&path), Value::Array(records).to_string()).unwrap();
    }
}

/// Returns a log with two scenes, a denoiser with additional lines, and no output folder.
fn two_scenes(lines: &str) -> TinyLog {
    let log = TinyLog::new();
    std::fs::remove_dir(log.path("out")).unwrap();
    add_scene(&log);
    denoiser(&log, lines);
    log
}

fn table(log: &TinyLog) -> String {
    std::fs::read_to_string(log.path("out/table.md")).unwrap()
}

#[test]
fn scenes_are_generated_scored_and_copied_into_one_data_set() {
    let log = two_scenes("");
    let output = log.run(VAL);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = table(&log);
    assert!(String::from_utf8(output.stdout).unwrap().starts_with(&text));
    // Of 16 frames after one reference, a scene of three frames has two.
    assert!(text.lines().nth(2).unwrap().starts_with("| 2hz | 2 | 4 of 32 | "), "{text}");
    let networks = "FID needs --inception, FVD needs --i3d, IoU needs --segmentor.";
    let logs = "Not comparable with the protocol: 0 of its 150 logs, 2 others.";
    let method = "Method process:./denoiser.sh.";
    assert!(text.ends_with(&format!("\n{method} {logs} {networks}\n")), "{text}");
    let results = log.json("out/results.json");
    assert_eq!(results["logs"], json!({"defined": 150, "present": 0, "other": 2}));
    // Names in the results do not depend on where the output folder is.
    let rollouts = results["parts"][0]["images"]["rollouts"].as_array().unwrap();
    let folders: Vec<&Value> = rollouts.iter().map(|rollout| &rollout["folder"]).collect();
    assert_eq!(folders, ["2hz/tiny", "2hz/tiny-b"]);
    // The table's means equal `evaluate`'s.
    assert!(log.run("evaluate out/2hz/tiny out/2hz/tiny-b --out scores.json").status.success());
    assert_eq!(results["parts"][0]["images"]["mean"], log.json("scores.json")["mean"]);
    // One copy has the images of both scenes.
    let (before, after) = (tree(&log.path("log")), tree(&log.path("out/dataset")));
    assert_eq!(before.keys().collect::<Vec<_>>(), after.keys().collect::<Vec<_>>());
    let mut replaced: Vec<&String> = before.keys().filter(|name| before[*name] != after[*name]).collect();
    replaced.sort();
    let mut expected = Vec::new();
    for (frame, camera) in (1..FRAMES).flat_map(|frame| CAMERAS.map(|camera| (frame, camera))) {
        let own = picture(frame, camera).trim_start_matches("log/").to_owned();
        expected.extend([own.replace("samples/", "samples/b"), own]);
    }
    expected.sort();
    assert_eq!(replaced, expected.iter().collect::<Vec<_>>());
    for scene in ["tiny", "tiny-b"] {
        assert!(log.run(&format!("info nuscenes:out/dataset#{scene}")).status.success());
    }
}

#[test]
fn an_interrupted_protocol_ends_with_the_same_bytes() {
    let only = &format!("{VAL} --generated-only");
    let log = two_scenes("");
    assert!(log.run(only).status.success());
    assert_eq!(log.json("out/dataset/generated.json")["samples"].as_array().unwrap().len(), 4);
    // The network fails in the middle of the second scene.
    let fails = "if os.path.exists('out/2hz/tiny/index.json'): raise SystemExit(3)";
    let broken = two_scenes(&at_call(3, fails));
    let output = broken.run(only);
    assert_failed(&output, 1, &["failed: nuscenes:log", "part 2hz, clip tiny-b", "failed recordings: 1"]);
    assert!(table(&broken).lines().nth(2).unwrap().starts_with("| 2hz | 1 | 2 of 16 | "));
    assert_eq!(broken.json("out/dataset/generated.json")["samples"].as_array().unwrap().len(), 2);
    denoiser(&broken, "");
    let output = broken.run(only);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (whole, resumed) = (tree(&log.path("out")), tree(&broken.path("out")));
    assert_eq!(whole.keys().collect::<Vec<_>>(), resumed.keys().collect::<Vec<_>>());
    for (name, bytes) in &whole {
        assert!(resumed[name] == *bytes, "{name}");
    }
    // Finished rollouts are retained.
    let before = std::fs::metadata(log.path("out/2hz/tiny/index.json")).unwrap().modified().unwrap();
    assert!(log.run(only).status.success());
    let after = std::fs::metadata(log.path("out/2hz/tiny/index.json")).unwrap().modified().unwrap();
    assert_eq!(before, after);
}

#[test]
fn lane_changes_leave_the_log() {
    let log = built();
    let command = "protocol lane-change nuscenes:log --skeletons sks --out p --rasterizer cpu --maps color \
                   --window 2 --generator fill";
    let output = log.run(command);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let results = log.json("p/results.json");
    let parts = results["parts"].as_array().unwrap();
    // The log has two frames after the reference; the ego drives on for 10 s at 2 Hz.
    assert_eq!((&parts[0]["name"], &parts[1]["name"]), (&json!("replay"), &json!("lane_change")));
    let steps = |part: usize| &parts[part]["images"]["rollouts"][0]["scores"]["steps"];
    assert_eq!((steps(0), steps(1)), (&json!(2), &json!(20)));
    // Without ground truth off the log there is no PSNR.
    assert!(parts[0]["images"]["mean"]["psnr_db"].is_object());
    assert!(parts[1]["images"]["mean"]["psnr_db"].is_null());
    // The ego leaves the log with the first generated frame.
    assert_eq!(log.json("p/lane_change/tiny/rollout.json")["takeover_step"], json!(0));
}

#[test]
fn invalid_protocols_are_rejected_before_writing() {
    let log = built();
    let run = |args: &str| log.run(&format!("protocol {args} --skeletons sks --out p --rasterizer cpu"));
    let val = "nuscenes-val nuscenes:log";
    assert_failed(
        &run(val),
        2,
        &["expected all recordings of nuscenes-val", "150 are missing", "scene-0003"],
    );
    assert_failed(
        &run(&format!("{val} --other-logs --parts 3hz")),
        2,
        &["expected --parts of 6hz, 2hz, long"],
    );
    let town = "nuscenes-val nuscenes:log town:seed=1,frames=2 --other-logs";
    assert_failed(&run(town), 2, &["of one folder and version for part 2hz", "town:seed=1,frames=2"]);
    for (options, expected) in [
        ("--copy 3hz", "expected --copy of 6hz, 2hz, long, found 3hz"),
        ("--parts 6hz --copy 2hz", "expected --copy of 6hz, found 2hz"),
        ("--parts 6hz --generated-only", "expected --copy PART with --generated-only, found no part with"),
    ] {
        assert_failed(&run(&format!("{val} --other-logs {options}")), 2, &[expected]);
    }
    let town = "lane-change town:seed=1,frames=2";
    assert_failed(&run(&format!("{town} --copy lane_change")), 2, &["--copy of replay, found lane_change"]);
    assert_failed(
        &run(&format!("{town} --copy replay")),
        2,
        &["nuscenes:.. of one folder and version for part replay"],
    );
    assert_failed(&run("nuscenes-val nuscenes:log nuscenes:log --other-logs"), 2, &["each log once"]);
    assert!(!log.path("p").exists());
    let short = format!("{val} --other-logs --parts 2hz --generator fill --window 4");
    let parts =
        ["part 2hz", "expected a log of more than 3 frames at 2.0 Hz, found 3", "every recording failed: 1"];
    assert_failed(&run(&short), 1, &parts);
    let slow = format!("{val} --other-logs --copy long --generator fill --window 4");
    let parts = ["expected a log with frames at 6 Hz for the copy of part long, found 2.0 Hz", "--hz 12"];
    assert_failed(&run(&slow), 1, &parts);
    assert!(!log.path("p/6hz/tiny").exists(), "nothing is generated before");
    // Other options need another folder.
    let other = format!("{val} --other-logs --parts 2hz --generator fill --window 2 --radius 50");
    assert_failed(&run(&other), 1, &["expected the", "of this command, found another", "protocol.json"]);
}
