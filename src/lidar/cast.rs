//! Returns of rays from the visible points of a sector.
//!
//! # How it works
//! Points have a footprint, by which near surfaces hide what is behind them: [`FOOTPRINT_M`]. Where it covers
//! a block of pixels, the surface has a point in most blocks of that level. So levels are searched from coarse
//! to fine, which is from near to far, each for surfaces whose points have its footprint. If none is met, all
//! points are searched from fine to coarse, for surfaces with few points. The plane of a surface met at a
//! coarse level is fitted again to the points of finer blocks. A ray does not begin at the center of the
//! image, so the search is repeated where the ray passes at the range found.

use glam::DVec3;

use super::image::{Hit, LEVELS, SectorImage};
use super::surface::{Near, Plane, Reach, Surface, meet};

/// Distance of neighboring points of a surface, meters: no less in most skeletons.
const FOOTPRINT_M: f64 = 0.015;
/// Blocks to each side of a ray that are searched.
const WINDOW: usize = 2;
const WINDOW_BLOCKS: usize = (2 * WINDOW + 1) * (2 * WINDOW + 1);
/// Range at which the search begins, meters.
const FIRST_M: f64 = 15.0;
/// Searches of a ray.
const ROUNDS: usize = 4;
/// Part of a pixel by which a ray may move in the last round.
const SETTLED_PX: f64 = 0.5;

/// A ray in the frame of a sector's camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ray {
    /// Meters; near zero, since the device moves little within a sector.
    pub(super) origin: DVec3,
    /// Unit direction.
    pub(super) direction: DVec3,
}

/// Return of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Return {
    /// Meters along the ray.
    pub(super) range_m: f64,
    /// Actor number above the class in the lowest byte.
    pub(super) label: u32,
}

/// Returns the first surface that a ray meets; `None` without one.
pub(super) fn cast(image: &SectorImage, ray: &Ray) -> Option<Return> {
    let mut range_m = FIRST_M;
    let mut found = None;
    for _ in 0..ROUNDS {
        let tangents = tangents(ray, range_m)?;
        let surface = search(image, tangents)?;
        let next_m = range(&surface.plane, tangents, ray)?;
        let moved = moved_px(image, ray, tangents, next_m)?;
        range_m = next_m;
        found = Some(Return { range_m, label: surface.label });
        if moved < SETTLED_PX {
            break;
        }
    }
    found
}

/// Returns the tangents of a ray at a range; `None` behind the camera.
fn tangents(ray: &Ray, range_m: f64) -> Option<[f64; 2]> {
    let at: DVec3 = ray.origin + ray.direction * range_m;
    (at.z > 1e-3).then(|| [at.x / at.z, at.y / at.z])
}

/// Returns the range at which a ray meets a plane that was fitted around some tangents.
fn range(plane: &Plane, tangents: [f64; 2], ray: &Ray) -> Option<f64> {
    let normal = DVec3::from(plane.normal(tangents));
    let range_m = (1.0 - normal.dot(ray.origin)) / normal.dot(ray.direction);
    (range_m > 0.0 && range_m.is_finite()).then_some(range_m)
}

/// Returns how far the ray at a range is from some tangents, pixels.
fn moved_px(image: &SectorImage, ray: &Ray, from: [f64; 2], range_m: f64) -> Option<f64> {
    let to = tangents(ray, range_m)?;
    Some((to[0] - from[0]).hypot(to[1] - from[1]) * image.focal)
}

/// Returns the first surface around a ray.
fn search(image: &SectorImage, tangents: [f64; 2]) -> Option<Surface> {
    let mut buffer = [Near::default(); WINDOW_BLOCKS];
    let dense = |level: usize| {
        let (low, high) = footprints(level, image.focal);
        move |hit: &Hit| (low..high).contains(&f64::from(hit.inverse_z))
    };
    let nearest = nearest(image, tangents);
    if nearest == 0.0 {
        return None;
    }
    for level in (0..LEVELS).rev().filter(|level| footprints(*level, image.focal).0 <= nearest) {
        let near = gather(image, level, tangents, dense(level), &mut buffer);
        if let Some(surface) = front(near, image, level, tangents) {
            return Some(refined(image, level, tangents, surface));
        }
    }
    (0..LEVELS).find_map(|level| {
        let near = gather(image, level, tangents, |_| true, &mut buffer);
        front(near, image, level, tangents)
    })
}

/// Returns the greatest 1 / z around a ray, as far as any level is searched.
fn nearest(image: &SectorImage, tangents: [f64; 2]) -> f64 {
    let (last, side) = (&image.levels[LEVELS - 1], (1 << (LEVELS - 1)) as f64);
    let [column, row] = image.pixel(tangents).map(|at| (at / side).floor() as i64);
    let around = -(WINDOW as i64)..=WINDOW as i64;
    let mut greatest = 0.0_f32;
    for row in around.clone().map(|step| row + step) {
        for column in around.clone().map(|step| column + step) {
            if let (Ok(column), Ok(row)) = (usize::try_from(column), usize::try_from(row)) {
                greatest = greatest.max(last.hit(column, row).inverse_z);
            }
        }
    }
    f64::from(greatest)
}

/// Returns the range of 1 / z of points whose footprint covers a block of a level, but none of the next one.
fn footprints(level: usize, focal: f64) -> (f64, f64) {
    let at = |pixels: f64| pixels / (FOOTPRINT_M * focal);
    let low = if level == 0 { f64::MIN_POSITIVE } else { at(2.0_f64.powi(level as i32 - 1)) };
    let high = if level + 1 == LEVELS { f64::INFINITY } else { at(2.0_f64.powi(level as i32)) };
    (low, high)
}

/// Collects the hits of the blocks around a ray.
fn gather<'b>(
    image: &SectorImage,
    level: usize,
    tangents: [f64; 2],
    wanted: impl Fn(&Hit) -> bool,
    buffer: &'b mut [Near; WINDOW_BLOCKS],
) -> &'b [Near] {
    let side = (1 << level) as f64;
    let [column, row] = image.pixel(tangents).map(|at| (at / side).floor() as i64 - WINDOW as i64);
    let blocks = &image.levels[level];
    let mut count = 0;
    for row in row..=row + 2 * WINDOW as i64 {
        for column in column..=column + 2 * WINDOW as i64 {
            let (Ok(column), Ok(row)) = (usize::try_from(column), usize::try_from(row)) else { continue };
            let hit = blocks.hit(column, row);
            if hit.inverse_z > 0.0 && wanted(&hit) {
                buffer[count] = Near::new(&hit, tangents, 3.0 * side / image.focal);
                count += 1;
            }
        }
    }
    &buffer[..count]
}

/// Returns the surface of the nearest point around the ray or, if the ray does not meet it, of the point
/// closest to the ray.
fn front(near: &[Near], image: &SectorImage, level: usize, tangents: [f64; 2]) -> Option<Surface> {
    let side = (1 << level) as f64 / image.focal;
    let reach = Reach { side, touch: 0.6 / image.focal, gap: 1.6 * side };
    let inner = 2.25 * side * side;
    let nearest = near.iter().filter(|point| point.distance2() <= inner);
    let nearest = nearest.max_by(|a, b| a.inverse_z.total_cmp(&b.inverse_z))?;
    meet(near, nearest, tangents, &reach).or_else(|| {
        let closest = near.iter().min_by(|a, b| a.distance2().total_cmp(&b.distance2()))?;
        meet(near, closest, tangents, &reach)
    })
}

/// Returns a surface fitted to finer blocks, or the same if they have too few points of it.
fn refined(image: &SectorImage, level: usize, tangents: [f64; 2], surface: Surface) -> Surface {
    let Some(finer) = level.checked_sub(2) else { return surface };
    let mut buffer = [Near::default(); WINDOW_BLOCKS];
    let expected = surface.plane.inverse_z;
    let near = gather(image, finer, tangents, |_| true, &mut buffer);
    let seed = Near { inverse_z: expected, label: surface.label, ..Near::default() };
    let side = (1 << finer) as f64 / image.focal;
    let reach = Reach { side, touch: 0.6 / image.focal, gap: 1.6 * side };
    let is_same = |fine: &Surface| (fine.plane.inverse_z / expected - 1.0).abs() < 0.05;
    meet(near, &seed, tangents, &reach).filter(is_same).unwrap_or(surface)
}
