//! The surfaces of the street's models as points.

use glam::DVec3;
use rayon::prelude::*;

use super::models::{self, CarKind};
use super::shape::Ray;
use super::world::{Thing, World};
use crate::geometry::Pose;

/// A model of the street's traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Model {
    Sedan,
    Suv,
    Van,
    /// In mid-step.
    Walker,
    /// A bicycle with its rider.
    Cyclist,
}

/// A point of a model's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Metres from the centre of the model's bounds: x forward, y left, z up.
    pub local_m: DVec3,
    /// Color.
    pub rgb: [u8; 3],
}

impl Model {
    /// Length, width, height of what it is made of, metres.
    pub fn size_m(self) -> DVec3 {
        let bounds = self.thing().local_bounds();
        bounds.max - bounds.min
    }

    fn thing(self) -> Thing {
        let silver = [0.62, 0.64, 0.67];
        let parts = match self {
            Self::Sedan => models::car(CarKind::Sedan, silver),
            Self::Suv => models::car(CarKind::Suv, silver),
            Self::Van => models::car(CarKind::Van, silver),
            Self::Walker => models::walker(0.9, [0.35, 0.40, 0.50], [0.25, 0.25, 0.30]),
            Self::Cyclist => models::cyclist(0.6, [0.70, 0.30, 0.25]),
        };
        Thing { street_from_thing: Pose::IDENTITY, parts }
    }

    /// Points of the surface that can be seen from the side or from above, always the same: where parallel rays in thirteen
    /// directions, about three quarters of `spacing_m` apart, meet it.
    pub fn surface(self, spacing_m: f64) -> Vec<SurfacePoint> {
        let thing = self.thing();
        let bounds = thing.local_bounds();
        let (centre, reach) = ((bounds.min + bounds.max) / 2.0, (bounds.max - bounds.min).length() / 2.0);
        let corners = bounds.corners();
        let world = World::new(vec![thing]);
        let cast = |origin: DVec3, dir: DVec3| {
            let hit = world.cast(&Ray { origin, dir }, f64::INFINITY)?;
            let look = hit.material.look(hit.local, hit.local_normal);
            let rgb = look.color.to_array().map(|v| (v.clamp(0.0, 1.0).sqrt() * 255.0).round() as u8);
            Some(SurfacePoint { local_m: hit.local - centre, rgb })
        };
        let step_m = 0.75 * spacing_m;
        let along = |dir: DVec3| {
            let (u, v) = dir.any_orthonormal_pair();
            let range = |axis: DVec3| {
                let offsets = corners.map(|c| (c - centre).dot(axis));
                let most = offsets.into_iter().fold(0.0, f64::max);
                let steps = (most / step_m).ceil() as i32;
                (-steps..=steps).map(move |i| f64::from(i) * step_m)
            };
            let start = centre - dir * (reach + 1.0);
            let grid = range(u).flat_map(|a| range(v).map(move |b| (a, b)));
            grid.filter_map(|(a, b)| cast(start + u * a + v * b, dir)).collect::<Vec<_>>()
        };
        directions().par_iter().flat_map_iter(|dir| along(*dir)).collect()
    }
}

/// From above, from eight sides, and from four corners above.
fn directions() -> Vec<DVec3> {
    let mut all = vec![DVec3::NEG_Z];
    for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        all.push(DVec3::new(x, y, 0.0));
    }
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        all.push(DVec3::new(x, y, 0.0).normalize());
        all.push(DVec3::new(x, y, -1.0).normalize());
    }
    all
}
