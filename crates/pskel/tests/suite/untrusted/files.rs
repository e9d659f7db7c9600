//! File names in data sets, and devices, FIFOs, folders and files outside the data set in place of regular
//! files.

use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::Path;

use rustix::fs::{CWD, FileType, mknodat};
use serde_json::{Value, json};

use super::guarded::{Ended, listing, run};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::TinyLog;
use pskel_testing::av2_log::{LOG_ID, TinyAv2, picture, sweep};
use pskel_testing::nuplan_log::{LOG, NuplanLog, RING, image_file, sweep_file};

/// Kinds of objects in place of a file, with the error message for each.
const KINDS: [(&str, &str); 5] = [
    ("fifo", "expected a regular file, found a FIFO"),
    ("device", "expected a regular file, found a device"),
    ("folder", "expected a regular file, found a folder"),
    ("socket", "expected a regular file, found a socket"),
    ("loop", "cannot read: "),
];

/// Replaces whatever is at a path by an object of a kind.
fn put(kind: &str, path: &Path) {
    if std::fs::remove_file(path).is_err() {
        let _ = std::fs::remove_dir(path);
    }
    match kind {
        "fifo" => mknodat(CWD, path, FileType::Fifo, 0o600.into(), 0).unwrap(),
        "device" => symlink("/dev/zero", path).unwrap(),
        "folder" => std::fs::create_dir(path).unwrap(),
        "socket" => drop(UnixListener::bind(path).unwrap()),
        _ => symlink(path.file_name().unwrap(), path).unwrap(),
    }
}

/// Asserts that each command refuses every kind of non-regular file, and names the file.
#[track_caller]
fn refuse_all_kinds(folder: &Path, file: &Path, commands: &[&str]) {
    refuse_kinds(&KINDS, folder, file, commands);
}

#[track_caller]
fn refuse_kinds(kinds: &[(&str, &str)], folder: &Path, file: &Path, commands: &[&str]) {
    let whole = std::fs::read(file).unwrap();
    for (kind, message) in kinds {
        put(kind, file);
        let before = listing(folder);
        for command in commands {
            let ended = run(folder, &command.split(' ').collect::<Vec<_>>());
            let what = format!("{command} with a {kind} for {}", file.display());
            ended.refused(&what, &[message, file.file_name().unwrap().to_str().unwrap()]);
            // An unfinished build may remain, as after any damaged file.
            let mut after = listing(folder);
            after.retain(|name, _| !name.starts_with("new.partial"));
            assert_eq!(after, before, "{what}");
        }
        let _ = std::fs::remove_dir_all(folder.join("new.partial"));
        if std::fs::remove_file(file).is_err() {
            std::fs::remove_dir(file).unwrap();
        }
    }
    std::fs::write(file, whole).unwrap();
}

/// Runs `info`, which names damaged sensor files and then fails.
#[track_caller]
fn damaged(folder: &Path, log: &str) -> String {
    let Ended { code, stdout, stderr } = run(folder, &["info", log]);
    assert_eq!(code, Some(1), "{stderr}");
    stdout
}

const BUILD: &str = "build nuscenes:log --out new --missing error";

/// JSON pointers of the first sweep's and the first image's file name.
const FIRST: [&str; 2] = ["/0/filename", "/1/filename"];

#[test]
fn file_names_stay_below_the_data_set() {
    let log = TinyLog::new();
    let folder = log.path("");
    std::fs::create_dir(log.path("elsewhere")).unwrap();
    let original: Value = log.json("log/v1.0-mini/sample_data.json");
    for (pointer, name) in FIRST.into_iter().zip(["a.pcd.bin", "a.png"]) {
        let own = original.pointer(pointer).unwrap().as_str().unwrap();
        std::fs::copy(log.path("log").join(own), log.path("elsewhere").join(name)).unwrap();
        put("fifo", &log.path("elsewhere/fifo"));
        let absolute = |name: &str| folder.join("elsewhere").join(name).display().to_string();
        let inside = format!("samples/../{own}");
        let before = listing(&folder);
        for outside in
            [&absolute(name), &absolute("fifo"), &format!("../elsewhere/{name}"), &inside, "/dev/zero", ".."]
        {
            log.change("sample_data", pointer, json!(outside));
            for command in [BUILD, "info nuscenes:log"] {
                let ended = run(&folder, &command.split(' ').collect::<Vec<_>>());
                ended.refused(outside, &["as filename of sample_data", "v1.0-mini/sample_data.json"]);
                // No option makes `..` the name of a file.
                let hint = ended.stderr.contains("--allow-outside permits paths outside");
                assert_eq!(hint, outside != "..", "{outside}: {}", ended.stderr);
            }
        }
        for none in ["", ".", "a\0b", "/"] {
            log.change("sample_data", pointer, json!(none));
            let ended = run(&folder, &["info", "nuscenes:log", "--allow-outside"]);
            ended.refused(none, &["expected the name of a file", "v1.0-mini/sample_data.json"]);
        }
        // `--allow-outside` permits files outside the data set, but not devices or FIFOs.
        for outside in [&absolute(name), &format!("../elsewhere/{name}"), &inside] {
            log.change("sample_data", pointer, json!(outside));
            let Ended { code, stderr, .. } =
                run(&folder, &[&BUILD.split(' ').collect::<Vec<_>>()[..], &["--allow-outside"]].concat());
            assert_eq!(code, Some(0), "{outside}: {stderr}");
            std::fs::remove_dir_all(log.path("new")).unwrap();
        }
        for (outside, kind) in [("/dev/zero".to_owned(), "a device"), (absolute("fifo"), "a FIFO")] {
            log.change("sample_data", pointer, json!(outside));
            let args = [&BUILD.split(' ').collect::<Vec<_>>()[..], &["--allow-outside"]].concat();
            let ended = run(&folder, &args);
            ended.refused(&outside, &["expected a regular file", kind, &outside]);
            let _ = std::fs::remove_dir_all(log.path("new.partial"));
        }
        log.change("sample_data", pointer, json!(own));
        assert_eq!(listing(&folder).len(), before.len());
    }
    // Data sets are commonly assembled from links.
    std::fs::rename(log.path("log/samples"), log.path("elsewhere/samples")).unwrap();
    symlink("../elsewhere/samples", log.path("log/samples")).unwrap();
    log.succeed(BUILD);
}

#[test]
fn nuscenes_sensor_files_must_be_regular() {
    let log = TinyLog::new();
    for file in ["log/samples/0.pcd.bin", "log/samples/0-CAM_FRONT.png"] {
        refuse_all_kinds(&log.path(""), &log.path(file), &[BUILD]);
        for (kind, message) in KINDS {
            let whole = std::fs::read(log.path(file)).unwrap();
            put(kind, &log.path(file));
            let reported = damaged(&log.path(""), "nuscenes:log");
            assert!(reported.contains(message) && reported.contains(file), "{reported}");
            put("fifo", &log.path(file));
            std::fs::remove_file(log.path(file)).unwrap();
            std::fs::write(log.path(file), whole).unwrap();
        }
    }
    // Larger than any sweep or image, in a sparse file.
    for file in ["log/samples/0.pcd.bin", "log/samples/0-CAM_FRONT.png"] {
        let whole = std::fs::read(log.path(file)).unwrap();
        std::fs::File::create(log.path(file)).unwrap().set_len(4 << 40).unwrap();
        run(&log.path(""), &BUILD.split(' ').collect::<Vec<_>>()).refused(file, &["a file of at most", file]);
        std::fs::write(log.path(file), whole).unwrap();
    }
}

#[test]
fn nuscenes_tables_must_be_regular_files() {
    let log = TinyLog::new();
    for table in ["scene", "sample_data", "ego_pose", "sensor", "sample_annotation"] {
        let file = log.path(&format!("log/v1.0-mini/{table}.json"));
        refuse_all_kinds(&log.path(""), &file, &["info nuscenes:log", BUILD]);
    }
}

#[test]
fn nuplan_files_must_be_regular() {
    let nuplan = NuplanLog::new();
    let (folder, log) = (nuplan.path(""), format!("nuplan:nuplan-v1.1/splits/mini/{LOG}.db"));
    let commands = [format!("info {log}"), format!("build {log} --out new --missing error")];
    let commands = commands.each_ref().map(String::as_str);
    for file in [nuplan.blob(&sweep_file(0)), nuplan.blob(&image_file(RING[0], 0))] {
        refuse_all_kinds(&folder, &file, &commands[1..]);
        let whole = std::fs::read(&file).unwrap();
        put("fifo", &file);
        assert!(damaged(&folder, &log).contains("expected a regular file, found a FIFO"));
        std::fs::remove_file(&file).unwrap();
        std::fs::write(&file, whole).unwrap();
    }
    // A folder in its place is read as a folder of logs.
    let kinds = KINDS.into_iter().filter(|(kind, _)| *kind != "folder").collect::<Vec<_>>();
    refuse_kinds(&kinds, &folder, &nuplan.database(), &commands);
    for file in [nuplan.map(), nuplan.path("maps/nuplan-maps-v1.0.json")] {
        let whole = std::fs::read(&file).unwrap();
        put("fifo", &file);
        assert!(damaged(&folder, &log).contains("expected a regular file, found a FIFO"));
        std::fs::remove_file(&file).unwrap();
        std::fs::write(&file, whole).unwrap();
    }
    for name in ["../../x.pcd", "/dev/zero", "/etc/passwd", "a/../b", ""] {
        nuplan.sql(&format!("UPDATE lidar_pc SET filename = '{name}'"));
        run(&folder, &["info", &log]).refused(name, &["as filename of lidar_pc", LOG]);
    }
}

#[test]
fn argoverse_files_must_be_regular() {
    let log = TinyAv2::new();
    let commands = [format!("info av2:{LOG_ID}"), format!("build av2:{LOG_ID} --out new --missing error")];
    let commands = commands.each_ref().map(String::as_str);
    for file in [
        "annotations.feather",
        "city_SE3_egovehicle.feather",
        "calibration/intrinsics.feather",
        "calibration/egovehicle_SE3_sensor.feather",
    ] {
        refuse_all_kinds(log.root(), &log.path(file), &commands);
    }
    for file in [sweep(0), picture(0, "ring_front_center")] {
        refuse_all_kinds(log.root(), &log.path(&file), &commands[1..]);
    }
}

/// Files that are named on the command line.
#[test]
fn all_named_files_must_be_regular() {
    let log = TinyLog::new();
    let folder = log.path("");
    log.succeed(&format!("{BUILD} --voxel 0.5"));
    std::fs::rename(log.path("new"), log.path("sk")).unwrap();
    let camera = json!({"name": "own", "width": 32, "height": 16, "intrinsics": [[16, 0, 16], [0, 16, 8], [0,
        0, 1]],
        "camera_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]});
    std::fs::write(log.path("c.json"), json!({"cameras": [camera]}).to_string()).unwrap();
    let cpu = "--skeleton sk --rasterizer cpu --out out";
    for (file, command) in [
        ("a.npy", "splat --points a.npy --cameras c.json --out out/f.npz --rasterizer cpu".to_owned()),
        ("a.ply", "splat --points a.ply --cameras c.json --out out/f.npz --rasterizer cpu".to_owned()),
        ("c.json", format!("render nuscenes:log --cameras c.json {cpu}")),
        ("p.json", format!("render nuscenes:log --annotations p.json {cpu}")),
        ("sk/skeleton.json", "info sk".to_owned()),
        ("sk/background.points", "info sk".to_owned()),
        ("sk/actors.points", format!("render nuscenes:log {cpu}")),
        (
            "path.csv",
            format!("simulate nuscenes:log --ego file --trajectory path.csv --warmup 2 --steps 2 {cpu}"),
        ),
        (
            "w.safetensors",
            format!("simulate nuscenes:log --generator network:w.safetensors --warmup 2 --steps 2 {cpu}"),
        ),
        ("sweep.pcd", "info sweep.pcd".to_owned()),
        ("sweep.feather", "info sweep.feather".to_owned()),
        ("picture.jpg", "info picture.jpg".to_owned()),
    ] {
        let path = log.path(file);
        if !path.exists() {
            std::fs::write(&path, "").unwrap();
        }
        // `info` accepts a folder as a skeleton.
        let is_folder = |kind: &str| kind == "folder" && command == format!("info {file}");
        let kinds = KINDS.into_iter().filter(|(kind, _)| !is_folder(kind)).collect::<Vec<_>>();
        refuse_kinds(&kinds, &folder, &path, &[&command]);
    }
}
