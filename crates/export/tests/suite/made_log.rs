//! A log in memory.

use glam::{DMat3, DQuat, DVec3};
use image::{Rgb, RgbImage};
use point_skeleton::dataset::{
    Class, DatasetError, Frame, ImageRecord, LogFormat, LogReader, Recording, RigCamera, Sweep, SweepPoint,
    SweepRecord, Track, TrackBox,
};
use point_skeleton::geometry::{Camera, Cuboid, Pose};

pub(crate) const CAMERAS: [&str; 2] = ["CAM_FRONT", "CAM_BACK"];
const FIRST_US: i64 = 1_600_000_000_123_456;
/// Far from the origin of coordinates, as in nuPlan.
pub(crate) const START: DVec3 = DVec3::new(664_430.25, 3_997_650.5, 606.0);
const NOWHERE: &str = "made";

/// A log in memory at 10 Hz: the ego drives along x behind a car, and the cone is gone in the last frame.
pub(crate) struct MadeLog(pub(crate) Recording);

impl MadeLog {
    pub(crate) fn new(name: &str, frames: usize) -> Self {
        let track = |(id, category): (&str, &str)| Track {
            id: id.to_owned(),
            category: category.to_owned(),
            class: Class::from_category(category),
        };
        let frames: Vec<Frame> = (0..frames).map(|index| frame(index, index + 1 < frames)).collect();
        Self(Recording {
            name: name.into(),
            location: "nowhere".into(),
            description: "A car ahead".into(),
            cameras: CAMERAS.map(|name| name.parse().unwrap()).into(),
            rig: RigCamera::first_used(&frames),
            tracks: [("car", "vehicle.car"), ("cone", "movable_object.trafficcone")].map(track).into(),
            frames,
            ..Recording::default()
        })
    }
}

fn frame(index: usize, has_cone: bool) -> Frame {
    let t_us = FIRST_US + 100_000 * index as i64;
    let at = |seconds: f64| Pose::from_yaw(0.1 * seconds, START + DVec3::new(8.0, 1.0, 0.0) * seconds);
    let global_from_ego = at(0.1 * index as f64);
    let cuboid = |x: f64, y: f64, size: DVec3| {
        let position = global_from_ego.transform_point(DVec3::new(x, y, 0.5 * size.z));
        Cuboid::new(Pose::from_yaw(0.3, position), size).unwrap()
    };
    let boxes = vec![
        TrackBox { track: 0, cuboid: cuboid(12.0, 0.0, DVec3::new(4.0, 2.0, 1.6)) },
        TrackBox { track: 1, cuboid: cuboid(8.0, 4.0, DVec3::new(0.5, 0.5, 1.0)) },
    ];
    let image = |channel: usize| {
        let rows = [[40.0, 0.0, 30.0], [0.0, 40.0, 20.0], [0.0, 0.0, 1.0]];
        let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let turn = DQuat::from_rotation_z(std::f64::consts::PI * channel as f64);
        // The second camera is triggered before the frame.
        let early_us = 40_000 * channel as i64;
        ImageRecord {
            token: format!("{index}{channel}"),
            channel,
            path: NOWHERE.into(),
            row: None,
            t_us: t_us - early_us,
            global_from_ego: at(0.1 * index as f64 - early_us as f64 * 1e-6),
            ego_from_camera: Pose { rotation: turn * DQuat::from_mat3(&axes), translation: DVec3::Z * 1.5 },
            camera: Camera::new(CAMERAS[channel], 60, 40, rows).unwrap().into(),
        }
    };
    let ego_from_lidar = Pose::from_yaw(0.0, DVec3::Z * 1.8);
    Frame {
        t_us,
        global_from_ego,
        sweeps: vec![SweepRecord {
            path: NOWHERE.into(),
            row: None,
            t_us,
            global_from_ego,
            ego_from_lidar,
            is_key: true,
        }],
        images: vec![image(0), image(1)],
        between_images: Vec::new(),
        boxes: boxes.into_iter().take(if has_cone { 2 } else { 1 }).collect(),
    }
}

impl LogReader for MadeLog {
    fn recording(&self) -> &Recording {
        &self.0
    }

    fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
        let ground = (0..400).map(|i| [(i % 40) as f32 - 20.0, (i / 40) as f32 - 5.0, -1.8]);
        let point = |position| SweepPoint { position, intensity: 9.0, ring: 7 };
        Ok(Sweep { points: ground.map(point).collect(), ..Sweep::default() })
    }

    fn read_image(&self, _: &ImageRecord) -> Result<RgbImage, DatasetError> {
        Ok(RgbImage::from_fn(60, 40, |x, y| Rgb([4 * x as u8, 6 * y as u8, 90])))
    }
}

pub(crate) static FORMAT: LogFormat = LogFormat {
    name: "made",
    has_path: false,
    rates_hz: [10.0, 5.0],
    detect: |_| false,
    check: LogFormat::unchecked,
    expand: |locator| Ok(vec![locator.clone()]),
    outline: LogFormat::outline_by_opening,
    open: |_, _| Ok(Box::new(MadeLog::new("made", 1))),
};
