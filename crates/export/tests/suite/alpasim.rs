//! The layout `alpasim`: the archive, and its documents compared with the log.
//! `python/tests/test_export_alpasim.py` reads the tables.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::Path;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use point_skeleton::Log;
use point_skeleton::conditions::ConditionOptions;
use point_skeleton::dataset::{LogLocator, LogOutline, LogReader};
use point_skeleton::raster::RasterizerKind;
use pskel_export::{Export, ExportOptions, ExportReport, Layout, WorkList, export};
use serde_json::{Value, json};
use zip::{CompressionMethod, DateTime, ZipArchive};

use crate::made_log::{CAMERAS, FORMAT, MadeLog, START};

const FRAMES: usize = 5;

fn run(out: &Path, frames: Option<[usize; 2]>) -> ExportReport {
    let outline = LogOutline { name: "made.up".into(), frames: FRAMES };
    let options = ExportOptions {
        layout: Layout::Alpasim,
        conditions: ConditionOptions::default(),
        selection: Default::default(),
        substitutes: Default::default(),
        format: Default::default(),
        frames,
        shard_frames: 2,
        images: false,
        times: Default::default(),
        color_folder: String::new(),
        validation_logs: Default::default(),
        prompt: Default::default(),
        captions: Default::default(),
    };
    let range = frames.map(|[first, end]| first..end);
    let list = WorkList::new([(LogLocator::new(&FORMAT, "made.up"), outline)], usize::MAX, range).unwrap();
    export(Export {
        list: Some(&list),
        part: &list,
        out,
        skeletons: &out.with_extension("skeletons"),
        options: &options,
        open: &|_| Ok(Log::new(Box::new(MadeLog::new("made.up", FRAMES)))),
        rasterizer: &RasterizerKind::Cpu.into(),
        jobs: 1,
        verify: false,
        progress: &(),
    })
    .unwrap()
}

/// Returns the archive of an export and its files by path.
fn exported(frames: Option<[usize; 2]>) -> (Vec<u8>, BTreeMap<String, Vec<u8>>) {
    let folder = tempfile::tempdir().unwrap();
    let report = run(&folder.path().join("out"), frames);
    assert_eq!((report.failures.as_slice(), report.written), (&[][..], 1));
    let bytes = std::fs::read(folder.path().join("out/made_up.usdz")).unwrap();
    let mut zip = ZipArchive::new(Cursor::new(bytes.clone())).unwrap();
    let mut files = BTreeMap::new();
    for index in 0..zip.len() {
        let mut file = zip.by_index(index).unwrap();
        let name = file.name().unwrap().into_owned();
        assert_eq!(file.compression(), CompressionMethod::Stored);
        assert_eq!(file.last_modified(), Some(DateTime::default()));
        assert_eq!(file.data_start().unwrap() % 64, 0, "{name}");
        let mut content = Vec::new();
        file.read_to_end(&mut content).unwrap();
        files.insert(name, content);
    }
    (bytes, files)
}

fn parsed(files: &BTreeMap<String, Vec<u8>>, name: &str) -> Value {
    serde_json::from_slice(&files[name]).unwrap()
}

fn matrix(value: &Value) -> DAffine3 {
    let rows: [[f64; 4]; 4] = serde_json::from_value(value.clone()).unwrap();
    DAffine3::from_mat4(DMat4::from_cols_array_2d(&rows).transpose())
}

fn assert_near(found: DAffine3, expected: DAffine3) {
    assert!(found.abs_diff_eq(expected, 1e-9), "{found} instead of {expected}");
}

#[test]
fn archives_are_stored_and_reproducible() {
    let (bytes, files) = exported(None);
    let names: Vec<&str> = files.keys().map(String::as_str).collect();
    let first_us = MadeLog::new("made.up", 1).recording().frames[0].t_us;
    // The second camera is triggered before the frames: its first image is of the second one.
    let rear = format!("frames/camera_rear_tele_30fov/{}.jpeg", first_us + 60_000);
    let front = format!("frames/camera_front_wide_120fov/{first_us}.jpeg");
    let expected = [
        "clipgt/calibration_estimate.parquet",
        "clipgt/egomotion_estimate.parquet",
        "clipgt/obstacle.parquet",
        &front,
        &rear,
        "metadata.yaml",
        "rig_trajectories.json",
        "sequence_tracks.json",
    ];
    assert_eq!(names, expected);
    let image = image::load_from_memory(&files[&front]).unwrap();
    assert_eq!((image.width(), image.height()), (60, 40));
    assert!(exported(None).0 == bytes);
    let (_, part) = exported(Some([1, 4]));
    assert_ne!(parsed(&part, "metadata.yaml")["uuid"], parsed(&files, "metadata.yaml")["uuid"]);
}

#[test]
fn documents_equal_the_log() {
    let (_, files) = exported(None);
    let log = MadeLog::new("made.up", FRAMES);
    let log = log.recording();
    let rig = parsed(&files, "rig_trajectories.json");
    let global_from_local = matrix(&rig["T_world_base"]);
    assert_eq!(global_from_local.translation, START.floor());
    let trajectory = &rig["rig_trajectories"][0];
    assert_eq!(trajectory["sequence_id"], "made.up");
    let times: Vec<i64> = log.frames.iter().map(|frame| frame.t_us).collect();
    assert_eq!(trajectory["T_rig_world_timestamps_us"], json!(times));
    for (frame, pose) in log.frames.iter().zip(trajectory["T_rig_worlds"].as_array().unwrap()) {
        assert_near(global_from_local * matrix(pose), frame.global_from_ego.affine());
    }
    for (camera, name) in log.rig.iter().zip(CAMERAS) {
        let found = &rig["camera_calibrations"][name];
        assert_eq!(found["logical_sensor_name"], name);
        assert_near(matrix(&found["T_sensor_rig"]), camera.ego_from_camera.affine());
        let parameters = &found["camera_model"]["parameters"];
        assert_eq!(parameters["focal_length"], json!([40.0, 40.0]));
        assert_eq!(parameters["principal_point"], json!([30.0, 20.0]));
        assert_eq!(parameters["resolution"], json!([60, 40]));
    }
    let ends = |name: &str| -> Vec<i64> {
        let shutters = trajectory["cameras_frame_timestamps_us"][name].as_array().unwrap();
        shutters.iter().map(|shutter| shutter[1].as_i64().unwrap()).collect()
    };
    assert_eq!(ends("CAM_FRONT"), times);
    assert_eq!(ends("CAM_BACK"), times[1..].iter().map(|t_us| t_us - 40_000).collect::<Vec<_>>());
    assert_eq!(ends("camera_rear_tele_30fov"), ends("CAM_BACK"));
}

#[test]
fn tracks_equal_the_log() {
    let (_, files) = exported(None);
    let log = MadeLog::new("made.up", FRAMES);
    let log = log.recording();
    let document = parsed(&files, "sequence_tracks.json");
    let tracks = &document["made.up"]["tracks_data"];
    assert_eq!(tracks["tracks_id"], json!(["car", "cone"]));
    assert_eq!(tracks["tracks_label_class"], json!(["automobile", "protruding_object"]));
    assert_eq!(tracks["tracks_flags"], json!([["CONTROLLABLE"], ["CONTROLLABLE"]]));
    for track in 0..2 {
        let boxes = log.track_boxes(track);
        let dims = &document["made.up"]["cuboidtracks_data"]["cuboids_dims"][track];
        assert_eq!(*dims, json!(boxes[0].1.size.to_array()));
        let times: Vec<i64> = boxes.iter().map(|(frame, _)| log.frames[*frame].t_us).collect();
        assert_eq!(tracks["tracks_timestamps_us"][track], json!(times));
        let poses: Vec<[f64; 7]> = serde_json::from_value(tracks["tracks_poses"][track].clone()).unwrap();
        for ((_, cuboid), [x, y, z, qx, qy, qz, qw]) in boxes.iter().zip(poses) {
            let position = DVec3::new(x, y, z) + START.floor();
            let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
            assert_near(DAffine3::from_rotation_translation(rotation, position), cuboid.pose.affine());
        }
    }
}

#[test]
fn tracks_with_one_box_are_skipped_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    // The cone is gone in the last frame.
    let report = run(&folder.path().join("out"), Some([3, 5]));
    let expected = BTreeMap::from([("tracks with a single box (skipped)".to_owned(), 1)]);
    assert_eq!(report.notes, expected);
}

#[test]
fn rejects_logs_of_one_frame() {
    let folder = tempfile::tempdir().unwrap();
    let report = run(&folder.path().join("out"), Some([4, 5]));
    let error = &report.failures[0].error;
    let expected = "expected at least 2 key frames with the layout alpasim in log made.up, found 1";
    assert_eq!(error, expected);
}
