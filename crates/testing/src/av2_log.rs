//! A synthetic log in Argoverse 2 layout, written with `arrow-ipc`'s writer.
//!
//! Three frames 100 ms apart. The ego drives 1 m per frame along x. The back of a car stays 8 m ahead of it;
//! a sign is static. Seven ring cameras cover the surroundings; each takes an image 10 ms after a frame.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{
    ArrayRef, Float16Array, Float64Array, Int32Array, Int64Array, RecordBatch, StringArray, UInt8Array,
    UInt16Array,
};
use arrow_ipc::CompressionType;
use arrow_ipc::reader::FileReader;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use glam::{DQuat, DVec3};
use half::f16;
use point_skeleton::dataset::av2::Argoverse;
use point_skeleton::dataset::{DatasetError, LogLocator};
use serde_json::{Value, json};

use crate::tiny_log::camera_rotation;

pub const LOG_ID: &str = "0a1b2c3d";
pub const FRAMES: usize = 3;
pub const FIRST_NS: i64 = 315_966_000_000_000_123;
pub const STEP_NS: i64 = 100_000_000;
/// Delay of an image after its frame, ns.
pub const IMAGE_NS: i64 = 10_000_000;
/// Start position of the ego, meters in city coordinates.
pub const START: DVec3 = DVec3::new(5000.0, 2000.0, 60.0);
pub const SIZE: [u16; 2] = [48, 64];
/// Cameras in ring order, with their yaw to the left in degrees.
pub const RING: [(&str, f64); 7] = [
    ("ring_front_center", 0.0),
    ("ring_front_right", -45.0),
    ("ring_side_right", -90.0),
    ("ring_rear_right", -150.0),
    ("ring_rear_left", 150.0),
    ("ring_side_left", 90.0),
    ("ring_front_left", 45.0),
];
pub const MAP: &str = "map/log_map_archive_0a1b2c3d____PIT_city_1.json";

/// Columns of a table, with their names.
pub type Columns = Vec<(String, ArrayRef)>;

/// A folder that contains one log.
pub struct TinyAv2 {
    folder: tempfile::TempDir,
}

impl Default for TinyAv2 {
    fn default() -> Self {
        Self::new()
    }
}

impl TinyAv2 {
    pub fn new() -> Self {
        let log = Self { folder: tempfile::tempdir().unwrap() };
        for folder in ["calibration", "map", "sensors/lidar", "sensors/cameras"] {
            std::fs::create_dir_all(log.path(folder)).unwrap();
        }
        let lz4 = Some(CompressionType::LZ4_FRAME);
        write(&log.path("annotations.feather"), annotations(), lz4);
        write(&log.path("city_SE3_egovehicle.feather"), poses(), Some(CompressionType::ZSTD));
        write(&log.path("calibration/intrinsics.feather"), intrinsics(), None);
        write(&log.path("calibration/egovehicle_SE3_sensor.feather"), extrinsics(), lz4);
        for frame in 0..FRAMES {
            write(&log.path(&sweep(frame)), sweep_columns(), lz4);
            for (camera, _) in RING {
                let image = image::RgbImage::from_fn(SIZE[1].into(), SIZE[0].into(), |x, y| {
                    image::Rgb([3 * x as u8, 4 * y as u8, 90])
                });
                let path = log.path(&picture(frame, camera));
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                image.save(path).unwrap();
            }
        }
        std::fs::write(log.path(MAP), map().to_string()).unwrap();
        log
    }

    /// Returns the folder that contains the log.
    pub fn root(&self) -> &Path {
        self.folder.path()
    }

    /// Returns the path of a log file.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root().join(LOG_ID).join(name)
    }

    pub fn open(&self) -> Result<Argoverse, DatasetError> {
        Argoverse::open(&LogLocator::new(&point_skeleton::dataset::av2::FORMAT, self.path("")))
    }

    /// Edits the columns of a table.
    pub fn edit(&self, name: &str, edit: impl FnOnce(&mut Columns)) {
        let path = self.path(name);
        let mut columns = read(&path);
        edit(&mut columns);
        write(&path, columns, Some(CompressionType::LZ4_FRAME));
    }

    /// Opens the log and checks that the error message contains all parts and ends with the file's name.
    #[track_caller]
    pub fn refuses(&self, parts: &[&str], ending: &str) {
        let message = self.open().expect_err("a damaged log").to_string();
        assert!(message.ends_with(ending), "{message:?} does not end with {ending:?}");
        for part in parts {
            assert!(message.contains(part), "{message:?} does not contain {part:?}");
        }
    }
}

/// Replaces a column.
pub fn set(columns: &mut Columns, name: &str, values: ArrayRef) {
    columns.iter_mut().find(|(n, _)| n == name).unwrap().1 = values;
}

/// Changes one number of an `f64` column.
pub fn set_number(columns: &mut Columns, name: &str, row: usize, value: f64) {
    let (_, column) = columns.iter_mut().find(|(n, _)| n == name).unwrap();
    let old = column.as_any().downcast_ref::<Float64Array>().unwrap();
    let mut numbers = old.values().to_vec();
    numbers[row] = value;
    *column = Arc::new(Float64Array::from(numbers));
}

pub fn texts(values: &[&str]) -> ArrayRef {
    Arc::new(StringArray::from(values.to_vec()))
}

pub fn integers(values: Vec<i64>) -> ArrayRef {
    Arc::new(Int64Array::from(values))
}

pub fn numbers(values: Vec<f64>) -> ArrayRef {
    Arc::new(Float64Array::from(values))
}

pub fn write(path: &Path, columns: Columns, compression: Option<CompressionType>) {
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let options = IpcWriteOptions::default().try_with_compression(compression).unwrap();
    let file = File::create(path).unwrap();
    let mut writer = FileWriter::try_new_with_options(file, &batch.schema(), options).unwrap();
    writer.write(&batch).unwrap();
    writer.finish().unwrap();
}

/// Reads the columns of a one-batch table.
pub fn read(path: &Path) -> Columns {
    let batch = FileReader::try_new(File::open(path).unwrap(), None).unwrap().next().unwrap().unwrap();
    let names = batch.schema().fields().iter().map(|f| f.name().clone()).collect::<Vec<_>>();
    names.into_iter().zip(batch.columns().iter().cloned()).collect()
}

pub fn frame_ns(frame: usize) -> i64 {
    FIRST_NS + STEP_NS * frame as i64
}

pub fn sweep(frame: usize) -> String {
    format!("sensors/lidar/{}.feather", frame_ns(frame))
}

pub fn picture(frame: usize, camera: &str) -> String {
    format!("sensors/cameras/{camera}/{}.jpg", frame_ns(frame) + IMAGE_NS)
}

fn named(columns: Vec<(&str, ArrayRef)>) -> Columns {
    columns.into_iter().map(|(name, values)| (name.to_owned(), values)).collect()
}

/// Returns the seven pose columns.
fn pose_columns(poses: &[(DQuat, DVec3)]) -> Vec<(&'static str, ArrayRef)> {
    let column = |of: fn(&(DQuat, DVec3)) -> f64| numbers(poses.iter().map(of).collect());
    vec![
        ("qw", column(|p| p.0.w)),
        ("qx", column(|p| p.0.x)),
        ("qy", column(|p| p.0.y)),
        ("qz", column(|p| p.0.z)),
        ("tx_m", column(|p| p.1.x)),
        ("ty_m", column(|p| p.1.y)),
        ("tz_m", column(|p| p.1.z)),
    ]
}

/// Returns the boxes of every frame: a car whose back is 8 m ahead of the ego, and a sign beside the road.
fn annotations() -> Columns {
    let per_frame = |values: [f64; 2]| numbers(values.repeat(FRAMES));
    let boxes: Vec<_> = (0..FRAMES)
        .flat_map(|frame| {
            let sign = DVec3::new(6.0 - frame as f64, 3.0, 1.0);
            [DVec3::new(10.0, 0.0, 0.8), sign].map(|at| (DQuat::IDENTITY, at))
        })
        .collect();
    let mut columns = vec![
        ("timestamp_ns", integers((0..FRAMES).flat_map(|f| [frame_ns(f); 2]).collect())),
        ("track_uuid", texts(&["car", "a sign"].repeat(FRAMES))),
        ("category", texts(&["REGULAR_VEHICLE", "SIGN"].repeat(FRAMES))),
        ("length_m", per_frame([4.0, 0.5])),
        ("width_m", per_frame([2.0, 0.5])),
        ("height_m", per_frame([1.6, 2.0])),
    ];
    columns.extend(pose_columns(&boxes));
    columns.push(("num_interior_pts", integers([11 * 7, 0].repeat(FRAMES))));
    named(columns)
}

/// Returns the ego poses every 50 ms, from before the first frame until after the last.
fn poses() -> Columns {
    let halves = -1..=2 * FRAMES as i64;
    let ego = |half: i64| (DQuat::IDENTITY, START + DVec3::X * (0.5 * half as f64));
    let mut columns =
        vec![("timestamp_ns", integers(halves.clone().map(|h| FIRST_NS + STEP_NS / 2 * h).collect()))];
    columns.extend(pose_columns(&halves.map(ego).collect::<Vec<_>>()));
    named(columns)
}

/// Returns the camera names in the data set's order (alphabetical), with one stereo camera.
fn sensor_names() -> Vec<&'static str> {
    let mut names: Vec<&str> = RING.iter().map(|(name, _)| *name).collect();
    names.sort_unstable();
    names.push("stereo_front_left");
    names
}

fn intrinsics() -> Columns {
    let names = sensor_names();
    let all = |value: f64| numbers(vec![value; names.len()]);
    let size = |value: u16| Arc::new(UInt16Array::from(vec![value; names.len()])) as ArrayRef;
    let mut columns = vec![("sensor_name", texts(&names))];
    columns.extend([("fx_px", all(32.0)), ("fy_px", all(32.0)), ("cx_px", all(32.0)), ("cy_px", all(24.0))]);
    columns.extend([("k1", all(-0.2)), ("k2", all(0.1)), ("k3", all(0.0))]);
    columns.extend([("height_px", size(SIZE[0])), ("width_px", size(SIZE[1]))]);
    named(columns)
}

fn extrinsics() -> Columns {
    let mut names = sensor_names();
    names.push("up_lidar");
    let yaw = |name: &str| RING.iter().find(|(n, _)| *n == name).map_or(0.0, |(_, yaw)| yaw.to_radians());
    let place = |name: &&str| (camera_rotation(yaw(name)), DVec3::new(0.0, 0.0, 1.5));
    let mut columns = vec![("sensor_name", texts(&names))];
    columns.extend(pose_columns(&names.iter().map(place).collect::<Vec<_>>()));
    named(columns)
}

/// Returns the points of a sweep in the ego frame: the surrounding ground, and the back of the car as 11 by 7
/// points.
fn sweep_columns() -> Columns {
    let ground = (0..60)
        .flat_map(|i| (0..40).map(move |j| [0.5 * f64::from(i) - 5.0, 0.5 * f64::from(j) - 10.0, 0.0]));
    let back = (0..11)
        .flat_map(|i| (0..7).map(move |j| [8.0, 0.125 * f64::from(i) - 0.625, 0.25 + 0.125 * f64::from(j)]));
    let points: Vec<[f64; 3]> = ground.chain(back).collect();
    let axis = |i: usize| {
        Arc::new(Float16Array::from_iter_values(points.iter().map(|p| f16::from_f64(p[i])))) as ArrayRef
    };
    let bytes =
        |of: fn(usize) -> u8| Arc::new(UInt8Array::from_iter_values((0..points.len()).map(of))) as ArrayRef;
    named(vec![
        ("x", axis(0)),
        ("y", axis(1)),
        ("z", axis(2)),
        ("intensity", bytes(|i| (i % 200) as u8)),
        ("laser_number", bytes(|i| (i % 64) as u8)),
        ("offset_ns", Arc::new(Int32Array::from_iter_values((0..points.len()).map(|i| i as i32)))),
    ])
}

pub fn map() -> Value {
    let line = |points: &[[f64; 2]]| -> Value {
        points.iter().map(|[x, y]| json!({"x": START.x + x, "y": START.y + y, "z": START.z})).collect()
    };
    let lane = |id: i64, is_intersection: bool, left: f64, marks: [&str; 2], successors: &[i64]| {
        let along = |y: f64| if is_intersection { [[20.0, y], [30.0, y]] } else { [[0.0, y], [20.0, y]] };
        json!({"id": id, "is_intersection": is_intersection, "lane_type": "VEHICLE",
            "left_lane_boundary": line(&along(left)), "left_lane_mark_type": marks[0],
            "right_lane_boundary": line(&along(left - 4.0)), "right_lane_mark_type": marks[1],
            "successors": successors, "predecessors": [], "left_neighbor_id": null,
            "right_neighbor_id": null})
    };
    json!({
        "lane_segments": {
            "9": lane(9, false, 2.0, ["SOLID_YELLOW", "DASHED_WHITE"], &[7]),
            "8": lane(8, false, -2.0, ["DASHED_WHITE", "NONE"], &[]),
            "7": lane(7, true, 2.0, ["NONE", "NONE"], &[99]),
        },
        "drivable_areas": {"1": {"id": 1, "area_boundary": line(&[[0.0, -6.0], [30.0, -6.0], [30.0, 2.0],
        [0.0, 2.0]])}},
        "pedestrian_crossings": {"2": {"id": 2, "edge1": line(&[[20.0, -6.0], [20.0, 2.0]]),
            "edge2": line(&[[23.0, 2.0], [23.0, -6.0]])}},
    })
}
