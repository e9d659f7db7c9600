//! Content of the tables.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow_array::types::{Int32Type, UInt8Type, UInt16Type};
use arrow_array::{ArrayRef, FixedSizeBinaryArray, Float32Array, RecordBatch, UInt8Array};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::StreamWriter;
use glam::{DVec3, EulerRot};
use image::RgbImage;
use point_skeleton::geometry::Pose;
use serde_json::{Value, json};

use super::table::{Table, binaries, integer_lists, integers, text_lists, texts, vector_lists, vectors};
use super::{
    BOXES, DISTORTION, EGO, FRAMES, FRONT, IMAGE_US, INTRINSICS, LEFT, LIDAR, LIGHTS, LOG, MAP, POINTS, SIZE,
    SPLIT, STEP_US, SYNC, ego, frame_us, map, picture, se3,
};
use crate::tiny_log::camera_rotation;

pub(super) fn all() -> BTreeMap<String, Table> {
    let tables = [
        (SYNC, sync()),
        (EGO, egos()),
        (BOXES, boxes()),
        (LIGHTS, lights()),
        (FRONT, front()),
        (LEFT, left()),
        (LIDAR, sweeps()),
        (MAP, map::table()),
    ];
    tables.into_iter().map(|(name, table)| (name.to_owned(), table)).collect()
}

/// Times of the frames, or of what comes later.
fn times(late_us: i64) -> ArrayRef {
    integers((0..FRAMES).map(|frame| frame_us(frame) + late_us))
}

fn sync() -> Table {
    let ids = FixedSizeBinaryArray::try_from_iter((0..FRAMES).map(|frame| [frame as u8; 16])).unwrap();
    let mut columns = vec![("sync.uuid", Arc::new(ids) as ArrayRef), ("sync.timestamp_us", times(0))];
    for key in [EGO, BOXES, LIGHTS, FRONT, LEFT, LIDAR] {
        columns.push((key, integers(0..FRAMES as i64)));
    }
    let about = json!({
        "dataset": "nuscenes", "split": SPLIT, "log_name": LOG, "location": "nowhere", "version": "0.7.0",
        "map_metadata": null,
    });
    Table::new("", columns, &about)
}

fn egos() -> Table {
    let columns = vec![
        ("timestamp_us", times(0)),
        ("imu_se3", vectors((0..FRAMES).map(|frame| se3(&ego(frame as f64))))),
        ("dynamic_state_se3", vectors([None::<[f64; 9]>; FRAMES])),
    ];
    let about = json!({
        "vehicle_name": "made", "width": 1.9, "length": 4.7, "height": 1.6, "wheel_base": 2.9,
        "center_to_imu_se3": se3(&Pose::from_yaw(0.0, DVec3::new(1.4, 0.0, 0.8))),
        "rear_axle_to_imu_se3": se3(&Pose::IDENTITY),
    });
    Table::new("ego_state_se3.", columns, &about)
}

/// Boxes of a frame: a pedestrian, and a car 12 m ahead of the ego.
fn cuboids(frame: usize) -> Vec<[f64; 10]> {
    let car = ego(frame as f64) * Pose::from_yaw(0.0, DVec3::new(12.0, 0.0, 0.8));
    let walker = ego(0.0) * Pose::from_yaw(1.0, DVec3::new(8.0, 4.0, 0.9));
    let sized =
        |pose: &Pose, size: [f64; 3]| std::array::from_fn(|i| if i < 7 { se3(pose)[i] } else { size[i - 7] });
    vec![sized(&walker, [0.6, 0.7, 1.8]), sized(&car, [4.0, 2.0, 1.6])]
}

fn boxes() -> Table {
    let counts = |frame: usize| vec![frame as i32, 3];
    let columns = vec![
        ("timestamp_us", times(0)),
        ("bounding_box_se3", vector_lists(&(0..FRAMES).map(cuboids).collect::<Vec<_>>())),
        ("track_token", text_lists(&vec![vec!["walker", "car"]; FRAMES])),
        ("label", integer_lists::<UInt16Type>(vec![vec![10, 0]; FRAMES])),
        ("velocity_3d", vector_lists(&vec![vec![[0.0; 3], [10.0, 0.0, 0.0]]; FRAMES])),
        ("num_lidar_points", integer_lists::<Int32Type>((0..FRAMES).map(counts))),
    ];
    let about = json!({"box_detection_label_class": "py123d.parser.registry.NuScenesBoxDetectionLabel"});
    Table::new("box_detections_se3.", columns, &about)
}

/// The light of lane 12, which has another state in each frame.
fn lights() -> Table {
    let columns = vec![
        ("timestamp_us", times(0)),
        ("lane_id", integer_lists::<Int32Type>(vec![vec![12]; FRAMES])),
        ("status", integer_lists::<UInt8Type>((0..FRAMES).map(|frame| vec![frame as u8]))),
    ];
    Table::new("traffic_light_detections.", columns, &json!({}))
}

/// Returns the mounting pose of a camera.
pub fn camera_mount(key: &str) -> Pose {
    let yaw: f64 = if key == LEFT { 0.9 } else { 0.0 };
    Pose { rotation: camera_rotation(yaw), translation: DVec3::new(1.5, 0.2, 1.6) }
}

fn camera(key: &str, is_undistorted: bool) -> Value {
    json!({
        "camera_model": "pinhole", "camera_name": key.to_uppercase(), "camera_id": 1, "width": SIZE[1],
        "height": SIZE[0], "intrinsics": INTRINSICS, "distortion": DISTORTION,
        "is_undistorted": is_undistorted,
        "camera_to_imu_se3": se3(&camera_mount(key)),
    })
}

fn front() -> Table {
    let late = IMAGE_US as f64 / STEP_US as f64;
    let pose = |frame: usize| se3(&(ego(frame as f64 + late) * camera_mount(FRONT)));
    let images: Vec<Vec<u8>> = (0..FRAMES).map(|frame| png(&image(frame))).collect();
    let columns = vec![
        ("timestamp_us", times(IMAGE_US)),
        ("data", binaries(images.iter().map(Vec::as_slice))),
        ("camera_to_global_se3", vectors((0..FRAMES).map(pose))),
    ];
    Table::new("camera.pcam_f0.", columns, &camera(FRONT, false))
}

/// Paths, and no poses: they follow from the ego's.
fn left() -> Table {
    let names: Vec<String> = (0..FRAMES).map(picture).collect();
    let columns = vec![
        ("timestamp_us", times(IMAGE_US)),
        ("data", texts(names.iter().map(String::as_str))),
        ("camera_to_global_se3", vectors([None::<[f64; 7]>; FRAMES])),
    ];
    Table::new("camera.pcam_l0.", columns, &camera(LEFT, true))
}

/// Returns the image of both cameras in a frame.
pub fn image(frame: usize) -> RgbImage {
    RgbImage::from_fn(SIZE[1], SIZE[0], |x, y| image::Rgb([3 * x as u8, 4 * y as u8, 50 * frame as u8]))
}

fn png(image: &RgbImage) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn sweeps() -> Table {
    let cells: Vec<Vec<u8>> = (0..FRAMES).map(|frame| sweep(frame, POINTS)).collect();
    let columns = vec![
        ("timestamp_us", times(-STEP_US / 2)),
        ("end_timestamp_us", times(0)),
        ("data", binaries(cells.iter().map(Vec::as_slice))),
    ];
    let tilted =
        Pose { rotation: glam::DQuat::from_euler(EulerRot::ZYX, 1.5, 0.1, 0.0), translation: DVec3::Z };
    let lidar = |id: u8, mount: &Pose| {
        json!({"lidar_name": "made", "lidar_id": id, "lidar_to_imu_se3": se3(mount),
            "segmentation_label_class": null})
    };
    let mut table = Table::new("lidar.lidar_merged.", columns, &json!({"2": lidar(2, &tilted)}));
    (table.compression, table.batches) = (Some(CompressionType::LZ4_FRAME), 2);
    table
}

/// Returns a point of a sweep in the ego frame.
pub fn point(frame: usize, i: usize) -> [f32; 3] {
    [0.5 * (i % 10) as f32 + 4.0, 1.5 * (i / 10) as f32 - 4.0, 0.25 * frame as f32]
}

/// Returns a sweep with a number of points as an Arrow IPC stream.
pub fn sweep(frame: usize, points: usize) -> Vec<u8> {
    let axis = |axis: usize| {
        Arc::new(Float32Array::from_iter_values((0..points).map(|i| point(frame, i)[axis]))) as ArrayRef
    };
    let bytes = |of: fn(usize) -> u8| Arc::new(UInt8Array::from_iter_values((0..points).map(of))) as ArrayRef;
    let columns = [
        ("x", axis(0)),
        ("y", axis(1)),
        ("z", axis(2)),
        ("intensity", bytes(|i| (3 * i) as u8)),
        ("channel", bytes(|i| (i % 32) as u8)),
    ];
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let mut writer = StreamWriter::try_new(Vec::new(), &batch.schema()).unwrap();
    writer.write(&batch).unwrap();
    writer.finish().unwrap();
    writer.into_inner().unwrap()
}
