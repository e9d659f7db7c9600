use glam::{DAffine3, DVec2};

use super::schedule::Z_NEAR_M;
use super::{MapSet, RasterError, SplatSchedule};
use crate::cloud::Bounds;
use crate::geometry::View;

/// A posed instance of a resident cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index of the cloud in the rasterizer's [`CloudSet`](super::CloudSet).
    pub cloud: usize,
    /// Pose in the world, `f64`.
    pub world_from_local: DAffine3,
    /// Value in the instance map; 0 for the background.
    pub number: u32,
}

/// Square crop: only points within `radius_m` of `center` along the world's x and y axes are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crop {
    /// World x and y, meters.
    pub center: DVec2,
    /// Half of the side length, meters.
    pub radius_m: f64,
}

/// Input of one view's rendering.
#[derive(Clone, Copy, Debug)]
pub struct SplatJob<'a> {
    /// Camera and its pose.
    pub view: &'a View,
    /// Splat radius by depth.
    pub schedule: &'a SplatSchedule,
    /// Instances in order: earlier ones win depth ties, and point numbers are consecutive across them.
    pub instances: &'a [Instance],
    /// Crop of the points; `None` for all points.
    pub crop: Option<Crop>,
    /// Maps to render; color and class come together.
    pub maps: MapSet,
}

/// An instance in the layout of the shaders: all `f32`, relative to the cloud's own origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// Index of the cloud.
    pub cloud: usize,
    /// Row-major 3×4: local homogeneous coordinates to `(x·z, y·z, z)`, pixels and meters.
    pub image_from_local: [[f32; 4]; 3],
    /// Row-major 2×4: local homogeneous coordinates to x and y relative to the crop's center, meters. A point
    /// is drawn if both are within ± [`Draw::crop_radius_m`]. Zeros without a crop.
    pub crop_from_local: [[f32; 4]; 2],
    /// Half of the crop's side length, meters.
    pub crop_radius_m: f32,
    /// Number of points in the job before this draw: point `i` of the cloud has number `first_number + i`.
    pub first_number: u32,
    /// [`Instance::number`].
    pub instance: u32,
}

impl Draw {
    /// Returns whether a crop applies.
    pub(super) fn cropped(&self) -> bool {
        self.crop_from_local != [[0.0; 4]; 2]
    }
}

/// Returns the draws of a job: matrices multiplied out in `f64`, instances that cannot reach the image
/// omitted (the numbering still counts their points). `clouds` contains the length and bounds of each
/// resident cloud.
///
/// # Errors
/// Fails for an unknown cloud, and for more than 2³² − 2 points.
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

/// Returns the draw of an instance in a job; `first_number` is the number of its first point.
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

/// Returns whether a point within the bounds may cover a pixel. Conservative: the margins far exceed the
/// rounding of `f32`.
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
        // The slack in pixel·meters covers rounding for tiny z.
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
