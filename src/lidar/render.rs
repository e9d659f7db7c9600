//! Rendering of a sweep: sectors on the rasterizer, returns on the host.

use std::ops::Range;
use std::time::{Duration, Instant};

use glam::DVec3;
use rayon::prelude::*;

use super::cast::{Return, cast};
use super::error::LidarError;
use super::image::SectorImage;
use super::motion::Motion;
use super::points::PointPages;
use super::sectors::Sector;
use super::spec::{LidarDevice, LidarSpec};
use super::sweep::{LidarSweep, RangeImage};
use crate::geometry::{ImageSize, View};
use crate::hash::unit;
use crate::memory::{Need, reserve};
use crate::pipeline::Pipeline;
use crate::raster::{
    FrameJob, Instance, MapKind, MapSet, Occlusion, RasterError, Rasterizer, SplatSchedule, SplatStep,
};
use crate::scene::{SceneClouds, SceneState, SelectionOptions};

/// Sectors that are rendered together: others are rendered while their returns are calculated.
const TOGETHER: usize = 4;
/// Memory of a pixel's visible point at all levels, bytes.
const PIXEL_BYTES: u64 = 22;

/// Actors with at most this many points get the template of their category. Fewer than for maps: a ray needs
/// no more than a point on either side.
const MIN_ACTOR_POINTS: usize = 500;

/// Consecutive sectors in which all clouds have the same poses.
struct Job {
    sectors: Range<usize>,
    views: Vec<View>,
    instances: Vec<Instance>,
}

/// Clouds of a scene, and the positions of their points.
pub(crate) struct Scene<'s, 'a> {
    pub(crate) clouds: &'s SceneClouds<'a>,
    pub(crate) selection: &'s SelectionOptions,
    pub(crate) pages: &'s mut PointPages<'a>,
}

/// Renders a sweep of a moving scene.
///
/// # Errors
/// Fails if the spec is invalid, if the rasterizer fails, or if points cannot be read.
pub(crate) fn render<'r>(
    rasterizer: &mut (dyn Rasterizer + 'r),
    mut scene: Scene<'_, '_>,
    spec: &LidarSpec,
    motion: &Motion<'_>,
) -> Result<LidarSweep, LidarError> {
    if let Some((expected, found)) = spec.fault() {
        return Err(LidarError::Spec { expected, found });
    }
    let state = motion.state();
    let (mut devices, mut first_ring) = (Vec::new(), 0);
    for (number, device) in spec.devices.iter().enumerate() {
        let mut image = render_device(rasterizer, &mut scene, device, motion)?;
        image.first_ring = first_ring;
        first_ring += image.beams;
        lose(&mut image, device.dropout, spec.seed, [state.t_us, number as i64]);
        devices.push(image);
    }
    let tracks = state.actors.iter().map(|actor| actor.track.clone()).collect();
    let SceneState { name, t_us, global_from_ego, .. } = state;
    Ok(LidarSweep { name: name.clone(), t_us: *t_us, global_from_ego: *global_from_ego, tracks, devices })
}

fn render_device<'r>(
    rasterizer: &mut (dyn Rasterizer + 'r),
    scene: &mut Scene<'_, '_>,
    device: &LidarDevice,
    motion: &Motion<'_>,
) -> Result<RangeImage, LidarError> {
    let sectors = Sector::all(device, motion)?;
    let jobs = jobs(scene, &sectors, motion);
    let pixels = sectors.iter().map(|sector| ImageSize::of(&sector.view.camera).pixels()).max().unwrap_or(0);
    let bytes = PIXEL_BYTES * (pixels * TOGETHER) as u64;
    let need = || Need { what: format!("LiDAR {}", device.name), bytes, advice: "fewer columns need less" };
    let _memory = reserve(bytes, need).map_err(RasterError::from)?;
    let schedule = SplatSchedule::new(vec![SplatStep { z_max_m: device.range_m[1] as f32, radius: 0 }])?;
    let mut image = blank(device);
    let (mut waiting, mut pipeline) = (jobs.iter(), Pipeline::default());
    let mut begin = |rasterizer: &mut (dyn Rasterizer + 'r)| {
        let Some(job) = waiting.next() else { return Ok(None) };
        rasterizer.begin(&frame(job, &schedule))?;
        Ok::<_, LidarError>(Some(job))
    };
    let mut spent = Duration::ZERO;
    loop {
        let finish = |rasterizer: &mut (dyn Rasterizer + 'r), job: &&Job| {
            let maps = rasterizer.finish()?;
            let start = Instant::now();
            let points: Vec<&[u32]> = maps.iter().map(|maps| &*maps.point).collect();
            let numbers = scene.pages.numbers(&job.instances);
            scene.pages.load(&job.instances, &numbers, &points).map_err(RasterError::from)?;
            for (sector, points) in sectors[job.sectors.clone()].iter().zip(points) {
                let hits = scene.pages.hits(&sector.view, &job.instances, &numbers, points);
                let camera = &sector.view.camera;
                let seen = SectorImage::new(
                    &camera.intrinsics,
                    [camera.width, camera.height].map(|side| side as usize),
                    hits,
                );
                fill(&mut image, &seen, sector, device, motion);
            }
            spent += start.elapsed();
            Ok(())
        };
        if pipeline.next(rasterizer, &mut begin, finish)?.is_none() {
            break;
        }
    }
    rasterizer.stages().add("returns", spent);
    Ok(image)
}

/// Divides sectors into jobs of equal instances.
fn jobs(scene: &Scene<'_, '_>, sectors: &[Sector], motion: &Motion<'_>) -> Vec<Job> {
    let most = scene.selection.min_actor_points.min(MIN_ACTOR_POINTS);
    let selection = SelectionOptions { min_actor_points: most, ..*scene.selection };
    let mut jobs: Vec<Job> = Vec::new();
    for (at, sector) in sectors.iter().enumerate() {
        let state = SceneState { actors: motion.actors(sector.after_s), ..motion.state().clone() };
        let instances = scene.clouds.instances(&state, &selection).geometry;
        match jobs.last_mut() {
            Some(job) if job.views.len() < TOGETHER && job.instances == instances => {
                job.sectors.end = at + 1;
                job.views.push(sector.view.clone());
            }
            _ => jobs.push(Job { sectors: at..at + 1, views: vec![sector.view.clone()], instances }),
        }
    }
    jobs
}

fn frame<'j>(job: &'j Job, schedule: &'j SplatSchedule) -> FrameJob<'j> {
    FrameJob {
        views: &job.views,
        schedule,
        color: &job.instances,
        geometry: &job.instances,
        occlusion: Occlusion::Scene,
        crop: None,
        maps: MapSet::of(&[MapKind::Point]),
        out_size: None,
    }
}

fn blank(device: &LidarDevice) -> RangeImage {
    let (beams, columns) = (device.elevations_deg.len(), device.columns);
    let rays = beams * columns;
    RangeImage {
        name: device.name.clone(),
        beams,
        columns,
        first_ring: 0,
        range_m: vec![0.0; rays],
        position: vec![[0.0; 3]; rays],
        class: vec![0; rays],
        instance: vec![0; rays],
        offset_s: (0..columns).map(|column| device.offset_s(column) as f32).collect(),
    }
}

/// Fills the columns of a sector with the returns of their rays.
fn fill(
    image: &mut RangeImage,
    seen: &SectorImage,
    sector: &Sector,
    device: &LidarDevice,
    motion: &Motion<'_>,
) {
    let ego_from_camera =
        motion.state().global_from_ego.inverse().affine() * sector.view.camera_from_world.inverse();
    let [near_m, far_m] = device.range_m;
    let column = |column: usize| {
        let rays = sector.rays(device, motion, column);
        let hit = |ray| {
            let found: Return = cast(seen, &ray).filter(|found| (near_m..=far_m).contains(&found.range_m))?;
            let at: DVec3 = ray.origin + ray.direction * found.range_m;
            Some((found, ego_from_camera.transform_point3(at).as_vec3().to_array()))
        };
        rays.into_iter().map(hit).collect::<Vec<_>>()
    };
    let columns: Vec<_> = sector.columns.clone().into_par_iter().map(column).collect();
    for (column, hits) in sector.columns.clone().zip(columns) {
        for (beam, hit) in hits.into_iter().enumerate() {
            let Some((found, position)) = hit else { continue };
            let at = beam * image.columns + column;
            image.range_m[at] = found.range_m as f32;
            image.position[at] = position;
            image.class[at] = (found.label & 0xff) as u8;
            image.instance[at] = found.label >> 8;
        }
    }
}

/// Removes a share of the returns, by a hash of the sweep and of each ray.
fn lose(image: &mut RangeImage, share: f64, seed: u64, [t_us, device]: [i64; 2]) {
    if share == 0.0 {
        return;
    }
    for at in 0..image.range_m.len() {
        if unit(seed, &[t_us, device, at as i64]) < share {
            (image.range_m[at], image.position[at]) = (0.0, [0.0; 3]);
            (image.class[at], image.instance[at]) = (0, 0);
        }
    }
}
