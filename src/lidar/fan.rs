//! Rays near a half-plane, and which of them may meet a box.

use std::ops::Range;

use glam::{DMat3, DVec3, Mat3A, Vec3A};

use super::lanes::{LANES, Lanes, and, dot, squared};

/// What boxes are larger by for rounding: meters, and part of their distance.
const SLACK: [f32; 2] = [1e-3, 1e-5];

/// Parts that the slopes are divided into: the first ray in each is known.
const PARTS: usize = 256;

/// Least range of slopes that is divided.
const LEAST_SPAN: f32 = 1e-6;

/// Directions of rays from a point, all near a half-plane, in the order of their slopes: components across
/// the middle of the fan per component along it. They are in the frame of the boxes, which may be scaled:
/// directions need not be unit vectors.
#[derive(Clone, Debug)]
pub(super) struct Fan {
    /// Components of the directions, with lanes behind the last one.
    pub(super) directions: [Vec<f32>; 3],
    /// Lengths of the directions.
    pub(super) lengths: Vec<f32>,
    /// Number of each direction as given.
    pub(super) order: Vec<u32>,
    /// Axes of the fan in the boxes' frame: along the middle of the rays, across it, beside the half-plane.
    axes: [[f32; 3]; 3],
    /// Their absolute values, for half sizes.
    sizes: [[f32; 3]; 3],
    /// Whether all rays go forward along the middle. Else they have no slopes.
    is_narrow: bool,
    /// Least slope.
    least: f32,
    /// Parts per slope.
    scale: f32,
    /// First ray in each part, or after it; behind the last part, how many rays there are.
    first: [u32; PARTS + 1],
    /// Greatest distance of a ray from the half-plane, as part of its length along the middle; of its whole
    /// length without slopes.
    spread: f32,
}

/// The parts of a fan that boxes cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reach<const N: usize> {
    /// Whether a ray may meet the box.
    pub(super) is_met: [bool; N],
    /// Least distance at which a ray can meet the box, in the boxes' frame.
    pub(super) near: Lanes<N>,
    /// First of the parts with such rays, and the one behind the last.
    parts: [[i32; N]; 2],
}

impl Fan {
    pub(super) fn of(directions: impl Iterator<Item = DVec3>) -> Self {
        let given: Vec<Vec3A> = directions.map(|direction| direction.as_vec3a()).collect();
        let middle = given.iter().map(|direction| direction.normalize_or_zero()).sum::<Vec3A>();
        let middle = middle.normalize_or(Vec3A::X);
        let [first, last] = [given.first(), given.last()].map(|end| end.copied().unwrap_or(middle));
        let across = middle.any_orthonormal_vector();
        let normal = first.cross(last).reject_from_normalized(middle).normalize_or(across);
        let up = normal.cross(middle);
        let is_narrow = given.iter().all(|direction| direction.dot(middle) > 1e-3 * direction.length());
        let whole = |direction: &Vec3A| if is_narrow { direction.dot(middle) } else { direction.length() };
        let spread = given.iter().map(|direction| direction.dot(normal).abs() / whole(direction));
        let spread = spread.fold(0.0, f32::max);
        let mut order: Vec<u32> = (0..given.len() as u32).collect();
        let slopes: Vec<f32> =
            given.iter().map(|direction| direction.dot(up) / direction.dot(middle)).collect();
        if is_narrow {
            order.sort_by(|a, b| slopes[*a as usize].total_cmp(&slopes[*b as usize]));
        }
        let ends = [order.first(), order.last()];
        let [least, greatest] = ends.map(|ray| ray.map_or(0.0, |number| slopes[*number as usize]));
        let scale = PARTS as f32 / (greatest - least).max(LEAST_SPAN);
        let first = if is_narrow {
            firsts(order.iter().map(|number| (slopes[*number as usize] - least) * scale))
        } else {
            firsts(order.iter().map(|_| 0.0))
        };
        let (directions, lengths) = columns(order.iter().map(|number| given[*number as usize]));
        let axes = [middle, up, normal].map(|axis| axis.to_array());
        let sizes = axes.map(|axis| axis.map(f32::abs));
        Self { directions, lengths, order, axes, sizes, is_narrow, least, scale, first, spread }
    }

    /// Returns a direction, by its number in the order of slopes.
    pub(super) fn direction(&self, ray: usize) -> Vec3A {
        let [x, y, z] = &self.directions;
        Vec3A::new(x[ray], y[ray], z[ray])
    }

    /// Returns the fan in a frame to which a matrix turns and scales directions.
    pub(super) fn turned(&self, matrix: DMat3) -> Self {
        let matrix = Mat3A::from(matrix.as_mat3());
        let scale = matrix.x_axis.length();
        let error = (matrix.transpose() * matrix - Mat3A::IDENTITY * (scale * scale)).abs();
        let is_similar = error.to_cols_array().iter().all(|error| *error <= 1e-6 * scale * scale);
        let directions = (0..self.order.len()).map(|ray| matrix * self.direction(ray));
        if !is_similar {
            let mut given = vec![Vec3A::ZERO; self.order.len()];
            for (direction, number) in directions.zip(&self.order) {
                given[*number as usize] = direction;
            }
            return Self::of(given.into_iter().map(|direction| direction.as_dvec3()));
        }
        let axes = self.axes.map(|axis| (matrix * Vec3A::from(axis) / scale).to_array());
        let sizes = axes.map(|axis| axis.map(f32::abs));
        let (directions, lengths) = columns(directions);
        Self { directions, lengths, order: self.order.clone(), axes, sizes, ..*self }
    }

    /// Returns the least distance at which a ray may meet a box; `None` if none may. The box has its center
    /// from the fan's origin, and half its size along axes, the columns of a matrix.
    pub(super) fn near(&self, offset: DVec3, axes: DMat3, half: DVec3) -> Option<f32> {
        let own = DMat3::from_cols_array_2d(&self.axes.map(|axis| axis.map(f64::from))).transpose();
        let extents = ((own * axes).abs() * half).to_array().map(|extent| Lanes([extent as f32]));
        let reach = self.reach((own * offset).to_array().map(|offset| Lanes([offset as f32])), extents);
        reach.is_met[0].then_some(reach.near.0[0])
    }

    /// Returns the rays that may meet the box of two corners, and perhaps some beside them.
    pub(super) fn rays_to(&self, corners: [DVec3; 2], origin: DVec3) -> Range<usize> {
        let [min, max] = corners.map(|corner| (corner - origin).as_vec3().to_array());
        let lanes = |each: fn(f32, f32) -> f32| [0, 1, 2].map(|axis| Lanes([each(min[axis], max[axis])]));
        let reach = self.reach_boxes(lanes(f32::midpoint), lanes(|min, max| (max - min) / 2.0));
        let [start, end] = self.rays(&reach, 0).map(|ray| ray as usize);
        if reach.is_met[0] { start..end } else { 0..0 }
    }

    /// Returns the parts of the fan that axis-aligned boxes cover. Their centers are from the fan's origin.
    #[inline(always)]
    pub(super) fn reach_boxes<const N: usize>(
        &self,
        centers: [Lanes<N>; 3],
        halves: [Lanes<N>; 3],
    ) -> Reach<N> {
        let ([x, y, z], [along, across, beside]) = (self.axes, self.sizes);
        self.reach(
            [dot(x, centers), dot(y, centers), dot(z, centers)],
            [dot(along, halves), dot(across, halves), dot(beside, halves)],
        )
    }

    /// Returns the parts of the fan that boxes cover, from their centers and half sizes along the fan's axes.
    #[inline(always)]
    fn reach<const N: usize>(&self, centers: [Lanes<N>; 3], extents: [Lanes<N>; 3]) -> Reach<N> {
        let [along, across, beside] = centers;
        let slack = (along.abs() + across.abs() + beside.abs()) * SLACK[1] + SLACK[0];
        let [half, height, width] = [extents[0] + slack, extents[1] + slack, extents[2] + slack];
        let beside = beside.abs() - width;
        if !self.is_narrow {
            let (distance, radius) = (squared(centers).sqrt(), squared([half, height, width]).sqrt());
            let is_met = beside.at_most((distance + radius) * self.spread);
            let near = (distance - radius).max(Lanes::all(0.0));
            return Reach { is_met, near, parts: [[0; N], [PARTS as i32; N]] };
        }
        // No ray is shorter than its part along the middle.
        let (zero, far) = (Lanes::all(0.0), along + half);
        let near = (along - half).max(zero);
        let (low, high) = (across - height, across + height);
        let is_met = and(beside.at_most(far * self.spread), zero.at_most(far));
        let (low, high) = (low / low.negative(near, far), high / high.negative(far, near));
        let end = Lanes::all(PARTS as f32);
        let low = ((low - self.least) * self.scale).max(zero).min(end);
        let high = ((high - self.least) * self.scale + 1.0).min(end).max(zero);
        Reach { is_met, near, parts: [low.truncated(), high.truncated()] }
    }

    /// Returns the first of the rays that may meet a box, and the one behind the last; perhaps with some
    /// beside them.
    #[inline(always)]
    pub(super) fn rays<const N: usize>(&self, reach: &Reach<N>, number: usize) -> [u32; 2] {
        [self.first[reach.parts[0][number] as usize], self.first[reach.parts[1][number] as usize]]
    }
}

/// Returns the components of directions with lanes behind the last one, and the lengths.
fn columns(directions: impl ExactSizeIterator<Item = Vec3A>) -> ([Vec<f32>; 3], Vec<f32>) {
    let mut columns = [const { Vec::new() }; 4];
    columns.iter_mut().for_each(|column| column.reserve(directions.len() + LANES));
    let rows = directions.map(|direction| direction.extend(direction.length()).to_array());
    for row in rows.chain([[1.0; 4]; LANES]) {
        columns.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
    }
    let [x, y, z, lengths] = columns;
    ([x, y, z], lengths)
}

/// Returns the first ray in each part of the slopes, or after it; behind the last part, how many there are.
fn firsts(parts: impl ExactSizeIterator<Item = f32>) -> [u32; PARTS + 1] {
    let (mut first, mut next) = ([parts.len() as u32; PARTS + 1], 0);
    for (ray, part) in (0..).zip(parts) {
        let part = (part as usize).min(PARTS - 1);
        if part >= next {
            first[next..=part].fill(ray);
            next = part + 1;
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::between;

    /// Returns where a ray from the origin enters a box.
    fn enter(direction: DVec3, center: DVec3, half: DVec3) -> Option<f64> {
        let [a, b] = [center - half, center + half].map(|corner| corner / direction);
        let (first, last) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
        (first <= last).then_some(first * direction.length())
    }

    /// Every ray that meets a box is found, not nearer than it may: of one and of many rays, in a half-plane
    /// and beside it, forward and on both sides, in frames that are turned, scaled, and squeezed.
    #[test]
    fn no_ray_that_meets_a_box_is_left_out() {
        let (mut met, mut found) = (0, 0);
        for number in 0..400_i64 {
            let at = |part: i64, low: f64, high: f64| between(3, &[number, part], low, high);
            let (yaw, wide, beside) =
                (at(0, -3.0, 3.0), [0.6, 0.6, 2.0][number as usize % 3], at(1, 0.0, 0.1));
            let rays = [1, 2, 40][number as usize / 3 % 3];
            let ray = |i: i64| {
                let (pitch, yaw) = (wide * at(10 + i, -1.0, 1.0), yaw + beside * at(100 + i, -1.0, 1.0));
                DVec3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin())
            };
            let given: Vec<DVec3> = (0..rays).map(ray).collect();
            let turned =
                DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), at(2, -3.0, 3.0)) * at(3, 0.5, 2.0);
            let squeezed = turned * DMat3::from_diagonal(DVec3::new(0.5, 1.0, 1.5));
            let matrix = [DMat3::IDENTITY, turned, squeezed][number as usize % 4 % 3];
            let fan = Fan::of(given.iter().copied()).turned(matrix);
            for place in 0..40 {
                let at = |part: i64, low: f64, high: f64| between(4, &[number, place, part], low, high);
                let center = DVec3::from([0, 1, 2].map(|axis| at(axis, -20.0, 20.0)));
                let center = if place % 8 == 0 { center * 0.02 } else { center };
                let half = DVec3::from([3, 4, 5].map(|axis| at(axis, 0.05, 8.0)));
                let corners = [center - half, center + half];
                let (rays, near) =
                    (fan.rays_to(corners, DVec3::ZERO), fan.near(center, DMat3::IDENTITY, half));
                for (ray, number) in fan.order.iter().enumerate() {
                    let direction = matrix * given[*number as usize];
                    assert!((fan.direction(ray).as_dvec3() - direction).length() < 1e-5);
                    let Some(distance) = enter(direction, center, half) else { continue };
                    assert!(rays.contains(&ray), "{number}: {center} {half}");
                    assert!(near.is_some_and(|near| f64::from(near) <= distance), "{near:?} {distance}");
                    met += 1;
                }
                found += rays.len();
            }
        }
        assert!(met > 20_000 && found < 3 * met, "{met} of {found}");
    }
}
