//! Rendering of a sweep: rays against the solids of a scene.

use rayon::prelude::*;

use super::bodies::{Bodies, Body};
use super::cast::cast;
use super::error::LidarError;
use super::image::Found;
use super::motion::Motion;
use super::rays::{LidarHit, LidarRays};
use super::solids::Solids;
use super::spec::LidarSpec;
use super::sweep::{LidarSweep, RangeImage};
use crate::hash::unit;
use crate::raster::Instance;
use crate::scene::{SceneClouds, SceneState, SelectionOptions};

/// Actors with at most this many points get the template of their category. Fewer than for maps: a ray needs
/// no more than a few points around it.
const MIN_ACTOR_POINTS: usize = 500;

/// Room for the motion of bodies and device between the times at which their distance is checked, meters.
const ROOM_M: f64 = 10.0;

/// Clouds of a scene, and their surfaces.
pub(crate) struct Scene<'s, 'a> {
    pub(crate) clouds: &'s SceneClouds<'a>,
    pub(crate) selection: &'s SelectionOptions,
    pub(crate) solids: &'s mut Solids<'a>,
}

impl Scene<'_, '_> {
    /// Returns what rays meet up to a range, in their order.
    ///
    /// # Errors
    /// Fails if points cannot be read.
    pub(crate) fn cast(
        &mut self,
        rays: &[LidarRays],
        motion: &Motion<'_>,
        far_m: f64,
    ) -> Result<Vec<Vec<Option<LidarHit>>>, LidarError> {
        let bodies = self.bodies(motion);
        let reaches = |body: &&Body| {
            let ends = [rays.first(), rays.get(rays.len() / 2), rays.last()];
            let is_near = |rays: &LidarRays| body.distance_m(rays.origin, rays.after_s) <= far_m + ROOM_M;
            ends.into_iter().flatten().any(is_near)
        };
        self.solids.make(bodies.iter().filter(reaches).map(|body| body.cloud))?;
        let bodies = Bodies::of(bodies, rays);
        Ok(rays.par_iter().map(|rays| cast(rays, &bodies, self.solids, far_m)).collect())
    }

    /// Returns the clouds that have points, and how they move.
    fn bodies(&self, motion: &Motion<'_>) -> Vec<Body> {
        let most = self.selection.min_actor_points.min(MIN_ACTOR_POINTS);
        let selection = SelectionOptions { min_actor_points: most, ..*self.selection };
        let instances = self.clouds.instances(motion.state(), &selection).geometry;
        let (actors, paths) = (&motion.state().actors, motion.paths());
        let body = |instance: &Instance| {
            let bounds = self.solids.bounds(instance.cloud)?;
            let actor = (instance.number as usize).checked_sub(1);
            let actor = actor.and_then(|actor| Some((actors.get(actor)?, *paths.get(actor)?)));
            Some(Body::new(instance, &bounds, actor))
        };
        instances.iter().filter_map(body).collect()
    }
}

/// Renders a sweep of a moving scene.
///
/// # Errors
/// Fails if the spec is invalid, or if points cannot be read.
pub(crate) fn render(
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
        let rays = device.sweep_rays(motion);
        let hits = scene.cast(&rays, motion, device.range_m[1])?;
        let found = Found { device, rays: &rays, hits: &hits };
        let mut image = found.image(&state.global_from_ego.inverse());
        image.first_ring = first_ring;
        first_ring += image.beams;
        lose(&mut image, device.dropout, spec.seed, [state.t_us, number as i64]);
        devices.push(image);
    }
    let tracks = state.actors.iter().map(|actor| actor.track.clone()).collect();
    let SceneState { name, t_us, global_from_ego, .. } = state;
    Ok(LidarSweep { name: name.clone(), t_us: *t_us, global_from_ego: *global_from_ego, tracks, devices })
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
