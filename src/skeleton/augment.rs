//! Instance augmentation: degraded assets for training, as assets at inference are often sparse or seen from
//! one side only.

use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_4, FRAC_PI_6};
use std::str::FromStr;

use glam::{DAffine3, DMat3, DVec3};
use rand_chacha::ChaCha8Rng;
use rand_core::Rng;
use rand_seeder::Seeder;
use rustc_hash::FxHashMap;
use serde::Serialize;

use crate::cloud::{Bounds, Point};
use crate::geometry::{Camera, ParseOptionError, View};
use crate::raster::reference::{ReferenceRasterizer, project};
use crate::raster::{
    Instance, MapKind, MapSet, Rasterizer, SplatJob, SplatSchedule, SplatStep, draws_from_job,
};

/// Options for the degradation of assets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AugmentOptions {
    /// Seed; all random choices depend only on it and on the track's id.
    pub seed: u64,
    /// Share of the assets that are degraded: half of them are thinned, half reduced to one view.
    pub share: f64,
    /// Range of the point share that thinned assets retain, sampled log-uniformly.
    pub ratio: [f64; 2],
    /// Minimum point count of a degraded asset; an asset with no more points is unchanged.
    pub min_points: usize,
    /// Whether only color maps have the degraded assets, and all other maps the unchanged ones.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub color_only: bool,
}

impl Default for AugmentOptions {
    fn default() -> Self {
        Self { seed: 0, share: 0.8, ratio: [0.05, 0.8], min_points: 200, color_only: false }
    }
}

impl FromStr for AugmentOptions {
    type Err = ParseOptionError;

    /// Parses a seed, `share=S` and `color_only`, all optional: `7,share=0.5,color_only`.
    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let wrong = |found: &str| ParseOptionError {
            expected: "SEED,share=S,color_only with a share from 0 to 1, all optional",
            found: found.to_owned(),
        };
        let mut options = Self { seed: 0, ..Self::default() };
        for part in text.split(',').filter(|part| !part.is_empty()) {
            match (part, part.split_once('=')) {
                ("color_only", _) => options.color_only = true,
                (_, Some(("share", share))) => {
                    let share = share.parse().ok().filter(|share| (0.0..=1.0).contains(share));
                    options.share = share.ok_or_else(|| wrong(part))?;
                }
                (seed, None) => options.seed = seed.parse().map_err(|_| wrong(part))?,
                _ => return Err(wrong(part)),
            }
        }
        Ok(options)
    }
}

/// Degradation applied to an asset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Augmentation {
    /// Unchanged.
    None,
    /// Thinned to one point per voxel.
    Thinned {
        /// Requested share of points.
        ratio: f64,
        /// Side of the voxels, meters.
        voxel_m: f64,
        /// Number of remaining points.
        points: usize,
    },
    /// Reduced to the points visible from one camera.
    OneView {
        /// Direction of the camera, radians to the left from the front.
        azimuth_rad: f64,
        /// Number of remaining points.
        points: usize,
    },
}

/// Returns an asset unchanged, thinned, or reduced to one camera's view. `points` are in box coordinates
/// (meters) and remain in order. The result depends only on the points, the track's id and the options.
pub fn augment(points: &[Point], track: &str, options: &AugmentOptions) -> (Vec<Point>, Augmentation) {
    // ChaCha, and the SipHash that seeds it, give the same numbers on every machine.
    let mut rng: ChaCha8Rng = Seeder::from((options.seed, track)).into_rng();
    let mut unit = || (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    // Always draws all numbers, so that no draw depends on the outcome of another.
    let (changed, thinned, first, second) = (unit() < options.share, unit() < 0.5, unit(), unit());
    let done = if !changed || points.len() <= options.min_points {
        None
    } else if thinned {
        Some(thin(points, first, options))
    } else {
        one_view(points, first, second).filter(|(retained, _)| retained.len() >= options.min_points)
    };
    match done {
        Some((retained, how)) => (retained.into_iter().map(|i| points[i]).collect(), how),
        None => (points.to_vec(), Augmentation::None),
    }
}

/// Ascending indices of the retained points, and the degradation.
type Reduced = (Vec<usize>, Augmentation);

/// Number of bisection steps of the voxel size.
const HALVINGS: u32 = 30;

/// Retains one point per voxel. The voxel size approximates a target share of the points, which is
/// log-uniform in `at` (0 to 1).
fn thin(points: &[Point], at: f64, options: &AugmentOptions) -> Reduced {
    let [low, high] = options.ratio.map(f64::ln);
    let ratio = (low + (high - low) * at).exp();
    let wanted = (ratio * points.len() as f64).round().max(options.min_points as f64);
    let (mut small, mut large) = (1e-4_f64, 100.0_f64);
    // Fallback: all points, if no voxel size leaves enough.
    let mut best = (points.len() as f64 - wanted, 0.0, (0..points.len()).collect::<Vec<_>>());
    for _ in 0..HALVINGS {
        let voxel_m = (small * large).sqrt();
        let retained = one_a_voxel(points, voxel_m);
        let off = (retained.len() as f64 - wanted).abs();
        let enough = retained.len() >= options.min_points;
        if (retained.len() as f64) < wanted {
            large = voxel_m
        } else {
            small = voxel_m
        }
        if enough && off < best.0 {
            best = (off, voxel_m, retained);
        }
    }
    let (_, voxel_m, retained) = best;
    let how = Augmentation::Thinned { ratio, voxel_m, points: retained.len() };
    (retained, how)
}

/// Returns the index of the first point in each voxel, ascending.
fn one_a_voxel(points: &[Point], voxel_m: f64) -> Vec<usize> {
    let mut first: FxHashMap<[i64; 3], usize> = FxHashMap::default();
    for (index, point) in points.iter().enumerate() {
        let voxel = point.position.map(|v| (f64::from(v) / voxel_m).floor() as i64);
        first.entry(voxel).or_insert(index);
    }
    first.into_values().collect::<BTreeSet<_>>().into_iter().collect()
}

/// Camera with 1024x768 pixels and a 90 degree horizontal field of view, `RADII_AWAY` asset radii from
/// the asset's center and level with it.
const WIDTH: u32 = 1024;
const HEIGHT: u32 = 768;
const FOCAL_PX: f64 = 512.0;
const RADII_AWAY: f64 = 2.5;
/// Depth tolerance for points behind the nearest surface in their pixel: a number of asset radii ...
const SURFACE_RADII: f64 = 0.04;
/// ... plus a number of point distances, since splats protrude from surfaces at a slant.
const SURFACE_APART: f64 = 2.0;

/// Returns the points visible from a camera on the side with more points, halfway to the front (or back),
/// rotated by up to 30 degrees more. `end` and `turn` are in 0 to 1. `None` if the points have no extent.
fn one_view(points: &[Point], end: f64, turn: f64) -> Option<Reduced> {
    let bounds = Bounds::of(points)?;
    let [min, max] = [bounds.min, bounds.max].map(|v| DVec3::from(v.map(f64::from)));
    let (centre, radius_m) = ((min + max) / 2.0, (max - min).length() / 2.0);
    let on = |left: bool| points.iter().filter(|p| (p.position[1] > 0.0) == left).count();
    let side = if on(true) >= on(false) { 1.0 } else { -1.0 };
    let from_front = if end < 0.5 { FRAC_PI_4 } else { 3.0 * FRAC_PI_4 };
    let azimuth_rad = side * from_front + (2.0 * turn - 1.0) * FRAC_PI_6;
    let view = camera_at(azimuth_rad, centre, radius_m)?;
    let retained = seen(points, &view, &bounds, radius_m)?;
    let how = Augmentation::OneView { azimuth_rad, points: retained.len() };
    Some((retained, how))
}

fn camera_at(azimuth_rad: f64, centre: DVec3, radius_m: f64) -> Option<View> {
    let (cx, cy) = (f64::from(WIDTH) / 2.0, f64::from(HEIGHT) / 2.0);
    let intrinsics = [[FOCAL_PX, 0.0, cx], [0.0, FOCAL_PX, cy], [0.0, 0.0, 1.0]];
    let camera = Camera::new("side", WIDTH, HEIGHT, intrinsics).ok()?;
    let out = DVec3::new(azimuth_rad.cos(), azimuth_rad.sin(), 0.0);
    // Columns: right, down, forward.
    let right = DVec3::new(out.y, -out.x, 0.0) * -1.0;
    let rotation = DMat3::from_cols(right, DVec3::NEG_Z, -out);
    let world_from_camera = DAffine3::from_mat3_translation(rotation, centre + out * RADII_AWAY * radius_m);
    let usable = world_from_camera.is_finite() && radius_m > 0.0;
    usable.then(|| View { camera, camera_from_world: world_from_camera.inverse() })
}

/// Returns the indices of the unoccluded points in a view.
fn seen(points: &[Point], view: &View, bounds: &Bounds, radius_m: f64) -> Option<Vec<usize>> {
    // Estimates the distance between points as if they covered their bounds; splats of that size close the
    // gaps.
    let [x, y, z]: [f64; 3] = std::array::from_fn(|a| f64::from(bounds.max[a]) - f64::from(bounds.min[a]));
    let apart_m = (2.0 * (x * y + y * z + z * x) / points.len() as f64).sqrt();
    let radius_px = (apart_m * FOCAL_PX / (RADII_AWAY * radius_m)).ceil();
    let radius = radius_px.clamp(1.0, f64::from(SplatSchedule::MAX_RADIUS)) as u32;
    let z_max_m = ((RADII_AWAY + 1.0) * radius_m * 1.01) as f32;
    let schedule = SplatSchedule::new(vec![SplatStep { z_max_m, radius }]).ok()?;
    let instances = [Instance { cloud: 0, world_from_local: DAffine3::IDENTITY, number: 1 }];
    let maps = MapSet::of(&[MapKind::Depth]);
    let job = SplatJob { view, schedule: &schedule, instances: &instances, crop: None, maps };
    let maps = ReferenceRasterizer::new(vec![points.into()]).splat(&job).ok()?;
    let draws = draws_from_job(&job, &[(points.len(), Some(*bounds))]).ok()?;
    let draw = draws.first()?;
    let surface_m = (SURFACE_RADII * radius_m + SURFACE_APART * apart_m) as f32;
    let nothing_before = |point: &Point| {
        let Some(splat) = project(&point.position, draw, &schedule) else { return false };
        let inside = splat.x >= 0.0 && splat.y >= 0.0 && splat.x < WIDTH as f32 && splat.y < HEIGHT as f32;
        let pixel = || splat.y as usize * WIDTH as usize + splat.x as usize;
        inside && splat.depth_m <= maps.depth_m[pixel()] + surface_m
    };
    Some((0..points.len()).filter(|i| nothing_before(&points[*i])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    const SIZE: [f64; 3] = [4.6, 1.9, 1.5];

    #[test]
    fn augmentation_has_a_seed_and_two_options() {
        let parsed = |text: &str| text.parse::<AugmentOptions>();
        let defaults = AugmentOptions { seed: 0, ..AugmentOptions::default() };
        assert_eq!(parsed(""), Ok(defaults));
        let all = AugmentOptions { seed: 3, share: 1.0, color_only: true, ..defaults };
        assert_eq!(parsed("3,share=1,color_only"), Ok(all));
        for text in ["x", "3,color", "shares=1", "-1", "share=1.5", "share=nan"] {
            let message = parsed(text).unwrap_err().to_string();
            assert!(message.contains("SEED,share=S,color_only with a share from 0 to 1"), "{message}");
        }
    }

    /// Returns the four sides of a box and its top, with a point every `step_m`.
    fn shell(step_m: f64) -> Vec<Point> {
        let counts = SIZE.map(|s| (s / step_m) as i32);
        let at = |axis: usize, i: i32| (SIZE[axis] * (f64::from(i) / f64::from(counts[axis]) - 0.5)) as f32;
        let mut points = Vec::new();
        for x in 0..=counts[0] {
            for y in 0..=counts[1] {
                for z in 0..=counts[2] {
                    let edge = |i: i32, axis: usize| i == 0 || i == counts[axis];
                    if edge(x, 0) || edge(y, 1) || z == counts[2] {
                        points.push(Point::new([at(0, x), at(1, y), at(2, z)], [1, 2, 3], 1));
                    }
                }
            }
        }
        points
    }

    fn always(seed: u64) -> AugmentOptions {
        AugmentOptions { seed, share: 1.0, ..AugmentOptions::default() }
    }

    #[test]
    fn thinning_approximates_the_ratio_above_the_minimum() {
        let points = shell(0.04);
        for i in 0..=20 {
            let at = f64::from(i) / 20.0;
            let (retained, how) = thin(&points, at, &AugmentOptions::default());
            let Augmentation::Thinned { ratio, voxel_m, points: count } = how else { panic!("{how:?}") };
            assert!((ratio - 0.05 * 16.0_f64.powf(at)).abs() < 1e-12, "log-uniform in 0.05 to 0.8");
            assert_eq!((count, &retained), (retained.len(), &one_a_voxel(&points, voxel_m)));
            let found = count as f64 / points.len() as f64;
            // Points on a grid fall into voxels in whole rows, so not every ratio is attainable.
            assert!((found / ratio - 1.0).abs() < 0.2, "{ratio} {found}");
        }
        let few = shell(0.3);
        assert!(few.len() > 200 && few.len() < 1000, "{}", few.len());
        let (retained, _) = thin(&few, 0.0, &AugmentOptions::default());
        assert!((200..few.len()).contains(&retained.len()), "{}", retained.len());
    }

    #[test]
    fn one_view_sees_two_sides_of_a_box_and_nothing_behind() {
        let points = shell(0.03);
        for (end, turn) in [(0.2, 0.5), (0.7, 0.5), (0.2, 0.3), (0.9, 0.7)] {
            let (retained, how) = one_view(&points, end, turn).unwrap();
            let Augmentation::OneView { azimuth_rad, .. } = how else { panic!("{how:?}") };
            let out = DVec3::new(azimuth_rad.cos(), azimuth_rad.sin(), 0.0);
            // Geometric test: a side faces the camera if the camera is in front of its plane.
            let radius_m = DVec3::from(SIZE).length() / 2.0;
            let eye = out * RADII_AWAY * radius_m;
            let faces = |p: &Point, axis: usize| {
                let v = f64::from(p.position[axis]);
                (v.abs() - SIZE[axis] / 2.0).abs() < 1e-6 && eye[axis] * v.signum() > SIZE[axis] / 2.0
            };
            let on_front = |p: &Point| faces(p, 0) || faces(p, 1);
            let facing = points.iter().filter(|p| on_front(p)).count();
            let seen_facing = retained.iter().filter(|i| on_front(&points[**i])).count();
            assert!(seen_facing as f64 > 0.99 * facing as f64, "{seen_facing} of {facing}");
            // Points on the far sides and the top may only lie within the tolerance of a facing edge.
            for point in retained.iter().map(|i| &points[*i]).filter(|p| !on_front(p)) {
                let to_edge = [0, 1].map(|axis| {
                    let edge = SIZE[axis] / 2.0 * eye[axis].signum();
                    (f64::from(point.position[axis]) - edge).abs()
                });
                assert!(to_edge[0].min(to_edge[1]) < 0.3, "{point:?} is seen at {azimuth_rad}");
            }
        }
    }

    #[test]
    fn the_camera_is_on_the_side_with_more_points() {
        let mut points = shell(0.05);
        points.retain(|p| p.position[1] < 0.3);
        for i in 0..40 {
            let (end, turn) = (f64::from(i % 2) * 0.9, f64::from(i) / 39.0);
            let (_, how) = one_view(&points, end, turn).unwrap();
            let Augmentation::OneView { azimuth_rad, .. } = how else { panic!("{how:?}") };
            let degrees = azimuth_rad.to_degrees();
            assert!((-75.001..=-14.999).contains(&degrees) || (-165.001..=-104.999).contains(&degrees));
            assert_eq!(degrees > -90.0, i % 2 == 0);
        }
    }

    #[test]
    fn shares_match_the_options_for_any_order_and_thread_count() {
        let points = shell(0.15);
        let tracks: Vec<String> = (0..400).map(|i| format!("track-{i}")).collect();
        let options = AugmentOptions { seed: 7, ..AugmentOptions::default() };
        let one = |track: &String| augment(&points, track, &options);
        let all: Vec<_> = tracks.par_iter().map(one).collect();
        let mut backwards: Vec<_> = tracks.iter().rev().map(one).collect();
        backwards.reverse();
        assert_eq!(all, backwards);
        let count = |test: fn(&Augmentation) -> bool| all.iter().filter(|(_, how)| test(how)).count();
        // Four standard deviations of 400 draws are 0.08 for unchanged assets and 0.1 for the halves.
        let clean = count(|how| matches!(how, Augmentation::None));
        assert!((48..=112).contains(&clean), "{clean}");
        let thinned = count(|how| matches!(how, Augmentation::Thinned { .. }));
        assert!((120..=200).contains(&thinned), "{thinned}");
        for (retained, how) in &all {
            assert!(retained.len() >= 200);
            let clean = matches!(how, Augmentation::None);
            assert_eq!(clean, *retained == points, "{how:?}");
        }
        assert_ne!(all[0], augment(&points, &tracks[0], &AugmentOptions { seed: 8, ..options }));
    }

    #[test]
    fn small_flat_and_invalid_assets_are_unchanged() {
        let few = &shell(0.3)[..200];
        assert_eq!(augment(few, "a", &always(1)).1, Augmentation::None);
        assert_eq!(augment(&[], "a", &always(1)), (Vec::new(), Augmentation::None));
        for bad in [f32::NAN, f32::INFINITY, 0.0, 1e38] {
            let points = vec![Point::new([bad; 3], [0; 3], 1); 500];
            for seed in 0..8 {
                let (retained, _) = augment(&points, "a", &always(seed));
                assert_eq!(retained.len(), 500, "{bad}");
            }
        }
    }
}
