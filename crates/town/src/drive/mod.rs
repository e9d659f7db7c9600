//! The town as a recorded log: a [`Dataset`] whose sweeps and images are generated when they are read.
//!
//! # How it works
//! `record` converts the plan to a log: poses of all actors at the times of frames, sweeps and images. The LiDAR
//! simulation generates sweeps, the triangle renderer images (`truth`), both from the same meshes and only on
//! request. One pose transforms the town's frame to the global frame so that the whole map has positive coordinates,
//! on z = 0, as in nuScenes.

mod map;
mod record;
mod rig;
mod truth;

use std::collections::BTreeMap;
use std::sync::{Mutex, OnceLock};

use glam::{DVec2, DVec3};
use image::RgbImage;
use point_skeleton::dataset::nuscenes::MapLayers;
use point_skeleton::dataset::{
    Dataset, DatasetError, ImageRecord, Log, PosedActor, Sweep, SweepRecord, VectorMap, ViewRenderer,
};
use point_skeleton::geometry::{CameraError, Pose, View};
use point_skeleton::gpu::GpuError;
use point_skeleton::hash;

use self::record::{Recorded, Recorder, seconds};
use self::truth::TownRenderer;
use super::lidar::{Lidar, Mover, Scanner, Turn};
use super::mesh::Mesh;
use super::model::Body;
use super::plan::{Actor, Motion, Plan};
use super::view::MeshRenderError;
use super::{Daylight, TownOptions, TownOptionsError, built};

/// Recording of a drive through a town.
pub struct Town {
    log: Log,
    options: TownOptions,
    plan: Plan,
    global_from_town: Pose,
    /// For each of the log's tracks, its index in the plan's actors.
    actors: Vec<usize>,
    meshes: OnceLock<Meshes>,
    scanner: OnceLock<Scanner>,
    film: Mutex<Option<TownRenderer>>,
}

/// All meshes.
struct Meshes {
    /// Static town, town frame.
    standing: Vec<Mesh>,
    /// Bodies by kind, seed and pose of the limbs, in the body's frame.
    bodies: BTreeMap<(Body, usize), Mesh>,
}

/// Error of creating or rendering a town.
#[derive(Debug, thiserror::Error)]
pub enum TownError {
    /// The options are out of range.
    #[error(transparent)]
    Options(#[from] TownOptionsError),
    /// No camera can have the image size.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Rendering failed.
    #[error(transparent)]
    TownRenderer(#[from] MeshRenderError),
    /// The device or driver failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A track is not in the town.
    #[error("expected tracks of town {town}, found {track}")]
    Track {
        /// Name of the town's log.
        town: String,
        /// The unknown track.
        track: String,
    },
}

impl From<TownError> for DatasetError {
    fn from(error: TownError) -> Self {
        Self::Made(Box::new(error))
    }
}

impl From<TownOptionsError> for DatasetError {
    fn from(error: TownOptionsError) -> Self {
        Self::Made(Box::new(error))
    }
}

/// Name of the location, for maps.
const LOCATION: &str = "town";
/// Margin between the map and the edges of its canvas, meters.
const EDGE_M: f64 = 40.0;

impl Town {
    /// Plans a town and its recording; meshes, sweeps and images are not generated yet.
    ///
    /// # Errors
    /// Returns an error if the options are out of range.
    pub fn new(options: &TownOptions) -> Result<Self, TownError> {
        options.check()?;
        // Adds frames for the time before the first one.
        let lead = (record::LEAD_S * options.hz).ceil() as usize;
        let plan = Plan::new(&TownOptions { frames: options.frames + lead, ..*options });
        let rig = rig::cameras(options.size)?;
        let global_from_town = place(&plan, options.seed);
        let recorder = Recorder { options, traffic: &plan.traffic, global_from_town, rig: &rig };
        let Recorded { frames, tracks, actors } = recorder.record();
        let log = Log {
            name: name(options),
            location: LOCATION.into(),
            description: describe(options),
            cameras: rig.iter().map(|rig| rig.camera.name.clone()).collect(),
            rig,
            tracks,
            frames,
            ..Log::default()
        };
        let (meshes, scanner, film) = Default::default();
        Ok(Self { log, options: *options, plan, global_from_town, actors, meshes, scanner, film })
    }

    /// Returns the streets and the motion of all actors, in the town's frame.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Returns the log's name and the recording options that differ from the defaults: skeletons of two recordings
    /// differ.
    pub fn recording(&self) -> String {
        let TownOptions { lidar_hz, beams, size: [height, width], .. } = self.options;
        let usual = TownOptions::default();
        let mut name = self.log.name.clone();
        if beams != usual.beams {
            name += &format!("-{beams}beams");
        }
        if lidar_hz != usual.lidar_hz {
            name += &format!("-{lidar_hz}turns");
        }
        if [height, width] != usual.size {
            name += &format!("-{height}x{width}");
        }
        name
    }

    /// Returns the pose of the town in the global frame.
    pub fn global_from_town(&self) -> Pose {
        self.global_from_town
    }

    /// Returns sidewalks, car parks and the other layers of nuScenes' maps beyond the [`VectorMap`], in the global
    /// frame.
    pub fn map_layers(&self) -> MapLayers {
        map::vector_map(&self.plan.network, LOCATION, &self.global_from_town).1
    }

    fn meshes(&self) -> &Meshes {
        self.meshes.get_or_init(|| {
            let poses = |actor: &Actor| {
                let poses = if actor.motion.poses.len() > 1 { actor.body.poses() } else { 1 };
                (0..poses.max(1)).map(|pose| (actor.body, pose)).collect::<Vec<_>>()
            };
            let keys = self.plan.traffic.actors.iter().flat_map(poses);
            let bodies: BTreeMap<_, _> = keys.map(|(body, pose)| ((body, pose), body.mesh(pose))).collect();
            Meshes { standing: built::standing(&self.plan, self.options.seed), bodies }
        })
    }

    fn sweep<'a>(&'a self, record: &SweepRecord) -> Sweep {
        let scanner = self.scanner.get_or_init(|| {
            let meshes = self.meshes();
            Scanner::new(&meshes.standing, &meshes.bodies)
        });
        let end_s = seconds(record.t_us);
        let mover = |actor: &'a Actor| {
            let limbs = limbs(actor.body, &actor.motion, end_s);
            Mover { body: actor.body, limbs, motion: &actor.motion }
        };
        let movers: Vec<Mover<'a>> = self.plan.traffic.actors.iter().map(mover).collect();
        let town_from_lidar = |t_s: f64| self.plan.traffic.ego.pose(t_s) * record.ego_from_lidar;
        let lidar = Lidar::new(self.options.beams, self.options.lidar_hz);
        let seed = Some(hash::hash(self.options.seed, &[record.t_us]));
        let points = scanner.sweep(&Turn { lidar, end_s, town_from_lidar, movers: &movers, seed });
        Sweep { points, ..Sweep::default() }
    }
}

impl Dataset for Town {
    fn log(&self) -> &Log {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        Ok(self.sweep(record))
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        Ok(self.image(record)?)
    }

    fn check_sweep(&self, _: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        Ok(None)
    }

    fn check_image(&self, _: &ImageRecord) -> Result<(), DatasetError> {
        Ok(())
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        Ok(Some(map::vector_map(&self.plan.network, LOCATION, &self.global_from_town).0))
    }

    fn view_renderer(&self) -> Option<&dyn ViewRenderer> {
        Some(self)
    }
}

impl ViewRenderer for Town {
    fn render_views(
        &self,
        t_us: i64,
        actors: Option<&[PosedActor<'_>]>,
        views: &[View],
    ) -> Result<Vec<RgbImage>, DatasetError> {
        let rendered = match actors {
            Some(actors) => self.truth_of(t_us, actors, views)?,
            None => self.truth(t_us, views)?,
        };
        Ok(rendered.into_iter().map(|view| view.image).collect())
    }
}

/// Returns `global_from_town`: rotated by an angle of the seed, with all streets at positive coordinates away from
/// the edges.
fn place(plan: &Plan, seed: u64) -> Pose {
    let yaw = hash::between(seed, &[0x706c], 0.0, std::f64::consts::TAU);
    let turned = Pose::from_yaw(yaw, DVec3::ZERO);
    let roads =
        plan.network.roads.iter().flat_map(|road| road.centerline.iter().map(|p| (*p, road.half_width_m)));
    let corners = plan.network.junctions.iter().flat_map(|junction| &junction.outline).map(|p| (*p, 0.0));
    let low =
        roads.chain(corners).map(|(p, half_m)| turned.transform_point(p.extend(0.0)).truncate() - half_m);
    let min = low.reduce(DVec2::min).unwrap_or(DVec2::ZERO);
    Pose { translation: (DVec2::splat(EDGE_M) - min).extend(0.0), ..turned }
}

/// Returns the log's name, which identifies the drive: skeletons of different drives differ even with the same seed.
/// Recording options (images, LiDAR) do not change the drive.
fn name(options: &TownOptions) -> String {
    let TownOptions { seed, frames, hz, .. } = options;
    let rate = if *hz == TownOptions::default().hz { String::new() } else { format!("-{hz}hz") };
    format!("town-{seed}-{frames}f{rate}-{}", options.light())
}

fn describe(options: &TownOptions) -> String {
    let TownOptions { seed, hz, lidar_hz, beams, size: [height, width], .. } = options;
    let light = options.light();
    format!(
        "A drive in a made town of seed {seed}, {light}, {hz} frames a second of {height}x{width} pixels, LiDAR of {beams} \
         beams at {lidar_hz} Hz"
    )
}

/// Returns the pose of a body's limbs.
fn limbs(body: Body, motion: &Motion, t_s: f64) -> usize {
    if motion.poses.len() > 1 { body.pose_at(motion.travelled_m(t_s)) } else { 0 }
}

impl TownOptions {
    /// Returns the requested daylight, or the one that the seed selects.
    pub fn light(&self) -> Daylight {
        let chosen =
            || Daylight::ALL[(hash::hash(self.seed, &[0x6c69]) % Daylight::ALL.len() as u64) as usize];
        self.daylight.unwrap_or_else(chosen)
    }
}
