//! `pskel simulate` through the command line.

pub(super) mod folder;
pub(super) mod generated;
pub(super) mod lidar;
pub(super) mod mcap;
pub(super) mod mcap_file;
pub(super) mod peer_ends;
pub(super) mod scenario;

use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FIRST_US, PSKEL, START, TinyLog, assert_failed, tree};

/// Command without a number of steps. The log covers 1 s at 2 Hz, which gives 12 steps, 6 of them warm-up.
pub(crate) const SIMULATE: &str = "simulate nuscenes:log --skeleton sk --out out --warmup 2 --rasterizer cpu";

pub(crate) fn built() -> TinyLog {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    log
}

pub(crate) fn rows(log: &TinyLog, folder: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(log.path(&format!("{folder}/states.jsonl"))).unwrap();
    assert!(text.ends_with('\n') || text.is_empty(), "whole lines");
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Returns the data embedded in a page.
fn page(log: &TinyLog, folder: &str) -> Value {
    let html = std::fs::read_to_string(log.path(&format!("{folder}/index.html"))).unwrap();
    let (_, rest) = html.split_once(r#"id="rollout">"#).unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

/// Checks that all images shown by a page are files of its folder, and that all links lead to one.
pub(crate) fn assert_page_is_whole(log: &TinyLog, folder: &str, steps: usize) {
    let page = page(log, folder);
    let names: Vec<&str> =
        page["steps"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, (0..steps).map(|i| format!("{i:06}")).collect::<Vec<_>>());
    for name in names {
        let step = log.path(&format!("{folder}/steps/{name}"));
        assert_eq!(image::image_dimensions(step.join("birdseye.png")).unwrap(), (800, 800));
        for map in page["maps"].as_array().unwrap() {
            let size =
                image::image_dimensions(step.join(format!("view/{}.jpg", map.as_str().unwrap()))).unwrap();
            assert_eq!(
                (json!(size.0), json!(size.1)),
                (page["sheet"]["width"].clone(), page["sheet"]["height"].clone())
            );
        }
    }
    for file in page["files"].as_array().unwrap() {
        assert!(log.path(&format!("{folder}/{}", file.as_str().unwrap())).is_file(), "{file}");
    }
}

/// Returns width, height, frame count and frame rate of a video.
fn video(path: &Path) -> (u16, u16, u32, f64) {
    let file = std::fs::File::open(path).unwrap();
    let size = file.metadata().unwrap().len();
    let reader = mp4::Mp4Reader::read_header(std::io::BufReader::new(file), size).unwrap();
    let track = &reader.tracks()[&1];
    (track.width(), track.height(), track.sample_count(), (track.frame_rate() * 100.0).round() / 100.0)
}

#[test]
fn a_rollout_writes_all_its_files() {
    let log = built();
    let summary = log.succeed(&format!("{SIMULATE} --steps 8 --ego lane_change --profile profile.json"));
    assert!(summary.starts_with("simulated 8 steps, ego lane_change, actors replay, by cpu"), "{summary}");
    assert!(summary.contains("steps a second") && summary.contains("policies"), "{summary}");
    let mut expected: BTreeSet<String> =
        ["index.html", "index.json", "metrics.json", "rollout.json", "rollout.mp4", "states.jsonl"]
            .map(str::to_owned)
            .into();
    for step in 0..=8 {
        let maps = ["boxes", "class", "color", "depth", "instance"];
        let mut add = |name: String| expected.insert(format!("steps/{step:06}/{name}"));
        for name in ["birdseye.png", "meta.json", "state.json"] {
            add(name.to_owned());
        }
        for map in maps {
            add(format!("view/{map}.jpg"));
            for camera in CAMERAS {
                add(format!("{camera}/{map}.png"));
            }
        }
    }
    assert_eq!(tree(&log.path("out")).into_keys().collect::<BTreeSet<_>>(), expected);

    let rows = rows(&log, "out");
    assert_eq!(rows.len(), 9);
    for (step, row) in rows.iter().enumerate() {
        let seconds = step as f64 / 12.0;
        assert_eq!(
            (&row["step"], &row["t_us"]),
            (&json!(step), &json!(FIRST_US + (seconds * 1e6).round() as i64))
        );
        assert_eq!(row["phase"], if step <= 6 { "warm_up" } else { "policy" });
        assert_eq!(row["plan"].is_array(), step == 7, "the first plan leads to step 7");
        let x = row["ego"]["global_from_ego"][0][3].as_f64().unwrap() - START.x;
        if step <= 6 {
            // At 2 m/s, with times rounded to microseconds.
            assert!((x - 2.0 * seconds).abs() < 2e-6, "step {step}: {x}");
        } else {
            assert!(x > 1.0 + 2.0 * (seconds - 0.5) && x < 1.5, "step {step}: {x}");
        }
        let car = &row["actors"][0];
        assert_eq!(
            (&car["instance"], &car["track"], &car["new_in_view"]),
            (&json!(1), &json!("car"), &json!([]))
        );
        let ahead = car["center_m"][0].as_f64().unwrap() - START.x;
        assert!((ahead - (12.0 + 4.0 * seconds)).abs() < 4e-6);
        assert_eq!(car["size_m"], json!([4.0, 2.0, 1.5]));
        assert_eq!(car["seen"][0]["camera"], 0);
        assert!(car["seen"][0]["pixels"].as_u64() > Some(30));
    }
    let index = log.json("out/index.json");
    assert_eq!((&index["options"]["sim_hz"], &index["options"]["takeover_step"]), (&json!(12.0), &json!(6)));
    let frames = index["frames"].as_array().unwrap();
    assert_eq!(
        (frames.len(), &frames[8]["name"], &frames[8]["cameras"]),
        (9, &json!("000008"), &json!(CAMERAS))
    );
    assert_eq!(
        (&frames[8]["ego"], &frames[8]["t_us"]),
        (&rows[8]["ego"]["global_from_ego"], &rows[8]["t_us"])
    );
    let metrics = log.json("out/metrics.json");
    assert_eq!(
        (&metrics["ended"], &metrics["failure"], &metrics["steps"]),
        (&json!("steps"), &Value::Null, &json!(2)),
        "those after the warm-up"
    );
    let (width, height, pictures, rate) = video(&log.path("out/rollout.mp4"));
    assert_eq!((pictures, rate), (9, 12.0));
    // One large map, two of half its size below it, and the bird's-eye view beside them at their total
    // height; text on top.
    let sheet = &page(&log, "out")["sheet"];
    let side = |name: &str| sheet[name].as_u64().unwrap() as u16;
    let above = side("height") + 4 + side("height") / 2;
    let even = [side("width") + 4 + above, 28 + above].map(|side| side.next_multiple_of(2));
    assert_eq!([width, height], even);
    assert_page_is_whole(&log, "out", 9);
    assert_eq!(log.json("profile.json")["steps"].as_array().unwrap().len(), 9);
    // Maps equal those rendered by `render` at the same time.
    log.succeed("render nuscenes:log --skeleton sk --out maps --rasterizer cpu --at 1000500000");
    let (step, frame) = (tree(&log.path("out/steps/000006")), tree(&log.path("maps/1000500000")));
    for camera in CAMERAS {
        for map in ["color", "depth", "class", "instance", "boxes"] {
            let name = format!("{camera}/{map}.png");
            assert!(step[&name] == frame[&name], "{name}");
        }
    }
}

#[test]
fn a_resumed_rollout_equals_an_uninterrupted_one() {
    let log = built();
    let simulate = |out: &str, rest: &str| {
        let policies = "--ego lane_change --tracking bicycle --actors reactive --maps color,instance";
        format!("{} {policies} {rest}", SIMULATE.replace("--out out", &format!("--out {out}")))
    };
    log.succeed(&simulate("whole", "--steps 9"));
    let whole = tree(&log.path("whole"));
    // On other threads, and with another number of them.
    let output = log.run_with(&simulate("one", "--steps 9"), "1");
    assert!(output.status.success(), "{output:?}");
    assert!(tree(&log.path("one")) == whole);
    // In three pieces; the second run's process died in the middle of a line.
    log.succeed(&simulate("parts", "--steps 2"));
    log.succeed(&simulate("parts", "--steps 7 --resume"));
    let states = log.path("parts/states.jsonl");
    let mut text = std::fs::read_to_string(&states).unwrap();
    text.push_str(r#"{"step": 8, "#);
    std::fs::write(&states, text).unwrap();
    std::fs::create_dir_all(log.path("parts/.pskel/steps_000008")).unwrap();
    std::fs::write(log.path("parts/.pskel/lock"), "4194305").unwrap();
    log.succeed(&simulate("parts", "--steps 9 --resume"));
    assert!(tree(&log.path("parts")) == whole);
    // From a step before the end, and from the end, where no step remains.
    for extra in ["--resume-from 3", "--resume-from 9", "--resume"] {
        log.succeed(&simulate("parts", &format!("--steps 9 {extra}")));
        assert!(tree(&log.path("parts")) == whole, "{extra}");
    }
    // Other options are refused, and no file changes.
    for (rest, code, parts) in [
        ("--steps 9 --resume --radius 50 --far 100", 1, ["radius_m 100", "rollout.json"]),
        ("--steps 9 --resume --seed 3", 1, ["saved state", "found"]),
        ("--steps 12 --resume-from 10", 1, ["a step from 0 to 9", "states.jsonl"]),
    ] {
        assert_failed(&log.run(&simulate("parts", rest)), code, &parts);
        assert!(tree(&log.path("parts")) == whole, "{rest}");
    }
    // Without --resume the rollout in the folder is replaced.
    log.succeed(&simulate("parts", "--steps 1"));
    assert_eq!(rows(&log, "parts").len(), 2);
    assert!(!log.path("parts/steps/000002").exists());
}

#[test]
fn a_rollout_ends_with_the_log() {
    let log = built();
    let summary = log.succeed(&format!("{SIMULATE} --steps 40 --maps depth --forecast-maps 1"));
    assert!(summary.starts_with("simulated 12 steps of 40 (the log ended), ego replay"), "{summary}");
    assert_eq!(log.json("out/metrics.json")["ended"], "log_ended");
    assert_page_is_whole(&log, "out", 13);
    // With replay, the forecast at step 6 for step 12 equals the result.
    let expected = tree(&log.path("out/steps/000006/forecast/000012"));
    assert_eq!(
        expected.keys().collect::<Vec<_>>(),
        ["CAM_BACK/depth.png", "CAM_FRONT/depth.png", "meta.json"]
    );
    let came = tree(&log.path("out/steps/000012"));
    assert!(expected.iter().all(|(name, bytes)| came[name] == *bytes));
    // The first step has a forecast, too, taken from the log.
    for (step, next) in [("000006", "000012"), ("000000", "000006")] {
        let forecast = tree(&log.path(&format!("out/steps/{step}/forecast")));
        assert!(forecast.len() == 3 && forecast.keys().all(|name| name.starts_with(next)), "{forecast:?}");
    }
    assert!(!log.path("out/steps/000005/forecast").exists(), "no plan step");
}

#[test]
fn a_planner_that_dies_leaves_the_earlier_steps() {
    let log = built();
    planner(
        &log,
        "read -r observation\necho \"$observation\" > observed.json\nanswer\nread -r observation\nexit 3",
    );
    let args = format!("{SIMULATE} --steps 20 --ego external --planner ./planner.sh");
    assert_failed(&log.run(&args), 1, &["stopped after 13 steps, which are in out", "planner", "exit"]);
    assert_eq!(rows(&log, "out").len(), 13);
    assert_page_is_whole(&log, "out", 13);
    let metrics = log.json("out/metrics.json");
    assert_eq!((&metrics["ended"], &metrics["steps"]), (&Value::Null, &json!(6)));
    assert!(metrics["failure"].as_str().unwrap().contains("planner"));
    assert_eq!(page(&log, "out")["failure"], metrics["failure"]);
    // The planner received the files of the step before its first plan.
    let observed = log.json("observed.json");
    let files: Vec<&str> =
        observed["files"].as_array().unwrap().iter().map(|f| f.as_str().unwrap()).collect();
    assert!(
        files.iter().all(|file| Path::new(file).is_file() && file.contains("out/steps/000006/")),
        "{files:?}"
    );
    assert!(files.iter().any(|file| file.ends_with("CAM_FRONT/color.png")));
    // A planner that exits without an answer leaves no output.
    std::fs::remove_dir_all(log.path("out")).unwrap();
    std::fs::create_dir(log.path("out")).unwrap();
    log.fail(&args.replace("./planner.sh", "true"), 1, &["planner"]);
}

/// Writes a planner that answers the hello, then runs some lines of shell; `answer` drives on at 2 m/s.
pub(crate) fn planner(log: &TinyLog, lines: &str) {
    let script = format!(
        r#"#!/bin/sh
read -r hello
echo '{{"protocol": "pskel-planner", "version": 1}}'
answer() {{
    half='{{"t": 0.5, "x": 1, "y": 0, "heading": 0, "v": 2}}'
    one='{{"t": 1, "x": 2, "y": 0, "heading": 0, "v": 2}}'
    echo "{{\"frame\": \"ego\", \"trajectory\": [$half, $one]}}"
}}
{lines}
"#
    );
    let path = log.path("planner.sh");
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn a_planner_that_hangs_or_fails_leaves_a_resumable_rollout() {
    let log = built();
    let args = |out: &str| {
        let ego = "--ego external --planner ./planner.sh --planner-timeout 10 --maps instance --steps 10";
        format!("{} {ego}", SIMULATE.replace("--out out", &format!("--out {out}")))
    };
    planner(&log, "while read -r observation; do answer; done");
    log.succeed(&args("whole"));
    for (lines, parts) in [
        ("read -r observation; echo nonsense", [r#"expected {"trajectory": "#, r#"found "nonsense""#]),
        (r#"read -r observation; echo '{"trajectory": []}'"#, ["1 to 10000", "found 0"]),
    ] {
        planner(&log, lines);
        let output = log.run(&args("out"));
        assert_failed(&output, 1, &parts);
        assert_failed(&output, 1, &["stopped after 7 steps, which are in out", "./planner.sh"]);
        assert_page_is_whole(&log, "out", 7);
    }
    planner(&log, "while read -r observation; do answer; done");
    log.succeed(&format!("{} --resume", args("out")));
    assert!(tree(&log.path("out")) == tree(&log.path("whole")));
    // A planner that hangs; with more time the rollout is resumed.
    planner(&log, "read -r observation; exec sleep 600");
    let hasty = args("out").replace("--planner-timeout 10", "--planner-timeout 0.5");
    assert_failed(&log.run(&hasty), 1, &["within 0.5 s", "stopped after 7 steps", "./planner.sh"]);
    assert_page_is_whole(&log, "out", 7);
    planner(&log, "while read -r observation; do answer; done");
    log.succeed(&format!("{} --resume", args("out")));
    assert!(tree(&log.path("out")) == tree(&log.path("whole")));
}

#[test]
fn every_saved_step_can_be_resumed() {
    let log = built();
    for (ego, tracking, actors) in [
        ("lane_change", "bicycle", "idm"),
        ("cosine", "perfect", "reactive"),
        ("straight", "bicycle", "replay"),
    ] {
        let simulate = format!(
            "{} --ego {ego} --tracking {tracking} --actors {actors} --maps instance --steps 6",
            SIMULATE.replace("--warmup 2", "--warmup 1")
        );
        log.succeed(&simulate);
        let whole = tree(&log.path("out"));
        for step in 0..6 {
            log.succeed(&format!("{simulate} --resume-from {step}"));
            assert!(tree(&log.path("out")) == whole, "{ego} {tracking} {actors} from step {step}");
        }
    }
}

#[test]
fn logs_without_boxes_or_with_a_gap_are_simulated_and_noted() {
    let log = built();
    // The last frame is 3 s late: the log covers 4 s.
    let late = FIRST_US + 4_000_000;
    log.change("sample", "/2/timestamp", json!(late));
    for data in 6..9 {
        log.change("sample_data", &format!("/{data}/timestamp"), json!(late));
    }
    let summary = log.succeed(&format!("{SIMULATE} --maps instance --steps 100 --ego replay"));
    assert!(summary.starts_with("simulated 48 steps of 100 (the log ended)"), "{summary}");
    assert!(summary.contains("; 1 x gaps of more than 1 s between frames"), "{summary}");
    assert_page_is_whole(&log, "out", 49);
    let reported = page(&log, "out");
    let notes = reported["metrics"].as_array().unwrap();
    assert!(notes.contains(&json!(["note: gaps of more than 1 s between frames", "1"])), "{notes:?}");

    let log = TinyLog::new();
    log.change("sample_annotation", "", json!([]));
    log.change("instance", "", json!([]));
    log.succeed("build nuscenes:log --out sk");
    for actors in ["replay", "idm", "reactive"] {
        let summary = log.succeed(&format!("{SIMULATE} --steps 8 --ego lane_change --actors {actors}"));
        assert!(summary.contains("; 1 x logs without boxes"), "{summary}");
        assert!(rows(&log, "out").iter().all(|row| row["actors"] == json!([])));
        let metrics = log.json("out/metrics.json");
        // The log has no map either.
        let nothing = (&metrics["off_road"], &metrics["min_time_to_collision_s"], &metrics["collisions"]);
        assert_eq!(nothing, (&Value::Null, &Value::Null, &json!([])));
        assert_page_is_whole(&log, "out", 9);
    }
}

#[test]
fn trajectories_of_any_length_work_and_bad_ones_are_errors() {
    let log = built();
    let args = format!("{SIMULATE} --maps depth --steps 8 --ego file --trajectory");
    for (name, content, parts) in [
        ("nan.csv", "0,0\n1,nan\n", ["point 1", "NaN"]),
        ("three.csv", "0,0,0\n1,0,0\n", ["line 1", "expected"]),
        ("same.json", "[[1, 2], [1, 2], [1, 2]]", ["with a length", "found"]),
        ("words.json", "{\"points\": \"none\"}", ["expected", "found"]),
        ("empty.csv", "", ["2 to 20 million points", "found 0"]),
        ("times.json", "{\"waypoints\": []}", ["1 to 1000000 waypoints", "found 0"]),
        ("path.xml", "<path/>", [".json, .npy, .csv", "path.xml"]),
    ] {
        std::fs::write(log.path(name), content).unwrap();
        log.fail(&format!("{args} {name}"), 1, &parts);
        log.fail(&format!("{args} {name}"), 1, &[&format!(": {name}\n")]);
    }
    // A path of a million points to the left: the rollout's files do not grow with their number.
    let points: String =
        (0..1_000_000).map(|i| format!("{:.3},{:.3}\n", 1e-3 * f64::from(i), 5e-4 * f64::from(i))).collect();
    std::fs::write(log.path("long.csv"), points).unwrap();
    log.succeed(&format!("{args} long.csv"));
    assert!(log.json("out/metrics.json")["lateral_deviation_m"]["end"].as_f64() > Some(0.05));
    assert!(tree(&log.path("out")).values().all(|file| file.len() < 1 << 20));
}

#[test]
fn a_full_disk_leaves_complete_steps_and_lines() {
    let log = built();
    // First without room even for the options; then with enough KiB for the files of each step, but not for
    // all state lines.
    log.succeed(&format!("{SIMULATE} --maps boxes --steps 60 --ego straight"));
    let whole = tree(&log.path("out"));
    let largest =
        whole.iter().filter(|(name, _)| name.starts_with("steps/")).map(|(_, file)| file.len()).max();
    let largest = largest.unwrap() / 1024 + 1;
    assert!(whole["states.jsonl"].len() / 1024 > largest, "{largest} KiB");
    std::fs::remove_dir_all(log.path("out")).unwrap();
    std::fs::create_dir(log.path("out")).unwrap();
    for limit in [0, largest] {
        let script =
            format!("ulimit -f {limit}; exec '{PSKEL}' {SIMULATE} --maps boxes --steps 60 --ego straight");
        let output = Command::new("bash").arg("-c").arg(script).current_dir(log.path("")).output().unwrap();
        assert_failed(&output, 1, &["cannot write"]);
        let files = tree(&log.path("out"));
        if limit == 0 {
            assert_eq!(files.len(), 0, "{:?}", files.keys());
            continue;
        }
        let rows = rows(&log, "out");
        assert!(!rows.is_empty() && rows.len() < 61, "{} rows", rows.len());
        for step in 0..rows.len() {
            for name in ["meta.json", "state.json", "birdseye.png", "view/boxes.jpg", "CAM_BACK/boxes.png"] {
                assert!(files.contains_key(&format!("steps/{step:06}/{name}")), "step {step} {name}");
            }
        }
        assert!(!files.contains_key("index.json") && files.keys().all(|name| !name.contains(".pskel-")));
    }
    // With enough room the rollout is resumed.
    log.succeed(&format!("{SIMULATE} --maps boxes --steps 60 --ego straight --resume"));
    assert_page_is_whole(&log, "out", 61);
    assert!(tree(&log.path("out")) == whole);
}

#[test]
fn a_dry_run_writes_nothing() {
    let log = built();
    let summary = log.succeed(&format!("{SIMULATE} --steps 3 --dry --profile p.json"));
    assert!(summary.starts_with("simulated 3 steps") && summary.contains("steps a second"), "{summary}");
    log.assert_out_is_empty();
    let profile = log.json("p.json");
    assert_eq!((profile["steps"].as_array().unwrap().len(), &profile["written"]), (4, &json!([])));
    assert!(profile["medians"]["step_s"].as_f64() > Some(0.0));
}

#[test]
fn wrong_usage_exits_with_2_and_wrong_files_with_1() {
    let log = built();
    std::fs::write(log.path("one.json"), "[[1, 2]]").unwrap();
    for (extra, code, parts) in [
        ("--steps 0", 2, ["at least one step", ""]),
        ("--steps 5 --sim-hz 10 --plan-hz 4", 2, ["10 Hz and 4 Hz", "multiple"]),
        ("--steps 5 --sim-hz 0", 2, ["0.1 to 100", ""]),
        ("--steps 5 --ego fly", 2, ["lane_change", "replay"]),
        ("--steps 5 --actors fly", 2, ["idm", "reactive"]),
        ("--steps 5 --ego file", 2, ["--trajectory", ""]),
        ("--steps 5 --ego external", 2, ["--planner", ""]),
        ("--steps 5 --trajectory one.json", 2, ["--ego file with --trajectory", "replay"]),
        ("--steps 5 --ego file --trajectory one.json", 1, ["one.json", "expected"]),
        ("--steps 5 --ego file --trajectory none.csv", 1, ["none.csv", "cannot read"]),
        ("--steps 5 --start 7", 2, ["1000000000 to 1001000000", "found 7"]),
        ("--steps 5 --maps tensor", 2, ["npz or safetensors", ""]),
        ("--steps 5 --maps map", 1, ["an HD map", "none"]),
        ("--steps 5 --resume-from 2", 1, ["expected a rollout with step 2, found no step: out", ""]),
        ("--steps 5 --planner x", 2, ["--ego external with --planner", "found replay"]),
        ("--steps 5 --forecast-maps 0", 2, ["1 to 100 plan steps", "0"]),
        ("--steps 5 --forecast-maps 101", 2, ["1 to 100 plan steps", "101"]),
        ("--steps 5 --dry --resume", 2, ["cannot be used with", ""]),
    ] {
        log.fail(&format!("{SIMULATE} {extra}"), code, &parts);
    }
}
