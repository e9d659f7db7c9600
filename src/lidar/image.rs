//! Range images of what rays meet.

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::gaps::{Ray, closed};
use super::rays::{LidarHit, LidarRays};
use super::spec::LidarDevice;
use super::sweep::RangeImage;
use crate::geometry::Pose;

/// What the rays of a device's sweep meet.
pub(super) struct Found<'a> {
    pub(super) device: &'a LidarDevice,
    /// As the device fires them.
    pub(super) rays: &'a [LidarRays],
    /// Of each ray.
    pub(super) hits: &'a [Vec<Option<LidarHit>>],
}

/// A column of the device: what its beams meet.
struct Column<'a> {
    origin: DVec3,
    directions: &'a [DVec3],
    hits: &'a [Option<LidarHit>],
    /// Least range of returns, meters.
    near_m: f64,
}

impl Found<'_> {
    /// Returns the range image; hits below the device's least range are no returns.
    pub(super) fn image(&self, ego_from_global: &Pose) -> RangeImage {
        let (mut image, ego_from_global) = (blank(self.device), ego_from_global.affine());
        let columns = (0..image.columns).into_par_iter();
        let columns: Vec<_> = columns.map(|number| self.returns(number, &ego_from_global)).collect();
        for (column, returns) in columns.into_iter().enumerate() {
            for (beam, found) in returns.into_iter().enumerate() {
                let (Some((hit, position)), at) = (found, beam * image.columns + column) else { continue };
                (image.range_m[at], image.position[at]) = (hit.range_m as f32, position);
                (image.class[at], image.instance[at]) = (hit.class, hit.instance);
            }
        }
        image
    }

    /// Returns the returns of a column's beams, with positions in the ego frame. Gaps of surfaces between the
    /// columns and beams beside are closed.
    fn returns(&self, number: usize, ego_from_global: &DAffine3) -> Vec<Option<(LidarHit, [f32; 3])>> {
        let column = self.column(number);
        let is_inner = number > 0 && number + 1 < self.device.columns;
        let beside = is_inner.then(|| [number - 1, number + 1].map(|number| self.column(number)));
        let beams = column.hits.len();
        let hit = |beam: usize| {
            let mut ray = column.ray(beam);
            if let Some(columns) = &beside {
                ray.hit = closed(ray, [0, 1].map(|i| columns[i].ray(beam)));
            }
            if beam > 0 && beam + 1 < beams {
                ray.hit = closed(ray, [beam - 1, beam + 1].map(|beam| column.ray(beam)));
            }
            let at = *ray.origin + *ray.direction * ray.hit?.range_m;
            Some((ray.hit?, ego_from_global.transform_point3(at).as_vec3().to_array()))
        };
        (0..beams).map(hit).collect()
    }

    fn column(&self, number: usize) -> Column<'_> {
        let (beams, at_once) = (self.device.elevations_deg.len(), self.device.columns_at_once());
        let (rays, first) = (number / at_once, number % at_once * beams);
        let LidarRays { origin, directions, .. } = &self.rays[rays];
        Column {
            origin: *origin,
            directions: &directions[first..first + beams],
            hits: &self.hits[rays][first..first + beams],
            near_m: self.device.range_m[0],
        }
    }
}

impl Column<'_> {
    fn ray(&self, beam: usize) -> Ray<'_> {
        let hit = self.hits[beam].filter(|hit| hit.range_m >= self.near_m);
        Ray { origin: &self.origin, direction: &self.directions[beam], hit }
    }
}

/// Returns the image of a sweep without returns.
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
