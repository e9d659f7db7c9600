//! `pskel bench` through the command line, with small clouds.

use std::collections::BTreeSet;

use point_skeleton::cloud::{cameras, npy};
use point_skeleton::geometry::View;
use point_skeleton::scene::Substitutes;
use pskel_eval::bench::{street_cloud, street_views};
use serde_json::Value;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FRAMES, HEIGHT, TinyLog, WIDTH};
use pskel_testing::npz;

/// A small street, rendered by the rasterizer that needs no driver.
const SMALL: &str = "bench --synthetic 3000 --size 90x160 --repeat 3 --warm-up 1 --rasterizer cpu";

/// Returns the JSON object of a run with `--json`.
#[track_caller]
fn json(log: &TinyLog, args: &str) -> Value {
    serde_json::from_str(&log.succeed(&format!("{args} --json"))).unwrap()
}

fn number(object: &Value, pointer: &str) -> f64 {
    object.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} in {object}"))
}

#[test]
fn json_object_has_all_measurements() {
    let log = TinyLog::new();
    for rasterizer in ["cpu", "auto"] {
        let args = SMALL.replace("cpu", rasterizer).replace("3000", "3e3");
        let found = json(&log, &format!("{args} --out-size 45x80"));
        let keys: Vec<&str> = found.as_object().unwrap().keys().map(String::as_str).collect();
        let expected = [
            "cameras",
            "device",
            "driver",
            "filled",
            "frame_ms",
            "frames",
            "out_size",
            "peak_rss_mb",
            "points",
            "points_per_s",
            "rasterizer",
            "size",
            "stages_ms",
        ];
        assert_eq!(BTreeSet::from_iter(keys), BTreeSet::from(expected));
        assert!(
            !found["device"].as_str().unwrap().is_empty() && !found["driver"].as_str().unwrap().is_empty()
        );
        assert_eq!((&found["size"], &found["out_size"]), (&"90x160".into(), &"45x80".into()));
        assert_eq!(["/points", "/cameras", "/frames"].map(|key| number(&found, key)), [3000.0, 6.0, 3.0]);
        let [min, median, max] =
            ["min", "median", "max"].map(|key| number(&found, &format!("/frame_ms/{key}")));
        assert!(0.0 < min && min <= median && median <= max);
        let per_s = number(&found, "/points_per_s");
        assert!((3e6 / max..=3e6 / min).contains(&per_s), "{per_s} points/s with {min} to {max} ms a frame");
        assert!(found["stages_ms"].as_object().unwrap().values().all(|ms| ms.as_f64().unwrap() >= 0.0));
        assert!(number(&found, "/filled") > 0.0 && number(&found, "/peak_rss_mb") > 1.0);
    }
}

#[test]
fn the_table_ends_with_a_summary() {
    let output = TinyLog::new().run(SMALL);
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    for part in [
        "rasterizer   cpu\n",
        "points       3000\n",
        "size         90x160\n",
        "  project",
        "%\n",
        " MB at most\n",
    ] {
        assert!(text.contains(part), "{text}\nexpected {part}");
    }
    assert!(
        text.lines()
            .last()
            .unwrap()
            .starts_with("rendered 3 frames of 3000 points in 6 cameras by cpu on host")
    );
    let progress = String::from_utf8(output.stderr).unwrap();
    assert!(progress.contains("[1/4] warm-up") && progress.contains("[4/4] frame"), "{progress}");
}

#[test]
fn the_street_is_the_same_in_each_run() {
    let log = TinyLog::new();
    let filled = |extra: &str| number(&json(&log, &format!("{SMALL} {extra}")), "/filled");
    let first = filled("");
    assert!(first == filled("--in-flight 2"));
    assert_eq!(json(&log, &format!("{SMALL} --maps color,point"))["filled"], Value::Null);
}

/// The same points and cameras from files, rendered once with `splat` for comparison.
#[test]
fn frames_equal_the_maps_of_splat() {
    let log = TinyLog::new();
    npy::write(&log.path("p.npy"), &street_cloud(3000, 1), false).unwrap();
    let small = |view: View| View { camera: view.camera.resized(90, 160), ..view };
    cameras::write(&log.path("c.json"), &street_views().into_iter().map(small).collect::<Vec<_>>()).unwrap();
    let files = "--points p.npy --cameras c.json --splat 20:3,60:0 --out-size 45x80";
    log.succeed(&format!("splat {files} --out out/f.npz"));
    let depth = npz::read::<f32>(&log.path("out/f.npz"), "depth").data;
    let expected = depth.iter().filter(|d| **d > 0.0).count() as f64;
    assert!(expected > 100.0);
    for extra in ["--rasterizer cpu", ""] {
        let found = json(&log, &format!("bench {files} {extra} --repeat 1 --warm-up 0"));
        assert_eq!(number(&found, "/filled"), expected, "{extra}");
        assert_eq!(found["size"], "90x160");
    }
    let synthetic = format!("{SMALL} --splat 20:3,60:0 --out-size 45x80");
    assert_eq!(number(&json(&log, &synthetic), "/filled"), expected);
}

#[test]
fn a_location_is_written_once_and_driven_through() {
    let log = TinyLog::new();
    let bench = "bench --synthetic 30000 --skeleton streets --size 90x160 --rasterizer cpu --warm-up 1";
    let first = json(&log, &format!("{bench} --frames 0..3"));
    assert_eq!(["/points", "/frames"].map(|key| number(&first, key)), [30_000.0, 3.0]);
    assert!(number(&first, "/filled") > 100.0 && first["stages_ms"]["load"].is_number());
    let written = std::fs::metadata(log.path("streets/skeleton.json")).unwrap().modified().unwrap();
    // 101 frames, 1 m apart; the memory for points does not change them.
    let whole = json(&log, &format!("{bench} --memory 3"));
    assert_eq!(number(&whole, "/frames"), 101.0);
    let auto = bench.replace("cpu", "auto");
    let last = json(&log, &format!("{auto} --frames 100..101"));
    assert_eq!(last["filled"], whole["filled"]);
    assert_ne!(last["filled"], first["filled"]);
    assert_eq!(std::fs::metadata(log.path("streets/skeleton.json")).unwrap().modified().unwrap(), written);
    for (args, words) in [
        ("--memory 0", "the cameras of a frame may see points of 2 MiB, but 0 MiB are allowed (--memory)"),
        ("--frames 7..102", "expected frames within 0..101, the drive through this location, found ..102"),
    ] {
        log.fail(&format!("{bench} {args}"), 1, &[words]);
    }
    log.fail(
        &bench.replace("30000", "20000"),
        1,
        &["expected a location of 1 streets with 20000 points each"],
    );
}

#[test]
fn renders_a_recording_frame_by_frame() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let bench = "bench nuscenes:log --skeleton sk --rasterizer cpu";
    let found = json(&log, bench);
    assert_eq!(number(&found, "/frames"), FRAMES as f64);
    assert_eq!((&found["cameras"], &found["size"]), (&2.into(), &format!("{HEIGHT}x{WIDTH}").into()));
    assert!(number(&found, "/filled") > 0.0 && number(&found, "/points") > 1000.0);
    // The skeleton has no templates of its own.
    let without = json(&log, &format!("{bench} --no-default-templates"));
    let templates: usize = Substitutes::built_in().templates.iter().map(|(_, points)| points.len()).sum();
    assert_eq!(number(&found, "/points") - number(&without, "/points"), templates as f64);
    let found = json(&log, &format!("{bench} --frames 0..2 --repeat 2 --size 32x48"));
    assert_eq!((&found["frames"], &found["size"]), (&4.into(), &"32x48".into()));
    log.fail(&format!("{bench} --frames 2..9"), 1, &["expected --frames within 0..3, found 2..9"]);
    log.fail(&bench.replace("sk ", "none "), 1, &["none/skeleton.json"]);
    log.change("scene", "/0/name", "other".into());
    log.fail(bench, 1, &["expected a skeleton of log", "found one of log"]);
}

#[test]
fn full_steps_have_layouts_and_cover_the_same_pixels() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let bench = "bench nuscenes:log --skeleton sk --rasterizer cpu --size 32x48 --out-size 16x24";
    let stages =
        |found: &Value| -> Vec<String> { found["stages_ms"].as_object().unwrap().keys().cloned().collect() };
    let bare = json(&log, bench);
    assert_eq!(stages(&bare), ["clear", "load", "plan", "project", "resolve"]);
    for in_flight in ["1", "2"] {
        let whole = format!("{bench} --maps depth,instance,boxes,tensor --in-flight {in_flight}");
        let found = json(&log, &whole);
        assert_eq!(
            stages(&found),
            ["clear", "convert", "instances", "layouts", "load", "plan", "project", "resolve"]
        );
        for key in ["filled", "frames", "points", "size", "out_size"] {
            assert_eq!(found[key], bare[key], "{key}");
        }
    }
    assert_eq!(json(&log, &format!("{bench} --maps color,boxes"))["filled"], Value::Null);
    log.fail(&format!("{bench} --maps map"), 1, &["cannot draw the frames", "map"]);
}

#[test]
fn the_trace_contains_every_frame_and_stage() {
    let log = TinyLog::new();
    for in_flight in ["1", "2"] {
        let args = SMALL.replace("cpu", "auto");
        let found = json(&log, &format!("{args} --in-flight {in_flight} --trace out/t.json"));
        let trace = log.json("out/t.json");
        let events = trace["traceEvents"].as_array().unwrap();
        let bars =
            |category: &str| -> Vec<&Value> { events.iter().filter(|e| e["cat"] == category).collect() };
        let frames = bars("frame");
        assert_eq!(frames.len(), 3);
        for (index, event) in frames.iter().chain(&bars("stage")).enumerate() {
            assert_eq!(event["ph"], "X");
            assert!(number(event, "/ts") >= 0.0 && number(event, "/dur") >= 0.0, "{index}: {event}");
            assert!(event["pid"].is_number() && event["tid"].is_number());
        }
        assert_eq!(number(frames[0], "/ts"), 0.0);
        let stages: BTreeSet<&str> = bars("stage").iter().map(|e| e["name"].as_str().unwrap()).collect();
        let named = found["stages_ms"].as_object().unwrap().keys().map(String::as_str);
        assert_eq!(stages, named.collect());
        assert_eq!(std::fs::read_dir(log.path("out")).unwrap().count(), 1);
    }
}

#[test]
fn wrong_usage_exits_with_2() {
    let log = TinyLog::new();
    for (args, part) in [
        ("bench --synthetic 9 --points p.npy --cameras c.json", "cannot be used with"),
        ("bench nuscenes:log --skeleton sk --synthetic 9", "cannot be used with"),
        ("bench nuscenes:log --skeleton sk --points p.npy --cameras c.json", "cannot be used with"),
        ("bench nuscenes:log", "--skeleton <SKEL>"),
        ("bench --skeleton sk", "expected a recording, or --synthetic, with --skeleton, found neither"),
        ("bench --frames 0..1", "--skeleton <SKEL>"),
        ("bench --points p.npy", "--cameras <C.json>"),
        ("bench --cameras c.json", "--points <P.npy|P.ply>"),
        ("bench --synthetic 0", "expected 1 to 4294967294 points"),
        ("bench --synthetic 1.5", "expected 1 to 4294967294 points"),
        (
            "bench --maps colour",
            "expected the map color, depth, class, instance, boxes, map, point or tensor",
        ),
        (
            "bench --maps boxes",
            "expected a recording, or --maps out of color,depth,class,instance,point, found boxes",
        ),
        ("bench --points p.npy --cameras c.json --maps color,map", "found color,map"),
        ("bench --no-default-templates", "expected a recording with --templates"),
        ("bench --repeat 0", "0 is not in 1.."),
        ("bench --warm-up -1", "--warm-up"),
        ("bench --in-flight 3", "3 is not in 1..=2"),
        ("bench --splat 35:1,15:0", "rising depths"),
        ("bench --synthetic 9 --rasterizer graphics --memory 9", "no --memory with --rasterizer graphics"),
        ("bench --synthetic 9 --rasterizer cpu --device 0", "expected no --device with --rasterizer cpu"),
    ] {
        log.fail(args, 2, &[part]);
    }
}

#[test]
fn bad_files_exit_with_1_and_leave_nothing() {
    let log = TinyLog::new();
    npy::write(&log.path("p.npy"), &street_cloud(10, 1), false).unwrap();
    std::fs::write(log.path("bad.npy"), "no points").unwrap();
    std::fs::write(log.path("bad.json"), "{").unwrap();
    cameras::write(&log.path("c.json"), &street_views()).unwrap();
    let trace = "--trace out/t.json";
    for (args, part) in [
        (format!("bench --points none.npy --cameras c.json {trace}"), "none.npy"),
        (format!("bench --points bad.npy --cameras c.json {trace}"), "expected an NPY file"),
        (format!("bench --points p.npy --cameras bad.json {trace}"), "bad.json"),
        (format!("bench nuscenes:none --skeleton sk {trace}"), "none"),
        ("bench --synthetic 9 --device no-such-device".to_owned(), "no-such-device"),
        // Fails before rendering starts.
        (format!("{SMALL} --trace none/t.json"), "cannot read: No such file or directory (os error 2): none"),
        (format!("{SMALL} --trace out"), "expected a regular file or none, found a folder: out"),
    ] {
        let output = log.run(&args);
        assert!(output.stdout.is_empty(), "{args}: {output:?}");
        log.fail(&args, 1, &[part]);
    }
}
