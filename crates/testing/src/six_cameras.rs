//! A synthetic log with the sensors of nuScenes: six cameras around the ego, and a LiDAR that turns twice
//! between frames. It is generated once, and written as a nuScenes data set; `table_sets` writes it as other
//! data sets in this layout.
//!
//! Six frames 200 ms apart. The ego drives 1 m per frame along x; a car drives ahead of it at the same speed,
//! a second one overtakes on the left, a cone is static.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::LazyLock;

use glam::DVec3;
use image::{Rgb, RgbImage};
use point_skeleton::dataset::nuscenes::{FORMAT, NuScenes, write_log};
use point_skeleton::dataset::{
    Class, DatasetError, Frame, ImageRecord, LogLocator, LogReader, Recording, RigCamera, Sweep, SweepPoint,
    SweepRecord, Track, TrackBox,
};
use point_skeleton::geometry::{Camera, Cuboid, Pose};

use crate::tiny_log::{camera_rotation, tree, write_tree};

pub const FRAMES: usize = 6;
/// Folder of the written tables.
pub const VERSION: &str = "v1.0-mini";
pub const FIRST_US: i64 = 1_600_000_000_000_000;
pub const STEP_US: i64 = 200_000;
/// Height and width.
const SIZE: [u32; 2] = [90, 160];
const LIDAR_Z: f64 = 1.8;
/// Cameras, their yaw to the left in degrees, and how long before a frame they take its image, microseconds.
const CAMERAS: [(&str, f64, i64); 6] = [
    ("CAM_FRONT", 0.0, 25_000),
    ("CAM_FRONT_RIGHT", -55.0, 17_000),
    ("CAM_BACK_RIGHT", -110.0, 10_000),
    ("CAM_BACK", 180.0, 0),
    ("CAM_BACK_LEFT", 110.0, 40_000),
    ("CAM_FRONT_LEFT", 55.0, 33_000),
];
const TRACKS: [(&str, &str); 3] =
    [("ahead", "vehicle.car"), ("cone", "movable_object.trafficcone"), ("left", "vehicle.car")];

/// The log in memory.
struct SixCameras(Recording);

/// Returns the time in frames since the first frame.
fn frames_since(t_us: i64) -> f64 {
    (t_us - FIRST_US) as f64 / STEP_US as f64
}

/// Returns the pose of the ego; the start is far from the origin of coordinates.
pub fn ego_at(t_us: i64) -> Pose {
    Pose::from_yaw(0.0, DVec3::new(1000.0 + frames_since(t_us), 600.0, 0.0))
}

fn boxes(t_us: i64) -> Vec<TrackBox> {
    let s = frames_since(t_us);
    let cuboid = |track, x: f64, y: f64, size: DVec3| {
        let pose = Pose::from_yaw(0.0, DVec3::new(1000.0 + x, 600.0 + y, size.z / 2.0));
        TrackBox { track, cuboid: Cuboid::new(pose, size).unwrap() }
    };
    let car = DVec3::new(4.0, 2.0, 1.6);
    vec![
        cuboid(0, 12.0 + s, 0.0, car),
        cuboid(1, 8.0, -4.0, DVec3::new(0.5, 0.5, 1.0)),
        cuboid(2, 2.0 + 2.0 * s, 4.0, car),
    ]
}

/// Returns global points: rings on the ground, and the sides of the boxes.
pub fn points(t_us: i64) -> Vec<DVec3> {
    let ego = ego_at(t_us).translation;
    let ring = |i: u32| {
        let (radius, angle) = (3.0 + 1.5 * f64::from(i / 120), f64::from(i % 120) * PI / 60.0);
        ego + DVec3::new(radius * angle.cos(), radius * angle.sin(), 0.0)
    };
    let sides = |item: &TrackBox| {
        let Cuboid { pose, size } = item.cuboid;
        let part = |k: u32| (f64::from(k) - 5.0) / 11.0;
        let side = move |i: u32| pose.translation + size * DVec3::new(part(i / 11), part(i % 11), 0.4);
        (0..121).map(side)
    };
    (0..1200).map(ring).chain(boxes(t_us).iter().flat_map(sides)).collect()
}

impl SixCameras {
    fn new() -> Self {
        let track = |(id, category): (&str, &str)| Track {
            id: id.into(),
            category: category.into(),
            class: Class::from_category(category),
        };
        let frames: Vec<Frame> = (0..FRAMES as i64).map(frame).collect();
        Self(Recording {
            name: "town-3".into(),
            location: "town".into(),
            cameras: CAMERAS.map(|(name, ..)| name.parse().unwrap()).into(),
            rig: RigCamera::first_used(&frames),
            tracks: TRACKS.map(track).into(),
            frames,
            ..Recording::default()
        })
    }
}

fn frame(index: i64) -> Frame {
    let t_us = FIRST_US + STEP_US * index;
    let sweep = |t_us: i64, is_key: bool| SweepRecord {
        path: format!("sweep {t_us}").into(),
        row: None,
        t_us,
        global_from_ego: ego_at(t_us),
        ego_from_lidar: Pose::from_yaw(0.0, DVec3::Z * LIDAR_Z),
        is_key,
    };
    let [height, width] = SIZE;
    let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    let image = |(channel, (name, yaw_deg, before_us)): (usize, &(&str, f64, i64))| ImageRecord {
        token: format!("{name} {index}"),
        channel,
        path: format!("{name} {index}").into(),
        row: None,
        t_us: t_us - before_us,
        global_from_ego: ego_at(t_us - before_us),
        ego_from_camera: Pose {
            rotation: camera_rotation(yaw_deg.to_radians()),
            translation: DVec3::new(0.0, 0.0, 1.5),
        },
        camera: Camera::new(name, width, height, [[cx, 0.0, cx], [0.0, cx, cy], [0.0, 0.0, 1.0]])
            .unwrap()
            .into(),
    };
    Frame {
        t_us,
        global_from_ego: ego_at(t_us),
        sweeps: [sweep(t_us, true)]
            .into_iter()
            .chain((index > 0).then(|| sweep(t_us - STEP_US / 2, false)))
            .collect(),
        images: CAMERAS.iter().enumerate().map(image).collect(),
        between_images: Vec::new(),
        boxes: boxes(t_us),
    }
}

impl LogReader for SixCameras {
    fn recording(&self) -> &Recording {
        &self.0
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        let lidar_from_global = (record.global_from_ego * record.ego_from_lidar).inverse();
        let point = |(i, global): (usize, DVec3)| SweepPoint {
            position: lidar_from_global.transform_point(global).as_vec3().to_array(),
            intensity: 9.0,
            ring: (i / 120) as u16 % 32,
        };
        let points = points(record.t_us).into_iter().enumerate().map(point).collect();
        Ok(Sweep { points, dropped_non_finite: 0, devices: false, notes: BTreeMap::new() })
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        let shade = 40 * record.channel as u8 + 10;
        let pixel = |x: u32, y: u32| Rgb([x as u8, 2 * y as u8, shade]);
        Ok(RgbImage::from_fn(record.camera.width, record.camera.height, pixel))
    }
}

/// Returns the files of the data set by name.
pub fn files() -> &'static BTreeMap<String, Vec<u8>> {
    static FILES: LazyLock<BTreeMap<String, Vec<u8>>> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        write_log(folder.path(), VERSION, &SixCameras::new()).unwrap();
        tree(folder.path())
    });
    &FILES
}

/// Writes the files of the data set whose names are selected.
pub fn copy_to(folder: &Path, wanted: impl Fn(&str) -> bool) {
    write_tree(folder, files().iter().filter(|(name, _)| wanted(name)));
}

/// Writes all files to a folder and opens the log there.
pub fn read() -> (tempfile::TempDir, NuScenes) {
    let folder = tempfile::tempdir().unwrap();
    copy_to(folder.path(), |_| true);
    let log = NuScenes::open(&LogLocator::new(&FORMAT, folder.path())).unwrap();
    (folder, log)
}
