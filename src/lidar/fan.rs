//! Rays near a half-plane, and which of them may meet a box.

use std::ops::Range;

use glam::{DMat3, DVec3, Mat3A, Vec3A};

/// What boxes are larger by for rounding: meters, and part of their distance.
const SLACK: [f32; 2] = [1e-3, 1e-5];

/// Directions of rays from a point, all near a half-plane, in the order of their slopes. The frame is that of
/// the boxes, which may be scaled: directions need not be unit vectors.
#[derive(Clone, Debug)]
pub(super) struct Fan {
    /// Directions in the order of their slopes.
    pub(super) directions: Vec<Vec3A>,
    /// Number of each direction as given.
    pub(super) order: Vec<u32>,
    /// From the boxes' frame to the fan's: along the middle of the rays, across it, beside the half-plane.
    from_boxes: Mat3A,
    /// Its absolute values, for half sizes.
    sizes: Mat3A,
    /// Components across the middle per component along it, ascending; empty if not all rays go forward along
    /// the middle.
    slopes: Vec<f32>,
    /// Greatest distance of a ray from the half-plane, as part of its length.
    spread: f32,
}

/// The part of a fan that a box covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reach {
    /// Least distance at which a ray can meet the box, in the boxes' frame.
    pub(super) near: f32,
    /// Least and greatest slope of such a ray.
    slopes: [f32; 2],
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
        let spread = |most: f32, direction: &Vec3A| most.max(direction.normalize_or_zero().dot(normal).abs());
        let spread = given.iter().fold(0.0, spread);
        let is_narrow = given.iter().all(|direction| direction.dot(middle) > 1e-3 * direction.length());
        let slope = |number: u32| {
            let direction = given[number as usize];
            direction.dot(up) / direction.dot(middle)
        };
        let mut order: Vec<u32> = (0..given.len() as u32).collect();
        let mut slopes = Vec::new();
        if is_narrow {
            order.sort_by(|a, b| slope(*a).total_cmp(&slope(*b)));
            slopes = order.iter().map(|number| slope(*number)).collect();
        }
        let directions = order.iter().map(|number| given[*number as usize]).collect();
        let from_boxes = Mat3A::from_cols(middle, up, normal).transpose();
        Self { directions, order, from_boxes, sizes: from_boxes.abs(), slopes, spread }
    }

    /// Returns the part of the fan that may meet a box; `None` if no ray may. The box has its center from the
    /// fan's origin, and half its size along axes, the columns of a matrix.
    #[inline(always)]
    pub(super) fn reach_of(&self, offset: DVec3, axes: DMat3, half: DVec3) -> Option<Reach> {
        let extents = (self.from_boxes.as_dmat3() * axes).abs() * half;
        self.reach(offset.as_vec3a(), extents.as_vec3a(), (axes * half).length() as f32)
    }

    /// Returns the part of the fan that may meet an axis-aligned box; `None` if no ray may. Its corners are
    /// from the fan's origin.
    #[inline(always)]
    pub(super) fn reach_box(&self, min: Vec3A, max: Vec3A) -> Option<Reach> {
        let half = (max - min) * 0.5;
        self.reach((min + max) * 0.5, self.sizes * half, half.length())
    }

    #[inline(always)]
    fn reach(&self, offset: Vec3A, extents: Vec3A, radius: f32) -> Option<Reach> {
        let distance = offset.length();
        let slack = SLACK[0] + SLACK[1] * distance;
        let [along, across, beside] = (self.from_boxes * offset).to_array();
        let [half, height, width] = (extents + slack).to_array();
        if beside.abs() - width > self.spread * (distance + radius) {
            return None;
        }
        if self.slopes.is_empty() {
            let near = (distance - radius - slack).max(0.0);
            return Some(Reach { near, slopes: [f32::NEG_INFINITY, f32::INFINITY] });
        }
        // No ray is shorter than its part along the middle.
        let (near, far) = ((along - half).max(0.0), along + half);
        if far <= 0.0 {
            return None;
        }
        let (low, high) = (across - height, across + height);
        let slopes = [low / if low < 0.0 { near } else { far }, high / if high > 0.0 { near } else { far }];
        Some(Reach { near, slopes })
    }

    /// Returns which directions a part of the fan has.
    pub(super) fn rays(&self, reach: &Reach) -> Range<usize> {
        if self.slopes.is_empty() {
            return 0..self.directions.len();
        }
        let [low, high] = reach.slopes;
        let first = self.slopes.partition_point(|slope| *slope < low);
        first..first + self.slopes[first..].partition_point(|slope| *slope <= high)
    }

    /// Returns whether a part of the fan has any of these directions.
    #[inline(always)]
    pub(super) fn has(&self, reach: &Reach, rays: &Range<usize>) -> bool {
        let [Some(first), Some(last)] =
            [rays.start, rays.end.wrapping_sub(1)].map(|ray| self.slopes.get(ray))
        else {
            return true;
        };
        reach.slopes[0] <= *last && reach.slopes[1] >= *first
    }
}
