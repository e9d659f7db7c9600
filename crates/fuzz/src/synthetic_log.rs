//! A synthetic log: the ego drives along x behind a car, and a cone is static.

use std::path::Path;

use glam::{DMat3, DQuat, DVec2, DVec3};
use image::{Rgb, RgbImage};
use point_skeleton::dataset::{
    Area, Class, DatasetError, Frame, ImageRecord, Lane, LogReader, Recording, RigCamera, Sweep, SweepPoint,
    SweepRecord, Track, TrackBox, VectorMap,
};
use point_skeleton::geometry::{Camera, Cuboid, Pose};
use point_skeleton::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton};

pub(crate) const FIRST_US: i64 = 1_600_000_000_000_000;
const STEP_US: i64 = 100_000;
const START: DVec3 = DVec3::new(1000.0, 500.0, 2.0);

/// A log in memory.
pub(crate) struct SyntheticLog(Recording);

impl SyntheticLog {
    pub(crate) fn new(frames: usize) -> Self {
        let track = |(id, category): (&str, &str)| Track {
            id: id.to_owned(),
            category: category.to_owned(),
            class: Class::from_category(category),
        };
        let rig = vec![rig()];
        Self(Recording {
            name: "made".into(),
            location: "nowhere".into(),
            description: "made up".into(),
            cameras: vec![rig[0].camera.name.clone()],
            tracks: [("car", "vehicle.car"), ("cone", "movable_object.trafficcone")].map(track).into(),
            frames: (0..frames).map(frame).collect(),
            rig,
            ..Recording::default()
        })
    }
}

impl SyntheticLog {
    /// Returns a log whose images are files below a folder, one per frame.
    pub(crate) fn with_images_in(frames: usize, root: &Path) -> Self {
        let mut synthetic = Self::new(frames);
        for (index, frame) in synthetic.0.frames.iter_mut().enumerate() {
            frame.images.iter_mut().for_each(|image| image.path = root.join(format!("samples/{index}.png")));
        }
        synthetic
    }
}

fn rig() -> RigCamera {
    let rows = [[16.0, 0.0, 12.0], [0.0, 16.0, 8.0], [0.0, 0.0, 1.0]];
    let camera = Camera::new("CAM_FRONT", 24, 16, rows).expect("a camera");
    RigCamera { channel: 0, ego_from_camera: forward(), camera }
}

/// Returns the pose of a camera that looks along x.
pub(crate) fn forward() -> Pose {
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    Pose { rotation: DQuat::from_mat3(&axes), translation: DVec3::new(0.0, 0.0, 1.5) }
}

fn frame(index: usize) -> Frame {
    let t_us = FIRST_US + STEP_US * index as i64;
    let at = START + DVec3::X * 0.8 * index as f64;
    let global_from_ego = Pose::from_yaw(0.0, at);
    let cuboid = |at: DVec3, size: DVec3| Cuboid::new(Pose::from_yaw(0.0, at), size).expect("a box");
    let car = cuboid(at + DVec3::new(12.0, 0.0, 0.8), DVec3::new(4.0, 2.0, 1.6));
    let cone = cuboid(START + DVec3::new(8.0, 4.0, 0.5), DVec3::new(0.5, 0.5, 1.0));
    let ego_from_lidar = Pose::from_yaw(0.0, DVec3::Z * 1.8);
    let RigCamera { channel, ego_from_camera, camera } = rig();
    let (path, is_key) = ("made".into(), true);
    Frame {
        t_us,
        global_from_ego,
        sweeps: vec![SweepRecord { path, row: None, t_us, global_from_ego, ego_from_lidar, is_key }],
        images: vec![ImageRecord {
            token: "i".into(),
            channel,
            path: "made".into(),
            row: None,
            t_us,
            global_from_ego,
            ego_from_camera,
            camera: camera.into(),
        }],
        between_images: Vec::new(),
        boxes: vec![TrackBox { track: 0, cuboid: car }, TrackBox { track: 1, cuboid: cone }],
    }
}

impl LogReader for SyntheticLog {
    fn recording(&self) -> &Recording {
        &self.0
    }

    fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
        let ground = (0..40).map(|i| [f32::from(i as u8) * 0.5 - 2.0, f32::from(i as u8 % 7) - 3.0, -1.8]);
        let car =
            (0..20).map(|i| [10.0, f32::from(i as u8 % 5) * 0.4 - 0.8, f32::from(i as u8 / 5) * 0.4 - 1.6]);
        let point = |position| SweepPoint { position, intensity: 9.0, ring: 7 };
        Ok(Sweep { points: ground.chain(car).map(point).collect(), ..Sweep::default() })
    }

    fn read_image(&self, _: &ImageRecord) -> Result<RgbImage, DatasetError> {
        Ok(RgbImage::from_fn(24, 16, |x, y| Rgb([10 * x as u8, 15 * y as u8, 90])))
    }
}

/// Returns a map: a lane, a connector after it, a drivable area with a hole, a crossing, a stop line, a
/// divider.
pub(crate) fn map() -> VectorMap {
    let corner = |x: f64, y: f64| DVec2::new(START.x + x, START.y + y);
    let area = |x: f64, length: f64| Area {
        exterior: vec![corner(x, -2.0), corner(x + length, -2.0), corner(x + length, 2.0), corner(x, 2.0)],
        holes: Vec::new(),
    };
    let lane = |id: &str, x: f64, successors: &[&str]| Lane {
        id: id.into(),
        outline: area(x, 20.0),
        centerline: vec![corner(x, 0.0), corner(x + 20.0, 0.0)],
        successors: successors.iter().map(|id| (*id).to_owned()).collect(),
    };
    VectorMap {
        location: "nowhere".into(),
        lanes: vec![lane("a", 0.0, &["b"])],
        lane_connectors: vec![lane("b", 20.0, &[])],
        drivable_area: vec![Area { holes: vec![area(10.0, 1.0).exterior], ..area(-5.0, 50.0) }],
        crossings: vec![area(18.0, 3.0)],
        stop_lines: vec![area(17.0, 0.5)],
        dividers: vec![vec![corner(0.0, 2.0), corner(20.0, 2.0)]],
        ..VectorMap::default()
    }
}

/// Builds the skeleton of a log in a folder.
pub(crate) fn skeleton(path: &Path, synthetic: &SyntheticLog) -> Skeleton {
    let options = BuildOptions { voxel_m: 0.2, ..BuildOptions::default() };
    let input = BuildInput::all(synthetic);
    skeleton::build(path, &[input], &options, &|_| Ok(Vec::new()), &BuildRun::default()).expect("a skeleton")
}
