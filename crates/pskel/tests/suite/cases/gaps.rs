//! Missing and damaged parts of a log: one policy for all readers.

use std::os::unix::fs::symlink;
use std::path::Path;

use serde_json::Value;

use super::Case;
use crate::tiny_log::{CAMERAS, TinyLog, picture, sweep};
use crate::untrusted::guarded;
use pskel_testing::av2_log::{self, TinyAv2};
use pskel_testing::nuplan_log::{NuplanLog, RING, image_file};
use pskel_testing::shared::shared;

const DB: &str = "nuplan-v1.1/splits/mini/2020.01.01.00.00.00_veh-02_00000_00079.db";

/// Runs `pskel` in a folder with arguments separated by spaces.
fn pskel(folder: &Path, args: &str) -> guarded::Ended {
    guarded::run(folder, &args.split(' ').collect::<Vec<_>>())
}

#[track_caller]
fn succeed(folder: &Path, args: &str) -> String {
    let ended = pskel(folder, args);
    assert_eq!(ended.code, Some(0), "{args}: {}", ended.stderr);
    ended.stdout + &ended.stderr
}

/// Returns the description of a log and the exit code.
#[track_caller]
pub(super) fn info(folder: &Path, log: &str) -> (Value, Option<i32>) {
    let ended = pskel(folder, &format!("info --json {log}"));
    (serde_json::from_str(&ended.stdout).unwrap_or_else(|_| panic!("{}", ended.stderr)), ended.code)
}

/// Asserts the one policy: `build` skips and counts, `info` names the part and fails if a file is missing or
/// damaged, and with `--missing error` every command refuses the log with the name of the part.
#[track_caller]
pub(super) fn assert_policy(folder: &Path, log: &str, note: &str, named: &str, info_code: i32) {
    let text = succeed(folder, &format!("build {log} --out policy"));
    assert!(text.contains(note), "{text}\nexpected {note}");
    let (json, code) = info(folder, log);
    assert_eq!(code, Some(info_code), "{json:#}");
    let lists = format!("{} {}", json["damaged"], json["gaps"]);
    assert!(lists.contains(named), "{lists}\nexpected {named}");
    for command in [
        format!("build {log} --out strict --missing error"),
        format!(
            "render {log} --skeleton policy --out strict --missing error --frames 0..1 --maps depth --size \
                8x12 \
             --rasterizer cpu"
        ),
    ] {
        let ended = pskel(folder, &command);
        // A damaged file is not noticed by a command that does not read it.
        if command.starts_with("render") && ended.code == Some(0) {
            assert!(note.starts_with("1 damaged"), "{command}");
            continue;
        }
        ended.refused(&command, &[named]);
    }
}

#[test]
fn missing_files_are_skipped_and_counted_in_nuscenes() {
    for (file, note) in
        [(picture(1, CAMERAS[1]), "1 missing image files"), (sweep(1), "1 missing sweep files")]
    {
        let log = TinyLog::new();
        std::fs::remove_file(log.path(&file)).unwrap();
        let name = Path::new(&file).file_name().unwrap().to_str().unwrap();
        assert_policy(&log.path(""), "nuscenes:log", note, name, 1);
    }
}

/// A download without the blobs of sweeps between key frames, or of all cameras.
#[test]
fn parts_of_a_download_may_be_missing() {
    let Some(shared) = shared("the recording") else { return };
    let source = shared.join("data/pandaset-002/nuscenes");
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    std::fs::create_dir_all(log.join("samples")).unwrap();
    symlink(source.join("v1.0-mini"), log.join("v1.0-mini")).unwrap();
    symlink(source.join("samples/LIDAR_TOP"), log.join("samples/LIDAR_TOP")).unwrap();
    let (json, code) = info(folder.path(), "nuscenes:log");
    let (images, frames) =
        (json["left_out"]["missing image files"].as_u64().unwrap(), json["frames"].as_u64().unwrap());
    assert_eq!((images, code), (6 * frames, Some(1)));
    assert_eq!(json["damaged"].as_array().unwrap().len() as u64, images);
    assert_eq!((&json["sweeps"], json["cameras"].as_array().unwrap().len()), (&json["frames"], 6));
    let text = succeed(folder.path(), "build nuscenes:log --out sk --frames 0..1");
    assert!(text.contains(&format!("{images} missing image files")) && text.contains("0 images"), "{text}");
    std::fs::remove_file(log.join("samples/LIDAR_TOP")).unwrap();
    pskel(folder.path(), "build nuscenes:log --out none")
        .refused("no sweeps", &["LiDAR sweep", "missing sweep files"]);
}

/// A file that cannot be read for want of permission is not skipped: it may be there at the next run.
#[test]
fn errors_of_the_operating_system_are_not_skipped() {
    let log = TinyLog::new();
    let file = log.path(&picture(1, CAMERAS[1]));
    std::fs::remove_file(&file).unwrap();
    symlink(&file, &file).unwrap();
    pskel(&log.path(""), "build nuscenes:log --out sk").refused("a loop of links", &["1-CAM_BACK.png"]);
}

#[test]
fn damaged_files_are_skipped_and_counted_in_nuscenes() {
    for (file, note) in
        [(picture(1, CAMERAS[1]), "1 damaged image files"), (sweep(1), "1 damaged sweep files")]
    {
        let log = TinyLog::new();
        std::fs::write(log.path(&file), b"this is neither").unwrap();
        let name = Path::new(&file).file_name().unwrap().to_str().unwrap();
        assert_policy(&log.path(""), "nuscenes:log", note, name, 1);
    }
}

#[test]
fn missing_files_are_skipped_and_counted_in_nuplan() {
    let nuplan = NuplanLog::new();
    std::fs::remove_file(nuplan.blob(&image_file(RING[0], 0))).unwrap();
    let log = format!("nuplan:{}", nuplan.database().display());
    assert_policy(&nuplan.path(""), &log, "1 missing image files", &image_file(RING[0], 0), 1);
}

#[test]
fn missing_files_are_skipped_and_counted_in_argoverse() {
    let log = TinyAv2::new();
    let folder = log.path("sensors/cameras/ring_front_center");
    let first = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).min().unwrap();
    std::fs::remove_file(first).unwrap();
    let root = log.path("");
    assert_policy(&root, &format!("av2:{}", root.display()), "missing camera images", "ring_front_center", 0);
}

/// Sweep names are known from the annotated times, and camera folders from the calibration.
#[test]
fn missing_sweeps_and_folders_of_argoverse_are_missing_files() {
    let log = TinyAv2::new();
    let root = log.path("");
    let name = format!("av2:{}", root.display());
    std::fs::remove_file(log.path(&av2_log::sweep(1))).unwrap();
    let sweep = format!("{}.feather", av2_log::frame_ns(1));
    assert_policy(&root, &name, "1 frames without a LiDAR sweep of their own", &sweep, 1);
    let log = TinyAv2::new();
    let root = log.path("");
    std::fs::remove_dir_all(log.path("sensors/cameras/ring_side_left")).unwrap();
    let name = format!("av2:{}", root.display());
    assert_policy(&root, &name, "3 missing camera images", "ring_side_left", 1);
    assert_eq!(info(&root, &name).0["damaged"].as_array().unwrap().len(), 1);
    // A log without folders of cameras is one of a LiDAR set.
    std::fs::remove_dir_all(log.path("sensors/cameras")).unwrap();
    let (json, code) = info(&root, &name);
    assert_eq!((code, &json["damaged"]), (Some(0), &serde_json::json!([])));
    std::fs::remove_dir_all(log.path("sensors")).unwrap();
    let (json, code) = info(&root, &name);
    assert_eq!((code, json["damaged"].as_array().unwrap().len()), (Some(1), 3));
}

#[test]
fn flat_boxes_are_skipped_and_counted_in_nuscenes() {
    for size in ["[1.9, 4.5, 0.0]", "[-1.9, 4.5, 1.6]", "[0, 0, 0]"] {
        let log = TinyLog::new();
        let annotations = log.path("log/v1.0-mini/sample_annotation.json");
        let mut rows: Value = serde_json::from_slice(&std::fs::read(&annotations).unwrap()).unwrap();
        let token = rows[0]["token"].as_str().unwrap().to_owned();
        let count = rows.as_array().unwrap().len();
        rows[0]["size"] = serde_json::from_str(size).unwrap();
        std::fs::write(&annotations, rows.to_string()).unwrap();
        let root = log.path("");
        assert_policy(&root, "nuscenes:log", "1 boxes without a size", &token, 0);
        assert_eq!(info(&root, "nuscenes:log").0["boxes"], count - 1);
    }
}

/// A log of the test split has no annotations.
#[test]
fn argoverse_without_annotations_has_frames_without_actors() {
    let log = TinyAv2::new();
    std::fs::remove_file(log.path("annotations.feather")).unwrap();
    let root = log.path("");
    let name = format!("av2:{}", root.display());
    assert_policy(&root, &name, "1 logs without annotations", "annotations.feather", 0);
    let (json, _) = info(&root, &name);
    assert_eq!((&json["frames"], &json["boxes"], &json["sweeps"]), (&3.into(), &0.into(), &3.into()));
    // A file without rows is the same.
    let log = TinyAv2::new();
    log.edit("annotations.feather", |columns| columns.iter_mut().for_each(|(_, c)| *c = c.slice(0, 0)));
    let root = log.path("");
    let name = format!("av2:{}", root.display());
    assert_policy(&root, &name, "1 logs without annotations", "annotations.feather", 0);
    assert_eq!(info(&root, &name).0["frames"], 3);
    std::fs::remove_dir_all(log.path("sensors/lidar")).unwrap();
    pskel(&root, &format!("info {name}"))
        .refused("neither", &["annotations.feather, or sweeps", "found neither"]);
}

/// Neither a broken map nor a map that was not downloaded concerns a command that does not draw it.
#[test]
fn maps_that_are_not_drawn_are_not_read() {
    let nuplan = NuplanLog::new();
    let (root, log) = (nuplan.path(""), format!("nuplan:{}", nuplan.database().display()));
    succeed(&root, &format!("build {log} --out sk"));
    std::fs::remove_file(nuplan.map()).unwrap();
    let some = "--maps color,depth --size 16x24 --rasterizer cpu";
    succeed(&root, &format!("render {log} --skeleton sk --out maps --frames 0..1 {some}"));
    succeed(
        &root,
        &format!("export {log} --layout webdataset --skeletons sks --out shards --frames 0..1 {some}"),
    );
    let text = succeed(&root, &format!("simulate {log} --skeleton sk --out rollout --steps 1 {some}"));
    assert!(text.contains("metrics of the road are missing") && text.contains("map.gpkg"), "{text}");
    for command in ["render --skeleton sk --out other", "simulate --steps 1 --skeleton sk --out other"] {
        pskel(&root, &format!("{command} {log}")).refused(command, &["map.gpkg"]);
    }
    let strict = format!("simulate {log} --skeleton sk --out other --steps 1 {some} --missing error");
    pskel(&root, &strict).refused(&strict, &["map.gpkg"]);
}

#[test]
fn missing_map_layers_are_counted() {
    let nuplan = NuplanLog::new();
    nuplan.map_sql(
        "DROP TABLE carpark_areas; DELETE FROM gpkg_geometry_columns WHERE table_name = 'carpark_areas';",
    );
    let (json, code) = info(&nuplan.path(""), &format!("nuplan:{}", nuplan.database().display()));
    assert_eq!(
        (&json["left_out"]["map: maps without carpark_areas"], code),
        (&1.into(), Some(0)),
        "{json:#}"
    );
}

#[test]
fn case_one_file_missing() {
    let Some(case) = Case::new("data/10-one-file-missing") else { return };
    for (variant, note) in [
        ("image", "1 missing image files"),
        ("sweep", "1 missing sweep files"),
        ("row", "1 missing camera images"),
    ] {
        let (text, _) = case.succeed(&format!("build nuscenes:in/{variant} --out out/{variant}"));
        assert!(text.contains(note), "{text}");
        case.run(&format!("build nuscenes:in/{variant} --out out/x --missing error"))
            .refused(variant, &["missing"]);
    }
    let images =
        |variant: &str| case.json(&format!("out/{variant}/skeleton.json"))["report"]["images"].clone();
    assert_eq!((images("image"), images("row"), images("sweep")), (23.into(), 23.into(), 24.into()));
    for (variant, files) in [("image", 1), ("sweep", 1), ("row", 0)] {
        let (json, code) = info(case.path(), &format!("nuscenes:in/{variant}"));
        let damaged = json["damaged"].as_array().unwrap();
        assert_eq!((damaged.len(), code), (files, Some(i32::from(files > 0))), "{variant}: {damaged:?}");
        // Every command that reads the log goes on without the part.
        let few = "--maps color --out-size 56x100 --rasterizer cpu";
        case.succeed(&format!(
            "export nuscenes:in/{variant} --layout webdataset --skeletons out/sk-{variant} --out \
                out/shards-{variant} \
             --frames 0..1 {few}"
        ));
        case.succeed(&format!(
            "simulate nuscenes:in/{variant} --skeleton out/{variant} --out out/rollout-{variant} --steps 1 \
                {few}"
        ));
    }
}

#[test]
fn case_flat_box() {
    let Some(case) = Case::new("data/11-flat-box") else { return };
    for variant in ["zero", "negative"] {
        let (text, _) = case.succeed(&format!("info --json nuscenes:in/{variant}"));
        let json: Value = serde_json::from_str(&text).unwrap();
        assert_eq!((&json["boxes"], &json["left_out"]["boxes without a size"]), (&369.into(), &1.into()));
    }
}

#[test]
fn case_argoverse_without_annotations() {
    let Some(case) = Case::new("data/12-av2-without-annotations") else { return };
    let (text, _) = case.succeed("info --json av2:in");
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&json["boxes"], &json["left_out"]["logs without annotations"]), (&0.into(), &1.into()));
    assert_eq!(json["frames"], json["sweeps"]);
}

#[test]
fn case_map_not_requested() {
    let Some(case) = Case::new("data/09-map-not-asked-for") else { return };
    let few = "--maps color,depth --frames 0..1 --out-size 56x100 --rasterizer cpu";
    for variant in ["layer-missing", "not-downloaded", "cut-off"] {
        let log = format!("nuplan:in/{variant}/{DB}");
        case.succeed(&format!(
            "export {log} --layout webdataset --skeletons out/sk --out out/{variant} {few}"
        ));
    }
    let (json, _) = info(case.path(), &format!("nuplan:in/layer-missing/{DB}"));
    assert_eq!(json["left_out"]["map: maps without carpark_areas"], 1, "{json:#}");
    let log = format!("nuplan:in/cut-off/{DB}");
    let (json, code) = info(case.path(), &log);
    assert!(json["damaged"].to_string().contains("map.gpkg") && code == Some(1), "{json:#}");
    case.run(&format!("export {log} --layout webdataset --skeletons out/sk --out out/all --frames 0..1"))
        .refused("all maps", &["map.gpkg"]);
}
