//! Every log against `expected.json` beside it, written by the API of py123d.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DVec3};
use point_skeleton::dataset::{Frame, ImageRecord, LogReader, Recording, open};
use point_skeleton::geometry::Pose;
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::{locator, recorded};

/// Tolerance of numbers that are only converted.
const EXACT: f64 = 1e-9;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap()
}

fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the largest difference of a pose from a 4×4 matrix.
fn difference(pose: &Pose, matrix: &Value) -> f64 {
    let rows: Vec<Vec<f64>> = matrix.as_array().unwrap().iter().map(numbers).collect();
    let rotation = DMat3::from_quat(pose.rotation).transpose().to_cols_array_2d();
    let rotation =
        (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| (rotation[i][j] - rows[i][j]).abs());
    let offset = (0..3).map(|i| (pose.translation[i] - rows[i][3]).abs());
    rotation.chain(offset).fold(0.0, f64::max)
}

#[test]
fn recorded_logs_are_read_as_py123d_reads_them() {
    let Some(folders) = recorded() else { return };
    for folder in folders {
        check(&folder);
    }
}

fn check(folder: &Path) {
    let name = folder.file_name().unwrap().to_string_lossy().into_owned();
    let expected: Value =
        serde_json::from_slice(&std::fs::read(folder.join("expected.json")).unwrap()).unwrap();
    let reader = open(&locator(folder, text(&expected["log"]["dataset"]))).unwrap();
    let log = reader.recording();
    assert_eq!(log.name, text(&expected["log"]["log_name"]), "{name}");
    assert_eq!(log.location, expected["log"]["location"].as_str().unwrap_or_default(), "{name}");
    let frames = expected["frames"].as_array().unwrap();
    let with_ego: Vec<&Value> = frames.iter().filter(|frame| !frame["ego"].is_null()).collect();
    assert_eq!(log.frames.len(), with_ego.len(), "{name}");
    for (frame, expected) in log.frames.iter().zip(&with_ego) {
        assert_eq!(frame.t_us, expected["timestamp_us"].as_i64().unwrap(), "{name}");
        check_boxes(log, frame, expected, &name);
    }
    check_ego(log, &with_ego, &name);
    check_cameras(reader.as_ref(), &expected, &with_ego, &name);
    check_sweeps(reader.as_ref(), &with_ego, &name);
    check_lights(log, &with_ego, &name);
    check_map(reader.as_ref(), &expected["map"], &name);
    if with_ego.len() == frames.len() {
        assert_eq!(log.tracks.len() as u64, expected["boxes"]["tracks"].as_u64().unwrap(), "{name}");
    }
}

/// The named pose; in tables with many more poses than frames the one at the frame's time, which is the named
/// one where that has the time of the frame.
fn check_ego(log: &Recording, expected: &[&Value], name: &str) {
    let mut same = 0;
    for (frame, expected) in log.frames.iter().zip(expected) {
        let ego = &expected["ego"];
        let found = difference(&frame.global_from_ego, &ego["imu_to_global"]);
        let late_s = (number(&ego["timestamp_us"]) - frame.t_us as f64) / 1e6;
        let is_dense = number(&expected["rows"]["ego_state_se3"]) >= 2.0 || late_s.abs() < 0.01;
        if found <= EXACT {
            same += 1;
        } else {
            // As far as the ego drives at 20 m/s until then.
            assert!(
                is_dense && late_s.abs() < 0.01 && found <= 20.0 * late_s.abs(),
                "{name}: {found} m, {late_s} s"
            );
        }
    }
    assert!(same > 0 || log.frames.is_empty() || name.starts_with("nuplan"), "{name}");
}

fn check_boxes(log: &Recording, frame: &Frame, expected: &Value, name: &str) {
    let expected = &expected["boxes"];
    if expected.is_null() {
        assert!(frame.boxes.is_empty(), "{name}");
        return;
    }
    assert_eq!(frame.boxes.len() as u64, expected["count"].as_u64().unwrap(), "{name}");
    let Some(list) = expected["list"].as_array() else { return };
    let by_track: BTreeMap<&str, &Value> = list.iter().map(|item| (text(&item["track"]), item)).collect();
    assert_eq!(by_track.len(), frame.boxes.len(), "{name}");
    for item in &frame.boxes {
        let expected = by_track[log.tracks[item.track].id.as_str()];
        let center = DVec3::from_slice(&numbers(&expected["center"]));
        let size = DVec3::from_slice(&numbers(&expected["length_width_height"]));
        let wxyz = numbers(&expected["quaternion_wxyz"]);
        assert!((item.cuboid.pose.translation - center).length() <= EXACT, "{name}");
        assert!((item.cuboid.size - size).length() <= EXACT, "{name}");
        let found = item.cuboid.pose.wxyz();
        let sign = f64::signum(found.iter().zip(&wxyz).map(|(a, b)| a * b).sum());
        assert!(
            found.iter().zip(&wxyz).all(|(a, b)| (a - sign * b).abs() < 1e-6),
            "{name}: {found:?} {wxyz:?}"
        );
    }
}

fn all_images(log: &Recording) -> impl Iterator<Item = &ImageRecord> {
    log.frames.iter().flat_map(|frame| frame.images.iter().chain(&frame.between_images))
}

fn check_cameras(reader: &dyn LogReader, expected: &Value, frames: &[&Value], name: &str) {
    let log = reader.recording();
    let known = expected["cameras"].as_object().unwrap();
    assert_eq!(log.cameras.len(), known.len(), "{name}");
    for (channel, camera) in log.cameras.iter().enumerate() {
        let (id, rig) = (camera.to_lowercase(), &log.rig[channel]);
        let about = &known[&id];
        let size = [rig.camera.width, rig.camera.height].map(f64::from);
        assert_eq!(size, [number(&about["width"]), number(&about["height"])], "{name}");
        if about["camera_model"] == "PINHOLE" {
            let [fx, fy, cx, cy, skew] = numbers(&about["intrinsics"])[..] else { panic!("{name}") };
            assert_eq!(rig.camera.rows(), [[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]], "{name}");
        }
        // Version 0.2.1 wrote wrong mounting poses of PandaSet, but right poses of images.
        if expected["log"]["version"] != "0.2.1" {
            assert!(difference(&rig.ego_from_camera, &about["camera_to_imu"]) <= EXACT, "{name} {camera}");
        }
        for (index, frame) in frames.iter().enumerate() {
            let expected = &frame["cameras"][&id];
            let Some(t_us) = expected["timestamp_us"].as_i64() else { continue };
            let of = |record: &&ImageRecord| record.channel == channel && record.t_us == t_us;
            let record = all_images(log).find(of).unwrap_or_else(|| panic!("{name}: {camera} at {t_us}"));
            let pose = record.global_from_ego * record.ego_from_camera;
            // Poses that are not stored are interpolated.
            let tolerance = if name == "made-variety" { 1e-6 } else { EXACT };
            let found = difference(&pose, &expected["camera_to_global"]);
            assert!(found <= tolerance, "{name}: {camera} at {t_us}: {found}");
            // Decoding takes a while: the first and the last image of each camera.
            if index == 0 || index + 1 == frames.len() {
                check_image(reader, record, expected, name);
            }
            reader.check_image(record).map_or_else(|_| assert!(name.contains("mp4")), |()| ());
        }
    }
}

fn check_image(reader: &dyn LogReader, record: &ImageRecord, expected: &Value, name: &str) {
    let found = reader.read_image(record);
    if name.contains("mp4") {
        let message = found.unwrap_err().to_string();
        assert!(message.contains("jpeg_binary") && message.contains("MPEG-4"), "{message}");
        assert!(message.contains(".mp4"), "{message}");
        return;
    }
    let image = found.unwrap();
    assert_eq!(
        [image.width(), image.height()].map(f64::from).as_slice(),
        numbers(&expected["size"]),
        "{name}"
    );
    let pixels = f64::from(image.width() * image.height());
    for (channel, mean) in numbers(&expected["rgb_mean"]).into_iter().enumerate() {
        let sum: f64 = image.pixels().map(|pixel| f64::from(pixel[channel])).sum();
        assert!((sum / pixels - mean).abs() <= 0.5, "{name}: {} {mean}", sum / pixels);
    }
    if name.contains("png") || name == "made-variety" {
        assert_eq!(hash(&image), text(&expected["rgb_sha256"]), "{name}");
    }
}

fn check_sweeps(reader: &dyn LogReader, frames: &[&Value], name: &str) {
    let log = reader.recording();
    for (frame, expected) in log.frames.iter().zip(frames) {
        let lidars = expected["lidars"].as_object().unwrap();
        let own: Vec<_> = frame.sweeps.iter().filter(|sweep| sweep.is_key).collect();
        assert_eq!(own.len(), lidars.len(), "{name} at {}", frame.t_us);
        for (record, (_, expected)) in own.into_iter().zip(lidars) {
            let found = reader.read_sweep(record);
            if name == "pandaset-paths" {
                let message = found.unwrap_err().to_string();
                assert!(message.contains("a file of pandaset") && message.contains("binary"), "{message}");
                continue;
            }
            let sweep = found.unwrap();
            let declared = reader.check_sweep(record).unwrap();
            let count = expected["points"].as_u64().unwrap();
            assert_eq!((sweep.points.len() as u64, declared), (count, Some(count)), "{name}");
            // Points of files are in the frame of the LiDAR.
            let is_path = expected["stored"].is_string();
            let ego = |point: [f32; 3]| match is_path {
                false => point.map(f64::from),
                true => record.ego_from_lidar.transform_point(DVec3::from(point.map(f64::from))).to_array(),
            };
            let points: Vec<[f64; 3]> = sweep.points.iter().map(|point| ego(point.position)).collect();
            let tolerance = if is_path { 5e-5 } else { 1e-5 };
            let near = |found: &[[f64; 3]], expected: &Value| {
                let expected = expected.as_array().unwrap().iter().map(numbers);
                let pairs = found.iter().zip(expected);
                pairs.for_each(|(a, b)| {
                    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= tolerance), "{name}: {a:?} {b:?}")
                });
            };
            near(&points[..3], &expected["first"]);
            near(&points[points.len() - 3..], &expected["last"]);
            for axis in 0..3 {
                let of =
                    |start: f64, join: fn(f64, f64) -> f64| points.iter().map(|p| p[axis]).fold(start, join);
                let found = [of(f64::INFINITY, f64::min), of(f64::NEG_INFINITY, f64::max)];
                let bounds = [number(&expected["min"][axis]), number(&expected["max"][axis])];
                assert!(
                    (0..2).all(|i| (found[i] - bounds[i]).abs() <= tolerance),
                    "{name}: {found:?} {bounds:?}"
                );
            }
            let is_ipc =
                expected["stored"]["magic"].as_str().is_some_and(|magic| magic.starts_with("ffffffff"));
            if is_ipc {
                let bytes: Vec<u8> =
                    sweep.points.iter().flat_map(|p| p.position).flat_map(f32::to_le_bytes).collect();
                assert_eq!(hash(&bytes), text(&expected["xyz_f32_sha256"]), "{name}");
            }
            check_features(&sweep, expected, is_path, name);
        }
    }
}

/// Intensities, and the numbers of LiDARs or beams.
fn check_features(sweep: &point_skeleton::dataset::Sweep, expected: &Value, is_path: bool, name: &str) {
    let features = &expected["features"];
    if let Some(hashed) = features["intensity"]["sha256"].as_str().filter(|_| !is_path) {
        let bytes: Vec<u8> = sweep.points.iter().map(|point| point.intensity as u8).collect();
        assert_eq!(hash(&bytes), hashed, "{name}");
    }
    // The number of a single LiDAR is not read.
    let counts = expected["points_per_id"].as_object().filter(|counts| counts.len() > 1);
    if let (true, Some(counts)) = (sweep.devices && !is_path, counts) {
        let mut found = BTreeMap::new();
        sweep.points.iter().for_each(|point| *found.entry(point.ring).or_insert(0_u64) += 1);
        // The lowest number of the file is LiDAR 0.
        let counts: Vec<u64> = counts.values().map(|count| count.as_u64().unwrap()).collect();
        assert_eq!(found.into_values().collect::<Vec<_>>(), counts, "{name}");
    } else if let Some(hashed) = features["channel"]["sha256"].as_str().filter(|_| !is_path) {
        let bytes: Vec<u8> = sweep.points.iter().map(|point| point.ring as u8).collect();
        assert_eq!(hash(&bytes), hashed, "{name}");
    }
}

fn check_lights(log: &Recording, frames: &[&Value], name: &str) {
    let mut expected = Vec::new();
    for (frame, content) in frames.iter().enumerate() {
        for light in content["traffic_lights"].as_array().into_iter().flatten() {
            let color = match text(&light[1]) {
                "OFF" => "unknown".to_owned(),
                color => color.to_lowercase(),
            };
            expected.push((frame, light[0].as_i64().unwrap().to_string(), color));
        }
    }
    expected.sort();
    let found =
        log.lights.iter().map(|light| (light.frame, light.lane_connector.clone(), light.color.clone()));
    assert_eq!(found.collect::<Vec<_>>(), expected, "{name}");
}

fn check_map(reader: &dyn LogReader, expected: &Value, name: &str) {
    let map = reader.read_map().unwrap();
    assert_eq!(map.is_some(), !expected.is_null(), "{name}");
    let Some(map) = map else { return };
    let layer = |name: &str| expected["layers"][name]["objects"].as_u64().unwrap_or(0) as usize;
    assert_eq!(map.lanes.len() + map.lane_connectors.len(), layer("LANE"), "{name}");
    assert_eq!(map.crossings.len(), layer("CROSSWALK"), "{name}");
    assert_eq!(map.walkways.len(), layer("WALKWAY"), "{name}");
    assert_eq!(map.stop_lines.len(), layer("STOP_ZONE"), "{name}");
    assert_eq!(map.dividers.len(), layer("ROAD_LINE"), "{name}");
    let length = |line: &Vec<glam::DVec2>| line.windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f64>();
    let found: f64 = map.dividers.iter().map(length).sum();
    let lines = &expected["layers"]["ROAD_LINE"]["length"];
    assert!(lines.is_null() || (found - number(lines)).abs() <= 1e-6 * found, "{name}: {found} {lines}");
    // The bounds of all lanes, by their corners.
    let lanes = map.lanes.iter().chain(&map.lane_connectors).flat_map(|lane| &lane.outline.exterior);
    let (low, high) = lanes
        .fold((glam::DVec2::INFINITY, glam::DVec2::NEG_INFINITY), |(low, high), corner| {
            (low.min(*corner), high.max(*corner))
        });
    let bounds = &expected["layers"]["LANE"]["bounds"];
    if !bounds.is_null() {
        let found = [low.x, low.y, high.x, high.y];
        assert!(
            found.iter().zip(numbers(bounds)).all(|(a, b)| (a - b).abs() <= 1e-6),
            "{name}: {found:?} {bounds}"
        );
    }
}
