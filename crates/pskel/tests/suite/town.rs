//! The built-in synthetic town on the command line.

use std::process::Command;

use serde_json::Value;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{PSKEL, TinyLog, assert_failed, tree};

#[test]
fn a_town_is_written_completely_or_not_at_all() {
    let log = TinyLog::new();
    let small = ",frames=1,size=45x80";
    let summary = log.succeed(&format!("town seed=2{small} --truth --out out/town"));
    assert!(summary.starts_with("wrote town-2-1f-dusk: 1 frames, 6 images, 1 sweeps"), "{summary}");
    for name in [
        "v1.0-town/sample.json",
        "maps/town.png",
        "maps/expansion/town.json",
        "truth/000000/CAM_BACK/depth.exr",
    ] {
        assert!(log.path("out/town").join(name).is_file(), "{name}");
    }
    assert!(log.path("out/town/truth/000000/CAM_BACK/instance.png").is_file());
    assert_eq!(
        log.json("out/town/town.json")["town"],
        "seed=2,frames=1,hz=5,beams=32,lidar_hz=10,size=45x80"
    );
    assert!(log.run("info nuscenes:out/town").status.success());
    // A town written before is replaced, unless the folder has other files.
    log.succeed(&format!("town seed=4{small} --out out/town"));
    assert!(!log.path("out/town/truth").exists());
    std::fs::write(log.path("out/town/notes.txt"), "mine").unwrap();
    let before = tree(&log.path("out"));
    let again = || log.run(&format!("town seed=5{small} --out out/town"));
    assert_failed(&again(), 1, &["expected only files that pskel wrote", "another file: out/town/notes.txt"]);
    assert!(tree(&log.path("out")) == before);
}

#[test]
fn invalid_town_options_are_usage_errors() {
    let log = TinyLog::new();
    for (args, said) in [
        ("town beams=16 --out out/x", ["beams of 32 or 64", "\"16\""]),
        ("town frames=0 --out out/x", ["1 to 10000 frames", "\"0\""]),
        ("town frames=20000 --out out/x", ["1 to 10000 frames", "\"20000\""]),
        ("town frames=4000 --out out/x", ["at most 600 s", "4000 frames at 5 Hz"]),
        ("town lidar_hz=10,hz=12 --out out/x", ["hz of 0.5 to lidar_hz", "\"12\""]),
        ("town lidar_hz=15 --out out/x", ["lidar_hz of 10 or 20", "\"15\""]),
        ("town size=9000x9000 --out out/x", ["at most 33554432 pixels", "9000x9000"]),
        ("town size=90 --out out/x", ["HxW of 1 to 16384 pixels", "90"]),
        ("town seed=-1 --out out/x", ["whole number below 2^64 for seed", "-1"]),
        ("town light=night --out out/x", ["day, dusk or overcast", "night"]),
        ("town --color red --out out/x", ["unexpected argument", "--color"]),
        ("town seed=1", ["required", "--out"]),
        ("info town:frames=0", ["1 to 10000 frames", "\"0\""]),
        ("build town:seed=x --out out/x", ["whole number below 2^64 for seed", "\"x\""]),
        ("render town:colour=3 --skeleton out/x --out out/y", ["KEY=VALUE with seed", "\"colour\""]),
        ("simulate town:hz=0 --skeleton out/x --out out/y --steps 1", ["hz of 0.5 to lidar_hz", "\"0\""]),
        ("fidelity town:seed=1 --skeleton out/x --out a.txt", [".json, .csv or .md", "a.txt"]),
    ] {
        log.fail(args, 2, &said);
    }
}

#[test]
fn a_town_needs_a_writable_place() {
    let log = TinyLog::new();
    std::fs::write(log.path("file"), "").unwrap();
    let cases = [
        ("file", "expected a folder or none, found a file"),
        ("file/town", "cannot create"),
        ("/proc/none/town", "cannot create"),
    ];
    for (place, said) in cases {
        let output = log.run(&format!("town frames=1,size=45x80 --out {place}"));
        assert_failed(&output, 1, &[said, place.trim_end_matches("/town")]);
    }
    assert_eq!(std::fs::read(log.path("file")).unwrap(), b"");
    // Disk full: the unfinished output is removed.
    let command = "ulimit -f 64; exec \"$0\" town frames=1,size=45x80 --out out/town";
    let mut shell = Command::new("bash");
    let output = shell.current_dir(log.path("")).args(["-c", command, PSKEL]).output().unwrap();
    assert_failed(&output, 1, &["cannot write", "out/"]);
    log.assert_out_is_empty();
}

/// Builds, renders and evaluates from memory; a skeleton of another town is refused.
#[test]
fn all_commands_accept_a_town() {
    let log = TinyLog::new();
    let town = "town:seed=5,frames=2,size=90x160";
    let summary = log.succeed(&format!("build {town} --out out/sk"));
    assert!(
        summary.starts_with("built town-5-2f-day from 2 frames") && summary.contains("12 images"),
        "{summary}"
    );
    log.succeed(&format!("render {town} --skeleton out/sk --out out/maps --frames 0..1"));
    assert!(
        log.path("out/maps/000000/sheet.png").is_file()
            && log.path("out/maps/000000/CAM_BACK/map.png").is_file()
    );
    let output = log.run(&format!(
        "fidelity {town} --skeleton out/sk --frames 0..1 --out out/f.json --out out/f.md --out out/f.csv"
    ));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = log.json("out/f.json")["poses"].as_array().unwrap().clone();
    assert_eq!((rows.len(), &rows[0]["pose"], &rows[0]["images"]), (8, &"as driven".into(), &6.into()));
    let number = |path: &str| rows[0].pointer(path).unwrap().as_f64().unwrap();
    assert!(number("/color/psnr_db") > 15.0 && number("/color/filled") > 0.1, "{}", rows[0]);
    assert!(number("/depth/median_m") < 0.5, "{}", rows[0]);
    // An actor of some class is in view, and rendered at its position.
    let classes = rows[0]["rendered"]["classes"].as_object().unwrap();
    assert!(classes.values().filter_map(Value::as_f64).any(|iou| iou > 0.3), "{}", rows[0]);
    // A table of poses, and one of differences: all depths and four ranges by two rules.
    let markdown = std::fs::read_to_string(log.path("out/f.md")).unwrap();
    assert_eq!(
        markdown.lines().map(str::is_empty).collect::<Vec<_>>().iter().position(|empty| *empty),
        Some(10)
    );
    assert_eq!(markdown.lines().count(), 10 + 1 + 2 + 10);
    assert_eq!(std::fs::read_to_string(log.path("out/f.csv")).unwrap().lines().count(), 9);
    // Recorded images of frames that are not in the skeleton.
    log.succeed("town seed=5,frames=2,size=90x160 --out out/log");
    log.succeed("build nuscenes:out/log --every 2 --out out/half");
    let output = log
        .run("fidelity nuscenes:out/log --skeleton out/half --hold-out 2 --out out/c.json --out out/c.csv");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = log.json("out/c.json");
    let rows = report["cameras"].as_array().unwrap();
    assert_eq!((&report["hold_out"], rows.len(), &rows[6]["camera"]), (&2.into(), 7, &"all".into()));
    assert_eq!((&rows[0]["images"], &rows[6]["images"]), (&1.into(), &6.into()));
    assert!(rows[6]["color"]["psnr_db"].as_f64() > Some(12.0), "{}", rows[6]);
    assert_eq!(std::fs::read_to_string(log.path("out/c.csv")).unwrap().lines().count(), 8);
    // A skeleton of one town is not accepted for another.
    for (other, name) in [("seed=6,frames=2", "town-6-2f-day"), ("seed=5,frames=3", "town-5-3f-day")] {
        let output = log.run(&format!("fidelity town:{other} --skeleton out/sk"));
        assert_failed(&output, 1, &[&format!("a skeleton of log {name}, found one of log town-5-2f-day")]);
    }
}
