//! Lines on the ground: paths, offsets, curvature.

use glam::DVec2;
use point_skeleton::geometry::Polyline;

/// Creates a path through points and skips those within 1e-9 m of the previous one. Fewer than two distinct
/// points give a path of 1e-6 m in direction x.
pub fn polyline(points: &[DVec2]) -> Polyline {
    let mut retained: Vec<DVec2> = Vec::with_capacity(points.len());
    for point in points {
        if retained.last().is_none_or(|last| last.distance(*point) > 1e-9) {
            retained.push(*point);
        }
    }
    if retained.len() < 2 {
        let start = retained.first().copied().unwrap_or(DVec2::ZERO);
        retained = vec![start, start + DVec2::X * 1e-6];
    }
    Polyline::with_directions(retained, |step| step.normalize_or(DVec2::X))
        .expect("points of a plan are finite")
}

/// Returns the parallel line at a distance to the left, meters (negative: to the right), with a point for
/// each input point on the bisector of its edges.
pub fn offset_line(line: &[DVec2], left_m: f64) -> Vec<DVec2> {
    let path = |i: usize| -> Option<DVec2> { (*line.get(i + 1)? - line[i]).try_normalize() };
    let normal = |i: usize| {
        let after = path(i);
        let before = i.checked_sub(1).and_then(path);
        let (a, b) = (before.or(after).unwrap_or(DVec2::X), after.or(before).unwrap_or(DVec2::X));
        let mean = (a + b).normalize_or(a);
        // At sharp corners the unclamped offset along the bisector would be very long.
        mean.perp() / mean.dot(b).max(0.3)
    };
    line.iter().enumerate().map(|(i, p)| *p + normal(i) * left_m).collect()
}

/// Returns the area between two lines that run side by side, counter-clockwise: along the right one, back
/// along the left one.
pub fn area_between(right: &[DVec2], left: &[DVec2]) -> Vec<DVec2> {
    right.iter().chain(left.iter().rev()).copied().collect()
}

/// Samples a cubic Bezier curve as `steps` edges, both ends included.
pub(super) fn bezier([a, b, c, d]: [DVec2; 4], steps: usize) -> Vec<DVec2> {
    let point = |i: usize| {
        let t = i as f64 / steps as f64;
        let u = 1.0 - t;
        a * (u * u * u) + b * (3.0 * u * u * t) + c * (3.0 * u * t * t) + d * (t * t * t)
    };
    let mut points: Vec<DVec2> = (0..steps).map(point).collect();
    points.push(d);
    points
}

/// Returns the curvature at each point, 1/m, positive to the left: of the circle through it and its
/// neighbours; 0 at the ends.
pub(super) fn curvature(line: &[DVec2]) -> Vec<f64> {
    let mut curvature = vec![0.0; line.len()];
    for (i, p) in line.windows(3).enumerate() {
        let (a, b) = (p[1] - p[0], p[2] - p[1]);
        let product = a.length() * b.length() * (p[2] - p[0]).length();
        curvature[i + 1] = if product > 1e-12 { 2.0 * a.perp_dot(b) / product } else { 0.0 };
    }
    curvature
}

/// Returns whether a point lies inside a polygon.
pub fn contains(polygon: &[DVec2], point: DVec2) -> bool {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    let crossed = edges.filter(|(a, b)| {
        (a.y > point.y) != (b.y > point.y) && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
    });
    crossed.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(radius: f64, edges: usize) -> Vec<DVec2> {
        (0..=edges).map(|i| DVec2::from_angle(i as f64 / edges as f64 * 3.0) * radius).collect()
    }

    #[test]
    fn an_offset_of_an_arc_is_an_arc() {
        let inner = offset_line(&circle(20.0, 90), 4.0);
        for (i, p) in inner.iter().enumerate() {
            // End points have one edge only and move along its normal.
            let tolerance = if i == 0 || i == 90 { 0.02 } else { 1e-9 };
            let wanted = 20.0 - 4.0 / (1.0 / 60.0_f64).cos();
            assert!((p.length() - wanted).abs() < tolerance, "{i} {p}");
        }
        let straight = offset_line(&[DVec2::ZERO, DVec2::new(3.0, 4.0)], -5.0);
        assert!(straight[0].distance(DVec2::new(4.0, -3.0)) < 1e-12);
    }

    #[test]
    fn positions_along_a_line_round_trip() {
        let path = polyline(&circle(20.0, 90));
        for along_m in [-3.0, 0.0, 0.4, 7.7, 30.0, path.length_m(), path.length_m() + 2.0] {
            let (point, direction) = path.at(along_m);
            for left_m in [-2.5_f64, 0.0, 1.5] {
                let (found_m, distance_m) = path.nearest(point + direction.perp() * left_m);
                assert!((found_m - along_m).abs() < 0.06, "{along_m} {left_m} {found_m}");
                if (0.0..=path.length_m()).contains(&along_m) {
                    assert!((distance_m - left_m.abs()).abs() < 1e-2, "{along_m} {left_m} {distance_m}");
                }
            }
        }
        let even = polyline(&path.resampled(1.0));
        let steps: Vec<f64> = even.points().windows(2).map(|p| p[0].distance(p[1])).collect();
        assert!(steps.iter().all(|s| (0.95..=1.0 + 1e-9).contains(s)));
        assert_eq!(even.points().last(), path.points().last());
    }

    #[test]
    fn lines_of_a_single_point_are_short() {
        for points in [&[][..], &[DVec2::ONE], &[DVec2::ONE, DVec2::ONE]] {
            let path = polyline(points);
            assert!(path.length_m() < 2e-6);
            assert_eq!(path.at(1.0).1, DVec2::X);
        }
    }

    #[test]
    fn curvature_of_a_circle_is_constant() {
        let curvature = curvature(&circle(8.0, 30));
        assert!(curvature[1..30].iter().all(|k| (k - 0.125).abs() < 1e-9));
        let polygon = circle(8.0, 30);
        assert!(contains(&polygon, DVec2::new(0.0, 4.0)) && !contains(&polygon, DVec2::new(0.0, -4.0)));
    }
}
