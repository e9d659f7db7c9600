//! A synthetic log in the layout of py123d, written with `arrow-ipc`'s writers.
//!
//! Four frames 100 ms apart. The ego drives 1 m per frame in the direction of [`YAW`]. A car keeps its
//! distance ahead of it; a pedestrian stands still. Two cameras take an image 10 ms after each frame:
//! `pcam_f0` stores PNG files in its table, `pcam_l0` names files below [`TinyPy123d::sensor_root`]. Sweeps
//! are Arrow IPC streams.

mod map;
mod pack;
mod table;
mod tables;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use point_skeleton::dataset::py123d::{FORMAT, Py123d};
use point_skeleton::dataset::{DatasetError, LogLocator};
use point_skeleton::geometry::Pose;

pub use map::{line, polygon};
pub use pack::{Pack, packed};
pub use table::{
    Columns, Table, binaries, integer_lists, integers, text_lists, texts, vector_lists, vectors,
};
pub use tables::{camera_mount, image, point, sweep};

pub const LOG: &str = "2026.01.02.made";
pub const SPLIT: &str = "made_train";
pub const FRAMES: usize = 4;
pub const FIRST_US: i64 = 1_700_000_000_000_000;
pub const STEP_US: i64 = 100_000;
/// Delay of an image after its frame, µs.
pub const IMAGE_US: i64 = 10_000;
/// Start of the ego, meters.
pub const START: DVec3 = DVec3::new(5000.0, 2000.0, 60.0);
/// Direction of the ego, radians.
pub const YAW: f64 = 0.5;
/// Height and width of images.
pub const SIZE: [u32; 2] = [48, 64];
/// Intrinsics fx fy cx cy skew of both cameras.
pub const INTRINSICS: [f64; 5] = [32.0, 33.0, 31.5, 23.5, 0.0];
/// Distortion k1 k2 p1 p2 k3 of both cameras; the images of `pcam_l0` are undistorted.
pub const DISTORTION: [f64; 5] = [-0.2, 0.1, 0.001, -0.002, 0.0];
/// Points of a sweep.
pub const POINTS: usize = 60;

pub const SYNC: &str = "sync";
pub const EGO: &str = "ego_state_se3";
pub const BOXES: &str = "box_detections_se3";
pub const LIGHTS: &str = "traffic_light_detections";
pub const FRONT: &str = "camera.pcam_f0";
pub const LEFT: &str = "camera.pcam_l0";
pub const LIDAR: &str = "lidar.lidar_merged";
pub const MAP: &str = "map";

/// A folder `ROOT` with one log in `ROOT/logs/SPLIT/LOG`.
pub struct TinyPy123d {
    root: tempfile::TempDir,
    pub tables: BTreeMap<String, Table>,
}

impl Default for TinyPy123d {
    fn default() -> Self {
        Self::new()
    }
}

impl TinyPy123d {
    pub fn new() -> Self {
        let log = Self { root: tempfile::tempdir().unwrap(), tables: tables::all() };
        std::fs::create_dir_all(log.folder()).unwrap();
        log.tables.iter().for_each(|(name, table)| table.write(&log.path(name)).unwrap());
        for frame in 0..FRAMES {
            let path = log.sensor_root().join(picture(frame));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            image(frame).save(path).unwrap();
        }
        log
    }

    pub fn root(&self) -> &Path {
        self.root.path()
    }

    /// Returns the folder of the log.
    pub fn folder(&self) -> PathBuf {
        self.root().join("logs").join(SPLIT).join(LOG)
    }

    /// Returns the folder of the images that `pcam_l0` names.
    pub fn sensor_root(&self) -> PathBuf {
        self.root().join("sensors")
    }

    /// Returns the file of a table.
    pub fn path(&self, table: &str) -> PathBuf {
        self.folder().join(format!("{table}.arrow"))
    }

    pub fn locator(&self) -> LogLocator {
        LogLocator { sensor_root: Some(self.sensor_root()), ..LogLocator::new(&FORMAT, self.folder()) }
    }

    pub fn open(&self) -> Result<Py123d, DatasetError> {
        Py123d::open(&self.locator())
    }

    /// Changes a table and writes it.
    pub fn edit(&mut self, name: &str, edit: impl FnOnce(&mut Table)) {
        let path = self.path(name);
        let table = self.tables.get_mut(name).unwrap();
        edit(table);
        table.write(&path).unwrap();
    }

    /// Opens the log and checks that the error message is one line, has all parts and ends with the file's
    /// name.
    #[track_caller]
    pub fn refuses(&self, parts: &[&str], ending: &str) {
        assert_message(&self.open().err().expect("a damaged log"), parts, ending);
    }
}

/// Checks that a message is one line, has all parts and ends with a name.
#[track_caller]
pub fn assert_message(error: &dyn std::fmt::Display, parts: &[&str], ending: &str) {
    let message = error.to_string();
    assert!(message.ends_with(ending), "{message:?} does not end with {ending:?}");
    assert!(!message.contains('\n') && message.len() < 600, "{message:?}");
    for part in parts {
        assert!(message.contains(part), "{message:?} does not contain {part:?}");
    }
}

pub fn frame_us(frame: usize) -> i64 {
    FIRST_US + STEP_US * frame as i64
}

/// Returns the pose of the ego, at parts of frames too.
pub fn ego(frame: f64) -> Pose {
    let ahead = Pose::from_yaw(YAW, DVec3::ZERO).transform_point(DVec3::X * frame);
    Pose::from_yaw(YAW, START + ahead)
}

/// Returns the name of an image of `pcam_l0` below the sensor root.
pub fn picture(frame: usize) -> String {
    format!("samples/PCAM_L0/{}.png", frame_us(frame) + IMAGE_US)
}

/// Returns x y z qw qx qy qz.
pub fn se3(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], [qw, qx, qy, qz]) = (pose.translation.to_array(), pose.wxyz());
    [x, y, z, qw, qx, qy, qz]
}
