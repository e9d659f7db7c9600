//! Which clouds of a frame a camera may see, before their chunks are tested.

use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

use super::chunk::ChunkedCloud;
use super::cull;
use super::draw::draw_from_instance;
use super::layers::{LayerInstance, Layers};
use super::schedule::Z_NEAR_M;
use super::{Crop, FrameJob, Instance, MapSet, RasterError, SplatJob};
use crate::cloud::Bounds;
use crate::geometry::View;

/// An instance that a camera may see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SeenInstance {
    pub(super) layered: LayerInstance,
    /// Number of points in the geometry before it.
    pub(super) geometry_points: u32,
}

/// Returns the instances of a frame that a camera may see, in order. The others do not contribute to the
/// maps, but their points are counted.
///
/// # Errors
/// Fails for an unknown cloud, and for more than 2³² − 2 points.
pub(super) fn seen_instances<'c, 'a: 'c>(
    job: &FrameJob<'_>,
    layers: &Layers,
    clouds: &'c [impl AsRef<ChunkedCloud<'a>> + Sync],
) -> Result<Vec<SeenInstance>, RasterError> {
    let max = u64::from(u32::MAX) - 1;
    let merged = layers.merge(job);
    let (mut all, mut points, mut geometry_points) = (Vec::with_capacity(merged.len()), 0_u64, 0_u64);
    for layered in merged {
        let id = layered.instance.cloud;
        let cloud = clouds.get(id).ok_or(RasterError::UnknownCloud { cloud: id, clouds: clouds.len() })?;
        all.push(SeenInstance { layered, geometry_points: geometry_points as u32 });
        let count = cloud.as_ref().len() as u64;
        points += count;
        geometry_points += if layered.numbered { count } else { 0 };
        if points > max {
            return Err(RasterError::TooManyPoints { found: points, max });
        }
    }
    let sight = Sight::new(job);
    let is_seen = |seen: &SeenInstance| {
        let instance = &seen.layered.instance;
        let bounds = clouds[instance.cloud].as_ref().all.as_ref();
        seen.layered.layers != 0 && bounds.is_some_and(|bounds| sight.sees(instance, bounds))
    };
    Ok(all.into_par_iter().with_min_len(256).filter(is_seen).collect())
}

/// Returns the chunks that a camera may see, as pairs of cloud and chunk, in order and without repetition.
pub(super) fn seen_chunks<'c, 'a: 'c>(
    job: &FrameJob<'_>,
    seen: &[SeenInstance],
    clouds: &'c [impl AsRef<ChunkedCloud<'a>> + Sync],
) -> Vec<(u32, u32)> {
    let (pad, z_far_m) = (job.schedule.max_radius(), job.schedule.z_far_m());
    let chunks = |SeenInstance { layered: LayerInstance { instance, .. }, .. }: &SeenInstance| {
        let cloud = clouds[instance.cloud].as_ref();
        let mut chunks = Vec::new();
        for view in job.views {
            let (schedule, crop) = (job.schedule, job.crop);
            let view_job = SplatJob { view, schedule, instances: &[], crop, maps: MapSet::NONE };
            let draw = draw_from_instance(&view_job, instance, 0);
            let shown = (view.camera.width, [0, view.camera.height]);
            chunks.extend(cull::seen_chunks(cloud, &draw, shown, pad, z_far_m));
        }
        chunks.sort_unstable();
        chunks.dedup();
        let cloud = instance.cloud as u32;
        chunks.into_iter().map(move |chunk| (cloud, chunk))
    };
    let mut chunks: Vec<(u32, u32)> = seen.par_iter().flat_map_iter(chunks).collect();
    // Several instances may share a cloud.
    chunks.sort_unstable();
    chunks.dedup();
    chunks
}

/// Half-spaces in the frame of a camera, `normal · p + offset >= 0`, that contain every drawn point.
struct ViewPlanes {
    camera_from_world: DAffine3,
    planes: [(DVec3, f64); 6],
}

/// What the cameras of a frame may see.
struct Sight {
    views: Vec<ViewPlanes>,
    crop: Option<Crop>,
}

/// Slack in meters, and in pixel · meters: far above the rounding of `f32`.
const SLACK: f64 = 1e-3;
const IMAGE_SLACK: f64 = 1.0;
/// Relative rounding error of `f32`, with a margin.
const ROUNDING: f64 = 1e-6;

impl ViewPlanes {
    fn new(view: &View, pad: f64, z_far_m: f64) -> Self {
        let [u, v, z] = [0, 1, 2].map(|row| view.camera.intrinsics.row(row));
        let (right, bottom) = (f64::from(view.camera.width) + pad, f64::from(view.camera.height) + pad);
        let planes = [
            (z, SLACK - f64::from(Z_NEAR_M)),
            (-z, z_far_m + SLACK),
            (u + z * pad, IMAGE_SLACK),
            (z * right - u, IMAGE_SLACK),
            (v + z * pad, IMAGE_SLACK),
            (z * bottom - v, IMAGE_SLACK),
        ];
        Self { camera_from_world: view.camera_from_world, planes }
    }

    fn sees(&self, world_from_local: &DAffine3, center: DVec3, half: DVec3) -> bool {
        let camera_from_local = self.camera_from_world * *world_from_local;
        let sides = absolute(&camera_from_local.matrix3);
        let (middle, reach) = (camera_from_local.transform_point3(center), sides * half);
        let size = sides * center.abs() + camera_from_local.translation.abs() + reach;
        // Formulated so that NaN counts as seen.
        !self.planes.iter().any(|(normal, offset)| {
            normal.dot(middle) + offset + normal.abs().dot(reach + size * ROUNDING) < 0.0
        })
    }
}

impl Sight {
    fn new(job: &FrameJob<'_>) -> Self {
        let (pad, z_far_m) = (f64::from(job.schedule.max_radius()) + 2.0, f64::from(job.schedule.z_far_m()));
        Self {
            views: job.views.iter().map(|view| ViewPlanes::new(view, pad, z_far_m)).collect(),
            crop: job.crop,
        }
    }

    /// Returns whether a point within the bounds of an instance may be drawn; conservative.
    fn sees(&self, instance: &Instance, bounds: &Bounds) -> bool {
        let [low, high] = [bounds.min, bounds.max].map(|corner| DVec3::from(corner.map(f64::from)));
        let (center, half) = ((low + high) / 2.0, (high - low) / 2.0);
        let world_from_local = &instance.world_from_local;
        if let Some(Crop { center: crop, radius_m }) = self.crop {
            let sides = absolute(&world_from_local.matrix3);
            let reach = (sides * half).truncate();
            let size =
                (sides * center.abs()).truncate() + (world_from_local.translation.truncate() - crop).abs();
            let off = (world_from_local.transform_point3(center).truncate() - crop).abs();
            let least = off - reach - (size + reach) * ROUNDING;
            if least.max_element() > radius_m + SLACK {
                return false;
            }
        }
        self.views.iter().any(|view| view.sees(world_from_local, center, half))
    }
}

fn absolute(matrix: &DMat3) -> DMat3 {
    DMat3::from_cols(matrix.x_axis.abs(), matrix.y_axis.abs(), matrix.z_axis.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use crate::raster::{MapSet, Occlusion, SplatSchedule};

    /// A camera at x = 1000 km that looks along x, a crop of 50 m around it, and cubes of 2 m.
    #[test]
    fn cubes_outside_of_the_frustum_and_the_crop_are_not_seen() {
        let rows = [[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 100, 100, rows).unwrap();
        let rotation = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X).transpose();
        let eye = DVec3::new(1e6, -4e6, 10.0);
        let camera_from_world = DAffine3::from_mat3_translation(rotation, -(rotation * eye));
        let (views, schedule) = ([View { camera, camera_from_world }], SplatSchedule::default());
        let far_m = f64::from(schedule.z_far_m());
        let sees = |crop: Option<f64>, offset: [f64; 3]| {
            let crop = crop.map(|radius_m| Crop { center: eye.truncate(), radius_m });
            let job = FrameJob {
                views: &views,
                schedule: &schedule,
                color: &[],
                geometry: &[],
                occlusion: Occlusion::Scene,
                crop,
                maps: MapSet::SPLATTED,
                out_size: None,
            };
            let world_from_local = DAffine3::from_translation(eye + DVec3::from(offset));
            let instance = Instance { cloud: 0, world_from_local, number: 0 };
            Sight::new(&job).sees(&instance, &Bounds { min: [-1.0; 3], max: [1.0; 3] })
        };
        for (offset, seen) in [
            ([0.5, 0.0, 0.0], true),
            ([-1.5, 0.0, 0.0], false),
            ([far_m + 0.9, 0.0, 0.0], true),
            ([far_m + 1.1, 0.0, 0.0], false),
            ([20.0, 10.0, 0.0], true),
            ([20.0, 14.0, 0.0], false),
            ([20.0, -14.0, 0.0], false),
            ([20.0, 0.0, 14.0], false),
            ([20.0, 0.0, -14.0], false),
        ] {
            assert_eq!(sees(None, offset), seen, "{offset:?}");
        }
        assert!(sees(Some(50.0), [50.9, 0.0, 0.0]) && !sees(Some(50.0), [51.1, 0.0, 0.0]));
        assert!(sees(None, [f64::NAN, 0.0, 0.0]));
    }
}
