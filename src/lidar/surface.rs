//! Local surfaces: a plane through the visible points around a ray.
//!
//! # How it works
//! In an image, 1 / z of a plane is an affine function of the tangents: `1 / z = a x + b y + c` for the plane
//! `a X + b Y + c Z = 1`. A surface is the plane through the points of a few blocks around the ray. One of
//! them, the seed, selects the surface: points count less the more their 1 / z differs from the seed's,
//! relative to their distance. Then points count less the farther they are from the plane, and the plane is
//! fitted again. A ray meets the surface if it passes between its points, in at least three of the four
//! quadrants around it, or close to one of them.

use super::image::Hit;

/// Distance from the plane at which a point counts a quarter, meters, in each fit after the first.
const SPREAD_M: [f64; 3] = [0.2, 0.05, 0.05];
/// Least distance of the sensor from a plane, meters. Planes between an object and what is behind it are
/// nearer.
const CLEAR_M: f64 = 0.35;
/// Distance of planes from the sensor that points around a seed are on, meters.
const SEED_CLEAR_M: f64 = 0.7;
/// Part of 1 / z that points around a seed may differ by.
const SEED_ROUGHNESS: f64 = 0.02;
/// What is behind a surface is at least this part of its distance and this many meters behind it.
const BEHIND: f64 = 0.02;
const BEHIND_M: f64 = 0.2;
/// Least number of points of a plane between which a ray passes.
const MIN_POINTS: usize = 5;
/// Weight of the assumption that 1 / z is constant, for points on a line.
const RIDGE: f64 = 1e-3;

/// Points around a ray: their offsets in tangents from the ray, and 1 / z.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Near {
    pub(super) offset: [f64; 2],
    pub(super) inverse_z: f64,
    /// Weight by the distance from the ray.
    pub(super) weight: f64,
    pub(super) label: u32,
}

impl Near {
    /// Creates a point around a ray with some tangents; points farther than `reach` in tangents do not count.
    pub(super) fn new(hit: &Hit, [x, y]: [f64; 2], reach: f64) -> Self {
        let [x, y] = [f64::from(hit.at[0]) - x, f64::from(hit.at[1]) - y];
        let rest = (1.0 - (x * x + y * y) / (reach * reach)).max(0.0);
        Self { offset: [x, y], inverse_z: f64::from(hit.inverse_z), weight: rest * rest, label: hit.label }
    }

    /// Returns the squared distance from the ray, square tangents.
    pub(super) fn distance2(&self) -> f64 {
        let [x, y] = self.offset;
        x * x + y * y
    }
}

/// A plane in tangents around a ray: `1 / z = slope · offset + inverse_z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane {
    pub(super) slope: [f64; 2],
    /// On the ray.
    pub(super) inverse_z: f64,
}

/// A surface that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surface {
    pub(super) plane: Plane,
    /// Of its nearest point.
    pub(super) label: u32,
}

/// How far points count, in tangents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reach {
    /// Size of a block.
    pub(super) side: f64,
    /// Distance at which a single point is met.
    pub(super) touch: f64,
    /// Greatest distance of the nearest point.
    pub(super) gap: f64,
}

impl Plane {
    fn at(&self, [x, y]: [f64; 2]) -> f64 {
        self.slope[0] * x + self.slope[1] * y + self.inverse_z
    }

    /// Returns the plane's normal `[a, b, c]` for a ray with some tangents, per meter.
    pub(super) fn normal(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let [a, b] = self.slope;
        [a, b, self.inverse_z - a * x - b * y]
    }
}

/// Returns the surface around a seed that a ray with some tangents meets; `None` if it passes beside it.
pub(super) fn meet(near: &[Near], seed: &Near, tangents: [f64; 2], reach: &Reach) -> Option<Surface> {
    let around = |point: &Near| {
        let [x, y] = [0, 1].map(|i| point.offset[i] - seed.offset[i]);
        let tolerance = SEED_ROUGHNESS * seed.inverse_z + (x * x + y * y).sqrt() / SEED_CLEAR_M;
        quarter((point.inverse_z - seed.inverse_z) / tolerance)
    };
    let mut plane = fit(near, reach, |point| around(point) * point.weight)?;
    for spread_m in SPREAD_M {
        let scale = distance_scale(&plane, tangents)?;
        plane = fit(near, reach, |point| quarter(off(&plane, point) * scale / spread_m) * point.weight)?;
    }
    let scale = distance_scale(&plane, tangents)?;
    let tolerance_m = 2.0 * SPREAD_M[2];
    let on_plane = |point: &&Near| (off(&plane, point) * scale).abs() <= tolerance_m;
    let (mut quadrants, mut nearest, mut count) = (0_u8, None::<&Near>, 0);
    for point in near.iter().filter(on_plane) {
        count += 1;
        quadrants |= 1 << (u8::from(point.offset[0] > 0.0) + 2 * u8::from(point.offset[1] > 0.0));
        if nearest.is_none_or(|nearest| point.distance2() < nearest.distance2()) {
            nearest = Some(point);
        }
    }
    let nearest = nearest?;
    let distance = nearest.distance2().sqrt();
    if quadrants.count_ones() >= 3 && count >= MIN_POINTS && distance <= reach.gap {
        return Some(Surface { plane, label: nearest.label });
    }
    // The plane of few points may lie between surfaces.
    let flat = Plane { slope: [0.0; 2], inverse_z: nearest.inverse_z };
    (distance <= reach.touch).then_some(Surface { plane: flat, label: nearest.label })
}

impl Surface {
    /// Returns how many points are on the surface that a ray with some tangents meets.
    pub(super) fn count(&self, near: &[Near], tangents: [f64; 2]) -> usize {
        let Some(scale) = distance_scale(&self.plane, tangents) else { return 0 };
        near.iter().filter(|point| (off(&self.plane, point) * scale).abs() <= 2.0 * SPREAD_M[2]).count()
    }

    /// Returns whether a point is clearly in front of the surface: nearer than its plane there.
    pub(super) fn is_behind(&self, point: &Near) -> bool {
        self.plane.at(point.offset) < point.inverse_z * (1.0 - BEHIND - BEHIND_M * point.inverse_z)
    }
}

/// Returns a weight of 1 at 0 and a quarter at ±1.
fn quarter(x: f64) -> f64 {
    let weight = 1.0 / (1.0 + x * x);
    weight * weight
}

/// Returns the difference of a point's 1 / z to the plane's, relative to its own.
fn off(plane: &Plane, point: &Near) -> f64 {
    (plane.at(point.offset) - point.inverse_z) / point.inverse_z
}

/// Returns the distance of the plane from the sensor, which converts [`off`] to meters; `None` if it is too
/// near to be a surface.
fn distance_scale(plane: &Plane, tangents: [f64; 2]) -> Option<f64> {
    let [a, b, c] = plane.normal(tangents);
    let distance_m = 1.0 / (a * a + b * b + c * c).sqrt();
    (distance_m >= CLEAR_M).then_some(distance_m)
}

/// Fits a plane by weighted least squares; `None` if all weights vanish.
fn fit(near: &[Near], reach: &Reach, weight: impl Fn(&Near) -> f64) -> Option<Plane> {
    let (mut sum, mut mean) = (0.0, [0.0; 3]);
    let (mut xx, mut xy, mut yy, mut xq, mut yq) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for point in near {
        let (w, [x, y], q) = (weight(point), point.offset, point.inverse_z);
        sum += w;
        mean = [mean[0] + w * x, mean[1] + w * y, mean[2] + w * q];
        (xx, xy, yy) = (xx + w * x * x, xy + w * x * y, yy + w * y * y);
        (xq, yq) = (xq + w * x * q, yq + w * y * q);
    }
    if sum.is_nan() || sum <= 1e-9 {
        return None;
    }
    let [x, y, q] = mean.map(|value| value / sum);
    let ridge = RIDGE * sum * reach.side * reach.side;
    let (xx, xy, yy) = (xx - sum * x * x + ridge, xy - sum * x * y, yy - sum * y * y + ridge);
    let (xq, yq) = (xq - sum * x * q, yq - sum * y * q);
    let determinant = xx * yy - xy * xy;
    let slope = [(xq * yy - yq * xy) / determinant, (yq * xx - xq * xy) / determinant];
    let inverse_z = q - slope[0] * x - slope[1] * y;
    (inverse_z > 0.0 && inverse_z.is_finite()).then_some(Plane { slope, inverse_z })
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH: Reach = Reach { side: 0.003, touch: 0.001, gap: 0.006 };

    fn near(at: [f64; 2], inverse_z: f64, label: u32, tangents: [f64; 2]) -> Near {
        let hit = Hit { at: at.map(|tangent| tangent as f32), inverse_z: inverse_z as f32, label };
        Near::new(&hit, tangents, 3.0 * REACH.side)
    }

    /// Points of the plane `a X + b Y + c Z = 1` on a grid of 5 by 5 tangents around a ray.
    fn grid([a, b, c]: [f64; 3], tangents: [f64; 2], label: u32) -> Vec<Near> {
        let [x, y] = tangents;
        let offsets =
            (-2..=2).flat_map(|i| (-2..=2).map(move |j| [f64::from(i) * 0.003, f64::from(j) * 0.003]));
        let point = |[right, down]: [f64; 2]| {
            let [x, y] = [x + right, y + down];
            near([x, y], a * x + b * y + c, label, tangents)
        };
        offsets.map(point).collect()
    }

    /// The road 1.8 m below the sensor, seen 3.4 degrees below the horizon: 30 m ahead.
    #[test]
    fn grazing_planes_are_exact() {
        let tangents = [0.1, 0.06];
        let near = grid([0.0, 1.0 / 1.8, 0.0], tangents, 7);
        let surface = meet(&near, &near[12], tangents, &REACH).unwrap();
        let z = 1.0 / surface.plane.inverse_z;
        assert!((z - 30.0).abs() < 0.02 && surface.label == 7, "{z}");
    }

    /// A car at 10 m covers the left half of a wall at 12 m: the ray passes through the car if it is inside,
    /// and meets the wall if it is beside it.
    #[test]
    fn edges_separate_surfaces() {
        let (car, wall) = (grid([0.0, 0.0, 0.1], [0.0; 2], 1), grid([0.0, 0.0, 1.0 / 12.0], [0.0; 2], 0));
        for (edge, expected) in [(0.004, Some(1)), (-0.004, Some(0))] {
            let side = |point: &&Near| (point.offset[0] < edge) == (point.label == 1);
            let near: Vec<Near> = car.iter().chain(&wall).filter(side).copied().collect();
            let label = |seed: &Near| meet(&near, seed, [0.0; 2], &REACH).map(|surface| surface.label);
            let seed = near.iter().min_by(|a, b| a.distance2().total_cmp(&b.distance2())).unwrap();
            assert_eq!(label(seed), expected, "{edge}");
            let other = near.iter().find(|point| Some(point.label) != expected).unwrap();
            assert_ne!(label(other), Some(other.label), "{edge}");
        }
    }

    #[test]
    fn lone_points_are_met_only_close_by() {
        let lone = |x: f64| near([x, 0.0], 0.1, 3, [0.0; 2]);
        let met =
            |x: f64| meet(&[lone(x)], &lone(x), [0.0; 2], &REACH).map(|surface| surface.plane.inverse_z);
        assert!((met(0.0005).unwrap() - 0.1).abs() < 1e-8 && met(0.002).is_none());
        assert_eq!(met(-0.002), None);
    }
}
