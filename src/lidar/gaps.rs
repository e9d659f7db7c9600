//! Gaps of surfaces that single rays pass through.

use glam::DVec3;

use super::rays::LidarHit;
use super::search::LAYERS_M;

/// Greatest distance of two places on one surface that the rays beside a ray meet, meters.
const JOINED_M: f64 = 0.6;
/// Greatest distance of a ray from the line between these places, in lengths of that line: the beams of a
/// device may be in any order.
const ASIDE: f64 = 0.1;

/// A ray, and what it meets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray<'a> {
    /// Meters.
    pub(super) origin: &'a DVec3,
    /// Unit vector.
    pub(super) direction: &'a DVec3,
    pub(super) hit: Option<LidarHit>,
}

/// Returns what a ray meets between two others: their surface, if it is one, in front of what the ray meets.
/// Pieces of sparse points have gaps.
#[inline]
pub(super) fn closed(ray: Ray<'_>, [a, b]: [Ray<'_>; 2]) -> Option<LidarHit> {
    let (Some(first), Some(second)) = (a.hit, b.hit) else { return ray.hit };
    let range_m = ray.hit.map_or(f64::INFINITY, |hit| hit.range_m);
    let is_one = (first.class, first.instance) == (second.class, second.instance);
    if !is_one || range_m <= first.range_m.min(second.range_m) {
        return ray.hit;
    }
    let ends = [*a.origin + *a.direction * first.range_m, *b.origin + *b.direction * second.range_m];
    let joined = between(ray, ends).filter(|joined_m| range_m > joined_m + f64::from(LAYERS_M));
    joined.map(|range_m| LidarHit { range_m, ..first }).or(ray.hit)
}

/// Returns the range at which a ray meets the line between two places, if they are near each other.
fn between(ray: Ray<'_>, [a, b]: [DVec3; 2]) -> Option<f64> {
    let (line, from, along) = (b - a, a - *ray.origin, *ray.direction);
    let length_m = line.length();
    if length_m > JOINED_M {
        return None;
    }
    // The nearest places of both lines.
    let slope = line.dot(along);
    let share = (slope * from.dot(along) - line.dot(from)) / (length_m * length_m - slope * slope);
    let range_m = from.dot(along) + share * slope;
    let aside_m = (from + line * share - along * range_m).length();
    (share > 0.0 && share < 1.0 && aside_m <= ASIDE * length_m).then_some(range_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angle between two rays.
    const STEP_RAD: f64 = 0.005;

    /// Returns the ranges of rays but for the first and the last one, after closing. Each has a range (0: no
    /// return) and an instance.
    fn ranges(rays: &[(f64, u32)]) -> Vec<f64> {
        let origin = DVec3::new(7.0, 8.0, 9.0);
        let direction = |i: usize| {
            let (y, x) = (i as f64 * STEP_RAD).sin_cos();
            DVec3::new(x, y, 0.0)
        };
        let directions: Vec<DVec3> = (0..rays.len()).map(direction).collect();
        let ray = |i: usize| {
            let (range_m, instance) = rays[i];
            let hit = (range_m > 0.0).then_some(LidarHit { range_m, class: 1, instance });
            Ray { origin: &origin, direction: &directions[i], hit }
        };
        let closed = (1..rays.len() - 1).map(|i| closed(ray(i), [ray(i - 1), ray(i + 1)]));
        closed.map(|hit| hit.map_or(0.0, |hit| hit.range_m)).collect()
    }

    #[test]
    fn single_rays_do_not_pass_a_surface() {
        let wall = |i: i32| 10.0 / (f64::from(i) * STEP_RAD).cos();
        let found = ranges(&[(wall(0), 2), (30.0, 0), (wall(2), 2), (0.0, 0), (wall(4), 2)]);
        assert!(found.iter().zip(1..).all(|(found, i)| (found - wall(i)).abs() < 1e-9), "{found:?}");
    }

    /// Of two rays, at an edge, of another actor, of what is near, and between places too far apart.
    #[test]
    fn all_other_gaps_are_left() {
        for hits in [
            vec![(10.0, 0), (0.0, 0), (0.0, 0), (10.0, 0)],
            vec![(0.0, 0), (0.0, 0), (10.0, 0)],
            vec![(10.0, 1), (20.0, 0), (10.0, 2)],
            vec![(10.0, 0), (10.19, 0), (10.0, 0)],
            vec![(10.0, 0), (5.0, 0), (10.0, 0)],
            vec![(10.0, 0), (0.0, 0), (10.7, 0)],
            vec![(70.0, 0), (0.0, 0), (70.0, 0)],
        ] {
            let expected: Vec<f64> = hits.iter().map(|(range_m, _)| *range_m).collect();
            assert_eq!(ranges(&hits), expected[1..hits.len() - 1], "{hits:?}");
        }
    }

    /// A ray beside the line, and two beyond its ends.
    #[test]
    fn rays_that_are_not_between_others_are_left() {
        let ends = [DVec3::new(10.0, -0.1, 0.0), DVec3::new(10.0, 0.1, 0.0)];
        let range_m =
            |at: DVec3| between(Ray { origin: &DVec3::ZERO, direction: &at.normalize(), hit: None }, ends);
        assert!((range_m(DVec3::new(10.0, 0.05, 0.0)).unwrap() - 10.0).abs() < 2e-3);
        assert_eq!(
            [[0.0, 0.03], [0.11, 0.0], [-0.11, 0.0]].map(|[y, z]| range_m(DVec3::new(10.0, y, z))),
            [None; 3]
        );
    }
}
