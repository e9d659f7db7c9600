//! Polygons of boxes and lanes, as rings of corners.

use glam::DVec2;

use crate::metrics::in_ring;

/// Returns the edges of a ring.
fn edges(ring: &[DVec2]) -> impl Iterator<Item = [DVec2; 2]> {
    ring.iter().copied().zip(ring.iter().copied().cycle().skip(1)).map(|(a, b)| [a, b])
}

/// Returns the distance of a point from a segment, meters.
fn to_segment_m(point: DVec2, [a, b]: [DVec2; 2]) -> f64 {
    let arm = b - a;
    let squared = arm.length_squared();
    let s = if squared > 0.0 { ((point - a).dot(arm) / squared).clamp(0.0, 1.0) } else { 0.0 };
    point.distance(a + s * arm)
}

/// Returns whether two segments share a point.
fn cross([a, b]: [DVec2; 2], [c, d]: [DVec2; 2]) -> bool {
    let side = |from: DVec2, to: DVec2, point: DVec2| (to - from).perp_dot(point - from);
    side(a, b, c) * side(a, b, d) <= 0.0
        && side(c, d, a) * side(c, d, b) <= 0.0
        && a.min(b).cmple(c.max(d)).all()
        && c.min(d).cmple(a.max(b)).all()
}

/// Returns the distance between two segments, meters.
fn between_m(one: [DVec2; 2], other: [DVec2; 2]) -> f64 {
    if cross(one, other) {
        return 0.0;
    }
    let ends = [to_segment_m(one[0], other), to_segment_m(one[1], other)];
    ends.into_iter()
        .chain([to_segment_m(other[0], one), to_segment_m(other[1], one)])
        .fold(f64::INFINITY, f64::min)
}

/// Returns the distance between two polygons, meters; 0 if they share a point.
pub(crate) fn distance_m(one: &[DVec2], other: &[DVec2]) -> f64 {
    let inside = |ring: &[DVec2], of: &[DVec2]| of.first().is_some_and(|point| in_ring(ring, *point));
    if inside(one, other) || inside(other, one) {
        return 0.0;
    }
    let pairs = edges(one).flat_map(|a| edges(other).map(move |b| between_m(a, b)));
    pairs.fold(f64::INFINITY, f64::min)
}

/// Returns whether two polygons share a point.
pub(super) fn touch(one: &[DVec2], other: &[DVec2]) -> bool {
    distance_m(one, other) == 0.0
}

/// Returns whether a polygon has a point within a distance (meters) of a line, or of its ends extended
/// straight by this distance: shapely's `buffer` with square caps.
pub(super) fn is_in_corridor(polygon: &[DVec2], line: &[DVec2], half_width_m: f64) -> bool {
    let near =
        |piece: &[DVec2]| edges(polygon).any(|edge| between_m(edge, [piece[0], piece[1]]) <= half_width_m);
    let inside = line.first().is_some_and(|point| in_ring(polygon, *point));
    let cap = |end: DVec2, before: DVec2| {
        let along = (end - before).normalize_or_zero() * half_width_m;
        let across = along.perp();
        touch(&[end - across, end + along - across, end + along + across, end + across], polygon)
    };
    let caps = || match line {
        [first, second, ..] => cap(*first, *second) || cap(line[line.len() - 1], line[line.len() - 2]),
        _ => false,
    };
    inside || line.windows(2).any(near) || caps()
}

/// Returns the centroid of a polygon (meters): the mean of the corners of a box.
pub(super) fn centroid(ring: &[DVec2]) -> DVec2 {
    let origin = ring.first().copied().unwrap_or_default();
    let parts = edges(ring).map(|[a, b]| ((a - origin).perp_dot(b - origin), (a - origin) + (b - origin)));
    let (area, sum) = parts.fold((0.0, DVec2::ZERO), |(area, sum), (w, point)| (area + w, sum + w * point));
    if area == 0.0 { origin } else { origin + sum / (3.0 * area) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, half_m: f64) -> [DVec2; 4] {
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(i, j)| DVec2::new(x + half_m * i, y + half_m * j))
    }

    #[test]
    fn distances_of_squares() {
        let one = square(0.0, 0.0, 1.0);
        assert_eq!(distance_m(&one, &square(5.0, 0.0, 1.0)), 3.0);
        assert!((distance_m(&one, &square(5.0, 6.0, 1.0)) - 5.0).abs() < 1e-12);
        for other in
            [square(0.1, 0.2, 0.1), square(0.0, 0.0, 9.0), square(1.5, 0.0, 1.0), square(2.0, 0.0, 1.0)]
        {
            assert!(touch(&one, &other) && touch(&other, &one));
        }
        assert_eq!(centroid(&square(3.0, 4.0, 2.0)), DVec2::new(3.0, 4.0));
    }

    #[test]
    fn corridors_have_square_ends() {
        let line = [DVec2::ZERO, DVec2::new(10.0, 0.0)];
        let is_in = |x: f64, y: f64| is_in_corridor(&square(x, y, 0.5), &line, 1.0);
        assert!(is_in(5.0, 1.4) && !is_in(5.0, 1.6));
        assert!(is_in(11.4, 1.4) && !is_in(11.6, 0.0) && is_in(-1.4, -1.4) && !is_in(-1.6, 0.0));
        assert!(is_in_corridor(&square(5.0, 0.0, 20.0), &line, 1.0));
    }
}
