use std::path::PathBuf;

use glam::{DMat3, DQuat, DVec3};
use image::RgbImage;

use super::film;
use super::scenery::{self, Actor};
use super::world::{Thing, World};
use crate::dataset::{
    Class, Dataset, DatasetError, Frame, ImageRecord, Log, RigCamera, Sweep, SweepRecord, Track, TrackBox,
};
use crate::geometry::{Camera, CameraError, Cuboid, Pose};

/// How the street is filmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreetOptions {
    /// What the street looks like.
    pub seed: u64,
    /// Annotated frames, five a second.
    pub frames: usize,
    /// Height and width of the images, pixels.
    pub size: [u32; 2],
}

impl Default for StreetOptions {
    fn default() -> Self {
        Self { seed: 7, frames: 8, size: [288, 512] }
    }
}

/// A drive down a synthetic street. Its sweeps and images are made when they are read.
pub struct Street {
    log: Log,
    seed: u64,
    standing: Vec<Thing>,
    actors: Vec<Actor>,
}

/// Time of frame 0, microseconds.
const START_US: i64 = 1_600_000_000_000_000;
const FRAME_US: i64 = 200_000;
/// The ego's speed, m/s, and where it starts, street frame.
const EGO_SPEED: f64 = 5.0;
const EGO_START: DVec3 = DVec3::new(0.0, -1.75, 0.0);
/// Channel, yaw to the left in degrees, horizontal field of view in degrees, microseconds before the frame. In the
/// ring order of nuScenes logs.
const CAMERAS: [(&str, f64, f64, i64); 6] = [
    ("CAM_FRONT", 0.0, 70.0, 35_000),
    ("CAM_FRONT_RIGHT", -55.0, 70.0, 25_000),
    ("CAM_BACK_RIGHT", -110.0, 70.0, 15_000),
    ("CAM_BACK", 180.0, 100.0, 0),
    ("CAM_BACK_LEFT", 110.0, 70.0, 45_000),
    ("CAM_FRONT_LEFT", 55.0, 70.0, 40_000),
];

impl Street {
    /// Sets the scene; nothing is filmed yet.
    ///
    /// # Errors
    /// An image size that no camera has.
    pub fn new(options: &StreetOptions) -> Result<Self, CameraError> {
        let actors = scenery::actors(options.seed);
        let cameras =
            CAMERAS.iter().map(|c| camera(c.0, c.2, options.size)).collect::<Result<Vec<_>, _>>()?;
        let track = |actor: &Actor| Track {
            id: actor.id.clone(),
            category: actor.category.to_owned(),
            class: Class::from_category(actor.category),
        };
        let frames: Vec<Frame> = (0..options.frames).map(|i| frame(i, &actors, &cameras)).collect();
        let log = Log {
            name: format!("street-{}", options.seed),
            location: "synthetic-street".into(),
            description: "A drive down a synthetic street".into(),
            cameras: CAMERAS.iter().map(|c| c.0.to_owned()).collect(),
            tracks: actors.iter().map(track).collect(),
            rig: RigCamera::first_used(&frames),
            frames,
            ..Log::default()
        };
        Ok(Self { log, seed: options.seed, standing: scenery::standing(options.seed), actors })
    }

    /// Everything where it stands at a time.
    fn world(&self, t_us: i64) -> World {
        let actors = self.actors.iter().map(|actor| actor.thing(seconds(t_us)));
        World::new(self.standing.iter().cloned().chain(actors).collect())
    }
}

impl Dataset for Street {
    fn log(&self) -> &Log {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        let street_from_lidar =
            global_from_street().inverse() * record.global_from_ego * record.ego_from_lidar;
        let points =
            film::sweep(&self.world(record.t_us), &street_from_lidar, self.seed ^ record.t_us as u64);
        Ok(Sweep { points, ..Sweep::default() })
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        let street_from_camera = global_from_street().inverse() * record.camera_from_global().inverse();
        Ok(film::image(&self.world(record.t_us), &record.camera, &street_from_camera))
    }
}

fn seconds(t_us: i64) -> f64 {
    (t_us - START_US) as f64 * 1e-6
}

/// The street lies somewhere in a city.
fn global_from_street() -> Pose {
    Pose::from_yaw(0.6, DVec3::new(1200.0, 800.0, 12.0))
}

fn global_from_ego(t_us: i64) -> Pose {
    global_from_street() * Pose::from_yaw(0.0, EGO_START + DVec3::X * (EGO_SPEED * seconds(t_us)))
}

fn camera(name: &str, field_deg: f64, [height, width]: [u32; 2]) -> Result<Camera, CameraError> {
    let (w, h) = (f64::from(width), f64::from(height));
    let focal = w / 2.0 / (field_deg.to_radians() / 2.0).tan();
    Camera::new(name, width, height, [[focal, 0.0, w / 2.0], [0.0, focal, h / 2.0], [0.0, 0.0, 1.0]])
}

/// Looks along a yaw, a little downward.
fn ego_from_camera(yaw_deg: f64) -> Pose {
    const PITCH_DEG: f64 = 4.0;
    let forward_right_down = DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X));
    let yaw = DQuat::from_rotation_z(yaw_deg.to_radians());
    let pitch = DQuat::from_rotation_y(PITCH_DEG.to_radians());
    let mount = yaw * DVec3::new(0.6, 0.0, 0.0) + DVec3::new(0.8, 0.0, 1.6);
    Pose { rotation: yaw * pitch * forward_right_down, translation: mount }
}

fn frame(index: usize, actors: &[Actor], cameras: &[Camera]) -> Frame {
    let t_us = START_US + FRAME_US * index as i64;
    let image = |(channel, camera): (usize, &Camera)| {
        let (_, yaw_deg, _, before_us) = CAMERAS[channel];
        let t_us = t_us - before_us;
        ImageRecord {
            channel,
            path: PathBuf::new(),
            t_us,
            global_from_ego: global_from_ego(t_us),
            ego_from_camera: ego_from_camera(yaw_deg),
            camera: camera.clone(),
        }
    };
    let sweep = SweepRecord {
        path: PathBuf::new(),
        t_us,
        global_from_ego: global_from_ego(t_us),
        ego_from_lidar: Pose::from_yaw(0.0, DVec3::new(0.9, 0.0, 1.9)),
        is_key: true,
    };
    let boxes = actors.iter().enumerate().map(|(track, actor)| {
        let centre = Pose::from_yaw(0.0, DVec3::Z * (actor.size.z / 2.0));
        let pose = global_from_street() * actor.pose(seconds(t_us)) * centre;
        TrackBox { track, cuboid: Cuboid { pose, size: actor.size } }
    });
    Frame {
        t_us,
        global_from_ego: global_from_ego(t_us),
        sweeps: vec![sweep],
        images: cameras.iter().enumerate().map(image).collect(),
        between_images: Vec::new(),
        boxes: boxes.collect(),
    }
}
