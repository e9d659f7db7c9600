//! Recording of a town: its plan, its log, and meshes and sweeps that are generated when they are requested.

use std::sync::{Mutex, OnceLock};

use glam::{DVec2, DVec3};
use point_skeleton::dataset::nuscenes::MapLayers;
use point_skeleton::dataset::{Recording, Sweep, SweepRecord};
use point_skeleton::geometry::Pose;
use point_skeleton::hash;
use rayon::prelude::*;

use super::error::TownError;
use super::meshes::{Meshes, limbs};
use super::record::{self, Recorded, Recorder, seconds};
use super::renderer::TownRenderer;
use super::{map, rig};
use crate::TownOptions;
use crate::lidar::{Lidar, Mover, Scanner, TownHit, Turn};
use crate::plan::{Actor, Plan};

/// Recording of a drive through a town.
pub struct Town {
    pub(super) log: Recording,
    pub(super) options: TownOptions,
    pub(super) plan: Plan,
    pub(super) global_from_town: Pose,
    /// For each of the log's tracks, its index in the plan's actors.
    pub(super) actors: Vec<usize>,
    meshes: OnceLock<Meshes>,
    scanner: OnceLock<Scanner>,
    pub(super) renderer: Mutex<Option<TownRenderer>>,
}

/// A ray through a town, in the global frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TownRay {
    /// Time, absolute microseconds.
    pub t_us: i64,
    /// Meters.
    pub origin: DVec3,
    /// Unit vector.
    pub direction: DVec3,
}

/// Name of the location, for maps.
pub(super) const LOCATION: &str = "town";
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
        let log = Recording {
            name: name(options),
            location: LOCATION.into(),
            description: describe(options),
            cameras: rig.iter().map(|rig| rig.camera.name.clone()).collect(),
            rig,
            tracks,
            frames,
            ..Recording::default()
        };
        let (meshes, scanner, renderer) = Default::default();
        Ok(Self { log, options: *options, plan, global_from_town, actors, meshes, scanner, renderer })
    }

    /// Returns the streets and the motion of all actors, in the town's frame.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Returns the log's name and the recording options that differ from the defaults: skeletons of two
    /// recordings differ.
    pub fn recording_name(&self) -> String {
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

    /// Returns sidewalks, car parks and the other layers of nuScenes' maps beyond the
    /// [`VectorMap`](point_skeleton::dataset::VectorMap), in the global frame.
    pub fn map_layers(&self) -> MapLayers {
        map::vector_map(&self.plan.network, LOCATION, &self.global_from_town).1
    }

    pub(super) fn meshes(&self) -> &Meshes {
        self.meshes.get_or_init(|| Meshes::new(&self.plan, self.options.seed))
    }

    /// Returns where each ray meets the town, whatever it loses there. `None` without a surface within 0.9 to
    /// 100 m. Actors move between the times of rays, with their limbs at `t_us`, absolute microseconds.
    pub fn hits(&self, t_us: i64, rays: &[TownRay]) -> Vec<Option<TownHit>> {
        let (movers, town_from_global) = (self.movers(seconds(t_us)), self.global_from_town.inverse());
        let scanner = self.scanner();
        let hit = |ray: &TownRay| {
            let origin = town_from_global.transform_point(ray.origin);
            scanner.hit(&movers, seconds(ray.t_us), origin, town_from_global.rotation * ray.direction)
        };
        rays.par_iter().map(hit).collect()
    }

    pub(super) fn sweep(&self, record: &SweepRecord) -> Sweep {
        let end_s = seconds(record.t_us);
        let movers = self.movers(end_s);
        let town_from_lidar = |t_s: f64| self.plan.traffic.ego.pose(t_s) * record.ego_from_lidar;
        let lidar = Lidar::new(self.options.beams, self.options.lidar_hz);
        let seed = Some(hash::hash(self.options.seed, &[record.t_us]));
        let turn = Turn { lidar, end_s, town_from_lidar, movers: &movers, seed };
        Sweep { points: self.scanner().sweep(&turn), ..Sweep::default() }
    }

    fn scanner(&self) -> &Scanner {
        self.scanner.get_or_init(|| {
            let meshes = self.meshes();
            Scanner::new(&meshes.static_meshes, &meshes.bodies)
        })
    }

    /// Returns all actors, with their limbs at a time in seconds.
    fn movers(&self, t_s: f64) -> Vec<Mover<'_>> {
        self.plan.traffic.actors.iter().map(|actor| mover(actor, t_s)).collect()
    }
}

fn mover(actor: &Actor, t_s: f64) -> Mover<'_> {
    Mover { body: actor.body, limbs: limbs(actor.body, &actor.motion, t_s), motion: &actor.motion }
}

/// Returns `global_from_town`: rotated by an angle of the seed, with all streets at positive coordinates away
/// from the edges.
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

/// Returns the log's name, which identifies the drive: skeletons of different drives differ even with the
/// same seed. Recording options (images, LiDAR) do not change the drive.
fn name(options: &TownOptions) -> String {
    let TownOptions { seed, frames, hz, .. } = options;
    let rate = if *hz == TownOptions::default().hz { String::new() } else { format!("-{hz}hz") };
    format!("town-{seed}-{frames}f{rate}-{}", options.light())
}

fn describe(options: &TownOptions) -> String {
    let TownOptions { seed, hz, lidar_hz, beams, size: [height, width], .. } = options;
    let light = options.light();
    format!(
        "A drive in a made town of seed {seed}, {light}, {hz} frames a second of {height}x{width} pixels, \
            LiDAR of {beams} \
         beams at {lidar_hz} Hz"
    )
}
