//! Columns of sweeps: their meaning is recognized by content, never guessed from values or lengths.

use std::path::PathBuf;

use point_skeleton::dataset::nuscenes::read_sweep_file;
use point_skeleton::dataset::{LogReader, Sweep, SweepPoint};
use serde_json::Value;

use super::Case;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FRAMES, TinyLog, sweep};
use pskel_testing::nuplan_log::{NuplanLog, sweep_file};
use pskel_testing::shared::shared;

/// Builds a log of a case, and returns the content of `skeleton.json`.
#[track_caller]
fn build(case: &Case, name: &str, options: &str) -> Value {
    case.succeed(format!("build nuscenes:in/{name} --out {name} {options}").trim_end());
    case.json(&format!("{name}/skeleton.json"))
}

/// Returns what a skeleton's points are: the counts of its build, and the checksums of its clouds.
fn points(skeleton: &Value) -> Value {
    let mut report = skeleton["report"].clone();
    report["notes"] = Value::Null;
    serde_json::json!([report, skeleton["background"], skeleton["actors"]])
}

fn count(skeleton: &Value, key: &str) -> u64 {
    skeleton["report"][key].as_u64().unwrap()
}

/// Lists the sweep files of a case's log.
fn sweeps(case: &Case, name: &str) -> Vec<PathBuf> {
    let folder = case.path().join("in").join(name).join("samples/LIDAR_TOP");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    files
}

/// Replaces the rows of every sweep of a log. `change` gets the number of a row and its five values.
fn rewrite(files: &[PathBuf], change: impl Fn(usize, [f32; 5]) -> Vec<u8>) {
    for path in files {
        let raw = std::fs::read(path).unwrap();
        let (rows, _) = raw.as_chunks::<20>();
        let values = |row: &[u8; 20]| {
            let (values, _) = row.as_chunks::<4>();
            std::array::from_fn(|i| f32::from_le_bytes(values[i]))
        };
        let bytes: Vec<u8> = rows.iter().enumerate().flat_map(|(k, row)| change(k, values(row))).collect();
        std::fs::write(path, bytes).unwrap();
    }
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn ring_numbers_of_one_lidar_do_not_drop_moving_actors() {
    let Some(case) = Case::new("data/01-ring-is-constant") else { return };
    let right = build(&case, "right", "");
    let actors = right["actors"].as_array().unwrap();
    let actor_points: u64 = actors.iter().map(|actor| actor["points"].as_u64().unwrap()).sum();
    assert_eq!((actors.len(), actor_points, count(&right, "dropped_ghost")), (77, 17_206, 157));
    for name in ["a", "b"] {
        assert_eq!(points(&build(&case, name, "")), points(&right), "{name}");
    }
    // Beams are certain if there is one number, and said otherwise.
    let (stdout, _) = case.succeed("info nuscenes:in/b");
    assert!(stdout.contains("sweeps with few ring numbers, read as beams (--ring-is device"), "{stdout}");
    let (stdout, _) = case.succeed("info nuscenes:in/a");
    assert!(!stdout.contains("ring"), "{stdout}");
    // Other numbers, which merged LiDARs do not have.
    let files = sweeps(&case, "b");
    for ring in [
        &(|_: usize| 0.0_f32) as &dyn Fn(usize) -> f32,
        &|_| 3.0,
        &|_| -1.0,
        &|_| 0.5,
        &|k| (k % 2) as f32,
        &|k| (k % 3) as f32,
        &|k| (k % 4 + 1) as f32,
        &|k| (k % 3) as f32 + 0.25,
        &|k| [0.0, 2.0][k % 2],
    ] {
        rewrite(&files, |k, row| bytes(&[row[0], row[1], row[2], row[3], ring(k)]));
        assert_eq!(points(&build(&case, "b", "")), points(&right));
    }
    // Four beams as a LiDAR has them: layers of elevations.
    rewrite(&files, |_, row| {
        let slope = row[2] / row[0].hypot(row[1]);
        let ring = [-0.10, -0.04, 0.0].iter().filter(|limit| slope > **limit).count();
        bytes(&[row[0], row[1], row[2], row[3], ring as f32])
    });
    assert_eq!(points(&build(&case, "b", "")), points(&right));
}

#[test]
fn options_and_directions_name_merged_lidars() {
    let Some(case) = Case::new("data/01-ring-is-constant") else { return };
    // The recording has two LiDARs; the second looks forward.
    let Some(data) = shared("the recording") else { return };
    let folder = data.join("data/pandaset-002/nuscenes/samples/LIDAR_TOP");
    for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).take(5) {
        assert!(read_sweep_file(&path).unwrap().devices, "{}", path.display());
    }
    let right = build(&case, "right", "");
    let forced = build(&case, "b", "--ring-is device");
    assert!(count(&forced, "dropped_ghost") > 5 * count(&right, "dropped_ghost"));
    // One LiDAR of another number: nothing says that the boxes do not match it.
    let constant = build(&case, "a", "--ring-is device");
    assert_eq!(points(&constant), points(&right));
    let notes = constant["report"]["notes"].as_object().unwrap();
    assert!(notes.keys().any(|note| note.contains("without LiDAR 0")), "{notes:?}");
}

#[test]
fn sweeps_with_four_columns_are_read() {
    let Some(case) = Case::new("data/02-sweeps-of-four-columns") else { return };
    for name in ["a", "b"] {
        let built = build(&case, name, "");
        let notes = built["report"]["notes"].as_object().unwrap();
        assert!(notes.keys().any(|note| note.starts_with("sweeps of four columns")), "{notes:?}");
        let length = std::fs::metadata(&sweeps(&case, name)[0]).unwrap().len();
        let file = sweeps(&case, name)[0].strip_prefix(case.path()).unwrap().display().to_string();
        let (stdout, _) = case.succeed(&format!("info {file} --json"));
        let info: Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!(info["points"], length / 16);
        assert!(info["min"][2].as_f64().unwrap() > -20.0, "{info}");
        let (stdout, _) = case.succeed(&format!("info nuscenes:in/{name}"));
        assert!(stdout.contains("sweeps of four columns"), "{stdout}");
    }
    // The same points as with rings of one LiDAR.
    let four = points(&build(&case, "a", ""));
    for path in sweeps(&case, "a") {
        let raw = std::fs::read(&path).unwrap();
        let rows = raw.chunks_exact(16).flat_map(|row| [row, &[0; 4]].concat());
        std::fs::write(&path, rows.collect::<Vec<u8>>()).unwrap();
    }
    assert_eq!(points(&build(&case, "a", "")), four);
}

#[test]
fn rejects_rows_of_another_layout() {
    let Some(case) = Case::new("data/01-ring-is-constant") else { return };
    let files = sweeps(&case, "right");
    let original: Vec<Vec<u8>> = files.iter().map(|path| std::fs::read(path).unwrap()).collect();
    let six = |k: usize, row: [f32; 5]| bytes(&[&row[..], &[k as f32 * 1e-5]].concat());
    let three = |_: usize, row: [f32; 5]| bytes(&row[..3]);
    let double = |_: usize, row: [f32; 5]| row.iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
    let four_double =
        |_: usize, row: [f32; 5]| row[..4].iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
    let big = |_: usize, row: [f32; 5]| row.iter().flat_map(|v| v.to_be_bytes()).collect();
    let whole =
        |_: usize, row: [f32; 5]| row.iter().flat_map(|v| ((v * 1000.0) as i32).to_le_bytes()).collect();
    type Convert<'a> = &'a dyn Fn(usize, [f32; 5]) -> Vec<u8>;
    let kinds: [(Convert<'_>, &str); 6] = [
        (&six, "repeat every 6 floats"),
        (&three, "repeat every 3 floats"),
        (&double, "floats of 8 bytes"),
        (&four_double, "floats of 8 bytes"),
        (&big, "big-endian floats"),
        (&whole, "integers of 4 bytes"),
    ];
    for (change, found) in kinds {
        for length in [0, 1] {
            files
                .iter()
                .zip(&original)
                .for_each(|(path, raw)| std::fs::write(path, &raw[20 * length..]).unwrap());
            rewrite(&files, change);
            let name = files[0].file_name().unwrap().to_string_lossy().into_owned();
            let file = files[0].strip_prefix(case.path()).unwrap().display().to_string();
            for args in ["build nuscenes:in/right --out sk", &format!("info {file}")] {
                let ended = case.run(args);
                assert_eq!(ended.code, Some(1), "{args}");
                assert!(ended.stderr.contains(found), "{}", ended.stderr);
                assert!(ended.stderr.contains("x y z intensity ring"), "{}", ended.stderr);
            }
            let info = case.run("info nuscenes:in/right");
            assert!(info.stdout.contains(found) && info.stdout.contains(&name), "{}", info.stdout);
        }
    }
}

#[test]
fn pcd_headers_are_recognized_at_any_length_and_name() {
    let Some(case) = Case::new("data/03-pcd-sweeps") else { return };
    let (a, b) = (build(&case, "a", ""), build(&case, "b", ""));
    assert_eq!(points(&a), points(&b));
    assert!(count(&a, "points_read") > 80_000, "{}", a["report"]);
    // Without its header, each file is a sweep in the layout of nuScenes with the same points.
    for path in sweeps(&case, "a") {
        let raw = std::fs::read(&path).unwrap();
        let end = b"DATA binary\n";
        let start = raw.windows(end.len()).position(|part| part == end).unwrap() + end.len();
        std::fs::write(&path, &raw[start..]).unwrap();
    }
    assert_eq!(points(&build(&case, "a", "")), points(&b));
}

#[test]
fn columns_that_are_not_finite_keep_the_points() {
    let Some(case) = Case::new("data/04-nan-in-unused-column") else { return };
    for (name, column) in [("ring", "ring"), ("intensity", "intensity"), ("half", "ring")] {
        let built = build(&case, name, "");
        assert_eq!(count(&built, "dropped_not_finite"), 0);
        let notes = built["report"]["notes"].as_object().unwrap();
        let (_, points) =
            notes.iter().find(|(note, _)| note.starts_with(&format!("points whose {column}"))).unwrap();
        let share = if name == "half" { 2 } else { 1 };
        assert!(points.as_u64().unwrap().abs_diff(count(&built, "points_read") / share) < 4, "{notes:?}");
        let (stdout, _) = case.succeed(&format!("info nuscenes:in/{name}"));
        assert!(stdout.contains(&format!("points whose {column}")), "{stdout}");
    }
    let files = sweeps(&case, "ring");
    rewrite(&files, |_, row| bytes(&[f32::NAN, row[1], row[2], row[3], 1.0]));
    let ended = case.run("build nuscenes:in/ring --out none");
    assert_eq!(ended.code, Some(1));
    assert!(ended.stderr.contains("expected points with finite coordinates"), "{}", ended.stderr);
}

/// The three layouts agree: without recordings.
#[test]
fn points_are_retained_without_rings_or_intensities() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out out/before");
    let before = points(&log.json("out/before/skeleton.json"));
    for frame in 0..FRAMES {
        let path = log.path(&sweep(frame));
        let SweepPoint { position: [x, y, z], .. } = read_sweep_file(&path).unwrap().points[0];
        let raw = std::fs::read(&path).unwrap();
        assert_eq!(bytes(&[x, y, z]), raw[..12]);
        let without =
            raw.chunks_exact(20).flat_map(|row| [&row[..12], &bytes(&[f32::NAN, f32::INFINITY])].concat());
        std::fs::write(&path, without.collect::<Vec<u8>>()).unwrap();
    }
    let summary = log.succeed("build nuscenes:log --out out/after");
    assert!(summary.contains("points whose intensity is not finite"), "{summary}");
    assert_eq!(points(&log.json("out/after/skeleton.json")), before);
}

#[test]
fn rejects_other_formats_by_name_in_every_layout() {
    let log = TinyLog::new();
    let nuplan = NuplanLog::new();
    for (start, name) in [
        (&b"\x93NUMPY\x01\0v\0{'descr': '<f4'"[..], "an NPY array"),
        (b"PK\x03\x04", "a ZIP archive (unpack it)"),
        (b"ply\nformat binary_little_endian 1.0\n", "a PLY file"),
        (b"ARROW1\0\0", "an Arrow file (Feather)"),
        (b"1.0 2.0 3.0 4.0 5.0\n1.0 2.0 3.0 4.0 5.0\n", "text"),
    ] {
        let length = 4000 - start.len();
        let file = if name == "text" { start.repeat(50) } else { [start, &vec![7; length]].concat() };
        for path in [log.path(&sweep(0)), nuplan.blob(&sweep_file(0))] {
            std::fs::write(path, &file).unwrap();
        }
        let ended = log.run("build nuscenes:log --out out/none --missing error");
        let message = String::from_utf8_lossy(&ended.stderr).into_owned();
        let shown = if name == "text" {
            "found text that begins with \"1.0 2.0".to_owned()
        } else {
            format!("found {name}: ")
        };
        assert!(message.contains(&shown) && message.contains("0.pcd.bin"), "{message}");
        let found = if name == "text" { "found \"1.0 2.0".to_owned() } else { format!("found {name}: ") };
        let message = read(&nuplan).unwrap_err();
        assert!(message.contains(&found), "{message}");
    }
}

/// Reads the first sweep of a nuPlan log.
fn read(nuplan: &NuplanLog) -> Result<Sweep, String> {
    let dataset = nuplan.open().unwrap();
    dataset.read_sweep(&dataset.recording().frames[0].sweeps[0]).map_err(|error| error.to_string())
}
