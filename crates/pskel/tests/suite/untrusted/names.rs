//! Names in data sets that would lead out of the output folder, or that cannot be displayed.

use std::path::Path;

use serde_json::json;

use super::guarded::{Ended, listing, run};
use crate::tiny_log::TinyLog;
use pskel_testing::av2_log::{LOG_ID, TinyAv2, set, texts};
use pskel_testing::nuplan_log::{LOG, NuplanLog};

/// Camera names that are refused; `OUTSIDE` is replaced by a folder beside the data set. The output is five
/// levels below the folder that is checked for changes.
const BAD: [&str; 34] = [
    "",
    ".",
    "..",
    "...",
    "../x",
    "../../x",
    "../../../x",
    "../../../../x",
    "a/../../../x",
    "OUTSIDE",
    "OUTSIDE/",
    "/",
    "a/b",
    "a/",
    "a\\b",
    "..\\x",
    "a\0b",
    "a\nb",
    "a\rb",
    "\u{1b}[2J\u{1b}[1;1H",
    "a\u{7f}",
    "\u{9b}31m",
    "\u{202e}gnp",
    "a\u{2028}b",
    ".hidden",
    "meta.json",
    "META.json",
    "sheet.png",
    "birdseye.png",
    "generated",
    "truth",
    "view",
    "forecast",
    "state.json",
];

/// Returns the bad names, including overlong ones.
fn bad(folder: &Path) -> Vec<String> {
    let outside = folder.join("outside").display().to_string();
    let mut names: Vec<String> = BAD.iter().map(|name| name.replace("OUTSIDE", &outside)).collect();
    names.extend(["x".repeat(129), "ä".repeat(100_000), "../".repeat(50_000), "cache".to_owned()]);
    names
}

/// Output folder of the commands.
const OUT: &str = "1/2/3/4/out";

/// Creates files that could be overwritten, and the folders around the output.
fn make_room(folder: &Path) {
    for place in ["outside", "1/2/3/4", "1/2/3/x", "1/2/x", "1/x"] {
        std::fs::create_dir_all(folder.join(place)).unwrap();
        std::fs::write(folder.join(place).join("color.png"), "mine").unwrap();
    }
}

/// Asserts that commands refuse a log, name its file and write nothing.
#[track_caller]
fn refuse(folder: &Path, commands: &[Vec<String>], name: &str, file: &str) {
    let before = listing(folder);
    for command in commands {
        let args: Vec<&str> = command.iter().map(String::as_str).collect();
        let what = format!("{} with a camera {name:.40?}", args[0]);
        run(folder, &args).refused(&what, &["expected a name", file]);
        assert_eq!(listing(folder), before, "{what}");
    }
}

/// Returns commands that read a log, with a skeleton of it in `sk`.
fn commands(log: &str) -> Vec<Vec<String>> {
    let render = format!("render {log} --skeleton sk --rasterizer cpu --out {OUT} --maps class");
    let texts = [
        format!("info {log}"),
        format!("build {log} --out {OUT}"),
        render.clone(),
        format!("{render} --format exr"),
        format!("simulate {log} --skeleton sk --rasterizer cpu --out {OUT} --warmup 2 --steps 2"),
    ];
    texts.iter().map(|text| text.split(' ').map(str::to_owned).collect()).collect()
}

fn build(folder: &Path, log: &str) {
    let Ended { code, stderr, .. } = run(folder, &["build", log, "--out", "sk"]);
    assert_eq!(code, Some(0), "{stderr}");
}

#[test]
fn nuscenes_channels_must_be_folder_names() {
    let log = TinyLog::new();
    let folder = log.path("");
    build(&folder, "nuscenes:log");
    make_room(&folder);
    for name in bad(&folder) {
        log.change("sensor", "/1/channel", json!(name));
        refuse(&folder, &commands("nuscenes:log"), &name, "v1.0-mini/sensor.json");
    }
    // Two cameras whose folders are the same on some file systems.
    log.change("sensor", "/1/channel", json!("cam_BACK"));
    let ended = run(&folder, &["info", "nuscenes:log"]);
    ended.refused("cases", &["differ in more than case", "CAM_BACK", "v1.0-mini/sensor.json"]);
    // Names with other scripts, dots and blanks are accepted.
    log.change("sensor", "/1/channel", json!("Kamera vörn..1 日本"));
    let args =
        format!("render nuscenes:log --skeleton sk --rasterizer cpu --out {OUT} --maps class --frames 0..1");
    let Ended { code, stderr, .. } = run(&folder, &args.split(' ').collect::<Vec<_>>());
    assert_eq!(code, Some(0), "{stderr}");
    assert!(folder.join(OUT).join("000000/Kamera vörn..1 日本/class.png").is_file());
}

#[test]
fn nuplan_channels_must_be_folder_names() {
    let nuplan = NuplanLog::new();
    let folder = nuplan.path("");
    let log = format!("nuplan:nuplan-v1.1/splits/mini/{LOG}.db");
    build(&folder, &log);
    make_room(&folder);
    let set = |from: &str, to: &str| {
        let text = |text: &str| {
            let hex: String = text.bytes().map(|byte| format!("{byte:02x}")).collect();
            format!("CAST(x'{hex}' AS TEXT)")
        };
        nuplan.sql(&format!("UPDATE camera SET channel = {} WHERE channel = {}", text(to), text(from)));
    };
    let mut last = "CAM_L0".to_owned();
    for name in bad(&folder) {
        set(&last, &name);
        refuse(&folder, &commands(&log), &name, &format!("{LOG}.db"));
        last = name;
    }
    set(&last, "cam_f0");
    run(&folder, &["info", &log]).refused("cases", &["one row in camera for a channel", LOG]);
}

#[test]
fn argoverse_sensors_must_be_folder_names() {
    let log = TinyAv2::new();
    let folder = log.root();
    let name_of_log = format!("av2:{LOG_ID}");
    build(folder, &name_of_log);
    make_room(folder);
    let set_all = |name: &str| {
        for table in ["calibration/intrinsics.feather", "calibration/egovehicle_SE3_sensor.feather"] {
            log.edit(table, |columns| {
                let rows = columns[0].1.len();
                let mut names = vec!["ring_front_center", "ring_side_left", name];
                names.extend(["a", "b", "c", "d", "e", "f", "g"].iter().take(rows - names.len()));
                set(columns, "sensor_name", texts(&names));
            });
        }
    };
    for name in bad(folder) {
        set_all(&name);
        refuse(folder, &commands(&name_of_log), &name, "calibration/intrinsics.feather");
    }
    set_all("RING_side_left");
    run(folder, &["info", &name_of_log]).refused("cases", &["every sensor once", "intrinsics.feather"]);
}

#[test]
fn listed_cameras_must_have_folder_names() {
    let log = TinyLog::new();
    let folder = log.path("");
    build(&folder, "nuscenes:log");
    make_room(&folder);
    let list = |name: &str| {
        let camera = json!({"name": name, "width": 32, "height": 16,
            "intrinsics": [[16, 0, 16], [0, 16, 8], [0, 0, 1]],
            "camera_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]});
        std::fs::write(folder.join("c.json"), json!({"cameras": [camera]}).to_string()).unwrap();
    };
    let command = format!(
        "render nuscenes:log --skeleton sk --rasterizer cpu --out {OUT} --maps class --cameras c.json"
    );
    let command: Vec<String> = command.split(' ').map(str::to_owned).collect();
    for name in bad(&folder) {
        list(&name);
        refuse(&folder, std::slice::from_ref(&command), &name, "c.json");
    }
}

#[test]
fn a_location_must_be_a_file_name() {
    let log = TinyLog::new();
    let folder = log.path("");
    build(&folder, "nuscenes:log");
    std::fs::create_dir_all(log.path("log/maps/expansion")).unwrap();
    std::fs::write(log.path("log/secret.json"), "{}").unwrap();
    for location in ["../../secret", "../secret", "/etc/passwd", "a/../../secret", "a\0", "\u{1b}[2J", ".."] {
        log.change("log", "/0/location", json!(location));
        let before = listing(&folder);
        for maps in ["log/maps", "log"] {
            let args =
                format!("render nuscenes:log --skeleton sk --rasterizer cpu --out out --map-root {maps}");
            let ended = run(&folder, &args.split(' ').collect::<Vec<_>>());
            ended.refused(location, &["expected a name", "as location of the log", maps]);
        }
        assert_eq!(listing(&folder), before, "{location:?}");
    }
}

/// Names in the data cannot control a terminal or flood it.
#[test]
fn messages_escape_names() {
    let log = TinyLog::new();
    for name in
        ["\u{1b}]0;owned\u{7}\u{1b}[2J", "a\r\nerror: all is well", "\u{9b}2J", &"long ".repeat(20_000)]
    {
        log.change("scene", "/0/name", json!(name));
        run(&log.path(""), &["info", "nuscenes:log#other"])
            .refused("scene", &["#SCENE to name one of", "scene.json"]);
        let named: String = name.chars().filter(|c| *c != '\0').take(4000).collect();
        let unknown = run(&log.path(""), &["info", &format!("nuscenes:log#{named}x")]);
        unknown.refused("locator", &["#SCENE to name one of", "scene.json"]);
    }
    log.change("scene", "/0/name", json!("tiny"));
    for (table, pointer, text) in [
        ("instance", "/0/category_token", "whose category \\x1b[31myyy"),
        ("sample", "/0/next", "to hold token \\x1b[31myyy"),
        ("scene", "/0/log_token", "to hold token \\x1b[31myyy"),
    ] {
        log.change(table, pointer, json!(format!("\u{1b}[31m{}", "y".repeat(100_000))));
        run(&log.path(""), &["info", "nuscenes:log", "--missing", "error"]).refused(table, &[text, "(1000"]);
        log.change(
            table,
            pointer,
            json!(if table == "instance" {
                "k1"
            } else if table == "sample" {
                "s1"
            } else {
                "l"
            }),
        );
    }
}
