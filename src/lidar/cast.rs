//! Returns of rays from the visible points of a sector.
//!
//! # How it works
//! Points of dense surfaces have a footprint: [`FOOTPRINT_M`]. Where it covers a block of pixels, the surface
//! has a point in most blocks of that level. So levels are searched from coarse to fine (near to far), each for
//! surfaces whose points have its footprint. If none is met, all points are searched from fine to coarse, for
//! surfaces with few points. A surface with few points in front of the one that is met hides it ([`hiding`]).
//! The plane of a surface met at a coarse level is fitted again to the points of finer blocks. A ray does not
//! begin at the center of the image, so the search is repeated where the ray passes at the range found.

use glam::DVec3;

use super::image::{Hit, LEVELS, SectorImage};
use super::surface::{Near, Plane, Reach, Surface, meet};

/// Distance of neighboring points of a dense surface, meters: a bit more than the voxels of skeletons.
const FOOTPRINT_M: f64 = 0.015;
/// Blocks to each side of a ray that are searched.
const WINDOW: usize = 2;
const WINDOW_BLOCKS: usize = (2 * WINDOW + 1) * (2 * WINDOW + 1);
/// Blocks of a window of the same size at the next finer level.
const WIDE_BLOCKS: usize = (4 * WINDOW + 3) * (4 * WINDOW + 3);
/// Blocks next to a ray.
const INNER_BLOCKS: usize = 9;
/// Coarser levels at which a surface of few points may hide another one.
const HIDING_LEVELS: usize = LEVELS - 1;
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
            let surface = refined(image, level, tangents, surface);
            return Some(hiding(image, level, tangents, &surface).unwrap_or(surface));
        }
    }
    (0..LEVELS).find_map(|level| {
        let near = gather(image, level, tangents, |_| true, &mut buffer);
        let surface = front(near, image, level, tangents)?;
        Some(hiding(image, level, tangents, &surface).unwrap_or(surface))
    })
}

/// Returns the surface that hides one found at a level: a nearer one of few points, between which the ray
/// passes. A surface of few points has as many blocks with points at a level as at the next finer one; a
/// dense surface beside the ray, or with a hole, has more.
fn hiding(image: &SectorImage, level: usize, tangents: [f64; 2], found: &Surface) -> Option<Surface> {
    (level + 1..LEVELS.min(level + HIDING_LEVELS + 1)).find_map(|level| {
        let mut inner = [Near::default(); INNER_BLOCKS];
        let inner = gather(image, level, tangents, |_| true, &mut inner).iter();
        let seeds = inner.filter(|point| found.is_behind(point));
        let seed = seeds.max_by(|a, b| a.inverse_z.total_cmp(&b.inverse_z))?;
        let (mut buffer, mut wide) = ([Near::default(); WINDOW_BLOCKS], [Near::default(); WIDE_BLOCKS]);
        let near = gather(image, level, tangents, |_| true, &mut buffer);
        let side = (1 << level) as f64 / image.focal;
        let reach = Reach { side, touch: 0.0, gap: 1.6 * side };
        let hiding = meet(near, seed, tangents, &reach)?;
        let center = Near { inverse_z: hiding.plane.inverse_z, ..Near::default() };
        let finer = gather(image, level - 1, tangents, |_| true, &mut wide);
        let is_sparse = hiding.count(finer, tangents) * 2 < hiding.count(near, tangents) * 3;
        (found.is_behind(&center) && is_sparse).then_some(hiding)
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

/// Collects the hits of the blocks around a ray, a square that fills the buffer.
fn gather<'b>(
    image: &SectorImage,
    level: usize,
    tangents: [f64; 2],
    wanted: impl Fn(&Hit) -> bool,
    buffer: &'b mut [Near],
) -> &'b [Near] {
    let window = buffer.len().isqrt() as i64 / 2;
    let side = (1 << level) as f64;
    let [column, row] = image.pixel(tangents).map(|at| (at / side).floor() as i64 - window);
    let blocks = &image.levels[level];
    let mut count = 0;
    for row in row..=row + 2 * window {
        for column in column..=column + 2 * window {
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    const FOCAL: f64 = 700.0;
    const SIDE: usize = 160;

    /// Returns an image of points, meters in the frame of its camera.
    fn image(points: impl IntoIterator<Item = (DVec3, u32)>) -> SectorImage {
        let middle = SIDE as f64 / 2.0;
        let rows = [[FOCAL, 0.0, middle], [0.0, FOCAL, middle], [0.0, 0.0, 1.0]];
        let mut hits = vec![Hit::default(); SIDE * SIDE];
        for (p, label) in points {
            let at = [p.x / p.z, p.y / p.z];
            let [column, row] = at.map(|tangent| (tangent * FOCAL + middle).floor());
            if (0.0..SIDE as f64).contains(&column) && (0.0..SIDE as f64).contains(&row) {
                let hit = &mut hits[row as usize * SIDE + column as usize];
                let inverse_z = (1.0 / p.z) as f32;
                if inverse_z > hit.inverse_z {
                    *hit = Hit { at: at.map(|tangent| tangent as f32), inverse_z, label };
                }
            }
        }
        SectorImage::new(&DMat3::from_cols_array_2d(&rows).transpose(), [SIDE; 2], hits)
    }

    /// Points of a wall across the axis, every few meters, beginning at an offset.
    fn wall(z: f64, step: f64, offset: f64, label: u32) -> impl Iterator<Item = (DVec3, u32)> {
        let steps = move || (-60..=60).map(move |i| f64::from(i) * step + offset);
        steps().flat_map(move |x| steps().map(move |y| (DVec3::new(x, y, z), label)))
    }

    /// Rays through the middle of the image, from an origin, toward points of the plane z = 10.
    fn rays(origin: DVec3) -> impl Iterator<Item = (Ray, DVec3)> {
        let steps = || (-9..=9).map(|i| f64::from(i) * 0.043);
        let targets = steps().flat_map(move |x| steps().map(move |y| DVec3::new(x, y, 10.0)));
        targets.map(move |to| (Ray { origin, direction: (to - origin).normalize() }, to))
    }

    #[test]
    fn ranges_are_exact_from_beside_the_center() {
        let image = image(wall(10.0, 0.02, 0.003, 5));
        for (ray, to) in rays(DVec3::new(0.08, -0.02, 0.03)) {
            let found = cast(&image, &ray).unwrap();
            assert!((found.range_m - to.distance(ray.origin)).abs() < 1e-5 && found.label == 5, "{found:?}");
        }
    }

    /// Every seventh pixel has a point of a wall, and another one 2 m behind it is seen between them. Few
    /// rays pass, where there happen to be no points in front of a small group of points behind.
    #[test]
    fn walls_of_few_points_hide_what_is_behind() {
        let sparse = || wall(10.0, 0.1, 0.02, 1);
        let behind = wall(12.0, 0.1, 0.05, 2);
        let image = image(sparse().chain(behind));
        let found: Vec<Return> = rays(DVec3::ZERO).filter_map(|(ray, _)| cast(&image, &ray)).collect();
        let pairs = rays(DVec3::ZERO).zip(&found);
        let wrong = pairs.filter(|((_, to), found)| (found.range_m - to.length()).abs() > 0.05).count();
        assert!(found.len() == 361 && wrong * 20 <= found.len(), "{wrong} of {}", found.len());
    }

    /// Two dense walls leave a slit of 0.3 m, 21 pixels, in front of another wall.
    #[test]
    fn rays_pass_through_holes_in_dense_surfaces() {
        let dense = wall(10.0, 0.02, 0.0, 1).filter(|(at, _)| at.x.abs() >= 0.15);
        let image = image(dense.chain(wall(14.0, 0.02, 0.0, 2)));
        for (ray, to) in rays(DVec3::ZERO).filter(|(_, to)| (to.x.abs() - 0.15).abs() > 0.03) {
            let label = if to.x.abs() < 0.15 { 2 } else { 1 };
            assert_eq!(cast(&image, &ray).map(|found| found.label), Some(label), "{to}");
        }
    }

    #[test]
    fn rays_without_points_have_no_return() {
        let image = image(wall(10.0, 0.02, 0.0, 1).filter(|(at, _)| at.x < 0.0));
        for (ray, to) in rays(DVec3::ZERO).filter(|(_, to)| to.x.abs() > 0.03) {
            assert_eq!(cast(&image, &ray).is_some(), to.x < 0.0, "{to}");
        }
    }
}
