use glam::{DAffine3, DVec2};

use super::schedule::Z_NEAR_M;
use super::{Planes, RasterError, SplatSchedule};
use crate::cloud::Bounds;
use crate::geometry::View;

/// A resident cloud standing somewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Which cloud: its place in the rasterizer's [`CloudSet`](super::CloudSet).
    pub cloud: usize,
    /// Where it stands, `f64`.
    pub world_from_local: DAffine3,
    /// What the instance map shows; 0 for the background.
    pub number: u32,
}

/// Only points within `radius_m` of `center` along the world's x and along its y are drawn (a square).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crop {
    /// World x and y, metres.
    pub center: DVec2,
    /// Half the side of the square, metres.
    pub radius_m: f64,
}

/// What one view shows.
#[derive(Clone, Copy, Debug)]
pub struct SplatJob<'a> {
    /// The camera and where it stands.
    pub view: &'a View,
    /// Radius by depth.
    pub schedule: &'a SplatSchedule,
    /// In order: earlier ones win ties of depth, and point numbers run through them.
    pub instances: &'a [Instance],
    /// Which points are used at all; `None` for all.
    pub crop: Option<Crop>,
    /// Which maps are wanted.
    pub planes: Planes,
}

/// An instance as the shaders get it: everything `f32`, relative to the cloud's own origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// Which cloud.
    pub cloud: usize,
    /// Row-major 3×4: local homogeneous coordinates to `(x·z, y·z, z)`, pixels and metres.
    pub image_from_local: [[f32; 4]; 3],
    /// Row-major 2×4: local homogeneous coordinates to x and y relative to the crop's centre, metres. A point is
    /// used where both are within ± [`Draw::crop_radius_m`]. Zeros without a crop.
    pub crop_from_local: [[f32; 4]; 2],
    /// Metres.
    pub crop_radius_m: f32,
    /// Points of the job before this draw: point `i` of the cloud has number `first_number + i`.
    pub first_number: u32,
    /// [`Instance::number`].
    pub instance: u32,
}

impl Draw {
    /// Whether a crop leaves points out.
    pub(super) fn cropped(&self) -> bool {
        self.crop_from_local != [[0.0; 4]; 2]
    }
}

/// The draws of a job: matrices multiplied out in `f64`, instances that cannot reach the image left out (their
/// points are counted in the numbering all the same). `clouds` gives length and bounds of each resident cloud.
///
/// # Errors
/// An unknown cloud, more than 2³² − 2 points.
pub fn draws_from_job(
    job: &SplatJob<'_>,
    clouds: &[(usize, Option<Bounds>)],
) -> Result<Vec<Draw>, RasterError> {
    let max = u64::from(u32::MAX) - 1;
    let mut draws = Vec::with_capacity(job.instances.len());
    let mut first = 0_u64;
    for instance in job.instances {
        let &(len, bounds) = clouds
            .get(instance.cloud)
            .ok_or(RasterError::UnknownCloud { cloud: instance.cloud, clouds: clouds.len() })?;
        let draw = draw_from_instance(job, instance, first as u32);
        first += len as u64;
        if first > max {
            return Err(RasterError::TooManyPoints { found: first, max });
        }
        if bounds.is_some_and(|b| may_be_seen(&draw, job, &b)) {
            draws.push(draw);
        }
    }
    Ok(draws)
}

/// The draw of an instance in a job, whose first point has this number.
pub(super) fn draw_from_instance(job: &SplatJob<'_>, instance: &Instance, first_number: u32) -> Draw {
    let world = instance.world_from_local;
    let crop_row = |axis: usize, center: f64| {
        let m = world.matrix3;
        let row = [m.x_axis[axis], m.y_axis[axis], m.z_axis[axis], world.translation[axis] - center];
        row.map(|v| v as f32)
    };
    let (crop_from_local, crop_radius_m) = job.crop.map_or(([[0.0; 4]; 2], 0.0), |crop| {
        ([crop_row(0, crop.center.x), crop_row(1, crop.center.y)], crop.radius_m as f32)
    });
    Draw {
        cloud: instance.cloud,
        image_from_local: job.view.image_from_local(&world),
        crop_from_local,
        crop_radius_m,
        first_number,
        instance: instance.number,
    }
}

/// Whether some point within the bounds may cover a pixel: no false "no" (bounds are tested with a margin that is
/// far larger than the rounding of `f32`).
fn may_be_seen(draw: &Draw, job: &SplatJob<'_>, bounds: &Bounds) -> bool {
    let pad = f64::from(job.schedule.max_radius()) + 2.0;
    let (width, height) = (f64::from(job.view.camera.width), f64::from(job.view.camera.height));
    let (near, far) = (f64::from(Z_NEAR_M) - 1e-3, f64::from(job.schedule.z_far_m()) + 1e-3);
    let radius = f64::from(draw.crop_radius_m) + 1e-3;
    let mut outside = [true; 10];
    for corner in bounds.corners() {
        let dot = |row: &[f32; 4]| {
            let [x, y, z] = corner.map(f64::from);
            f64::from(row[0]) * x + f64::from(row[1]) * y + f64::from(row[2]) * z + f64::from(row[3])
        };
        let [u, v, z] = draw.image_from_local.each_ref().map(dot);
        let [cx, cy] = draw.crop_from_local.each_ref().map(dot);
        // A slack in pixel·metres covers rounding where z is tiny.
        let (reach, slack) = (pad * z.max(0.0), 1.0);
        let here = [
            z < near,
            z > far,
            u < -reach - slack,
            u > width * z + reach + slack,
            v < -reach - slack,
            v > height * z + reach + slack,
            cx < -radius,
            cx > radius,
            cy < -radius,
            cy > radius,
        ];
        outside.iter_mut().zip(here).for_each(|(all, this)| *all &= this);
    }
    !outside.contains(&true)
}
