//! Polylines on the ground: offsets, lengths and positions along them.

use glam::DVec2;

/// Projection of a point onto a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// Position along the line, meters; negative before its start, greater than its length beyond its end.
    pub along_m: f64,
    /// Offset to the left of the line, meters.
    pub left_m: f64,
    /// Distance to the line itself, meters; beyond an end the distance to that end.
    pub distance_m: f64,
}

/// Polyline with the length up to each of its points.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    points: Vec<DVec2>,
    lengths_m: Vec<f64>,
}

impl Path {
    /// Creates a path and skips points that repeat the previous one. Fewer than two distinct points give a path of
    /// length 0 in direction x.
    pub fn new(points: &[DVec2]) -> Self {
        let mut kept: Vec<DVec2> = Vec::with_capacity(points.len().max(2));
        for point in points {
            if kept.last().is_none_or(|last| last.distance(*point) > 1e-9) {
                kept.push(*point);
            }
        }
        if kept.is_empty() {
            kept.push(DVec2::ZERO);
        }
        let mut lengths_m = vec![0.0];
        for pair in kept.windows(2) {
            lengths_m.push(lengths_m[lengths_m.len() - 1] + pair[0].distance(pair[1]));
        }
        Self { points: kept, lengths_m }
    }

    /// Returns its points.
    pub fn points(&self) -> &[DVec2] {
        &self.points
    }

    /// Returns the length from the start to each point, meters.
    pub fn lengths_m(&self) -> &[f64] {
        &self.lengths_m
    }

    /// Returns the total length, meters.
    pub fn length_m(&self) -> f64 {
        self.lengths_m[self.lengths_m.len() - 1]
    }

    /// Returns the index of the edge at a distance from the start, meters; clamped to the first or last edge.
    fn edge_at(&self, along_m: f64) -> usize {
        let next = self.lengths_m.partition_point(|l| *l <= along_m);
        next.clamp(1, self.points.len().max(2) - 1) - 1
    }

    fn edge_direction(&self, edge: usize) -> DVec2 {
        match self.points.get(edge..edge + 2) {
            Some(ends) => (ends[1] - ends[0]).normalize_or(DVec2::X),
            None => DVec2::X,
        }
    }

    /// Returns the point at a distance from the start, meters; extrapolates straight beyond the ends.
    pub fn point(&self, along_m: f64) -> DVec2 {
        let edge = self.edge_at(along_m);
        self.points[edge] + self.edge_direction(edge) * (along_m - self.lengths_m[edge])
    }

    /// Returns the unit direction of the edge at a distance from the start, meters.
    pub fn direction(&self, along_m: f64) -> DVec2 {
        self.edge_direction(self.edge_at(along_m))
    }

    /// Returns the unit direction at a distance from the start, meters, interpolated between the middles of adjacent
    /// edges.
    pub fn smooth_direction(&self, along_m: f64) -> DVec2 {
        let edge = self.edge_at(along_m);
        let Some(ends) = self.lengths_m.get(edge..edge + 2) else { return DVec2::X };
        let share = ((along_m - ends[0]) / (ends[1] - ends[0])).clamp(0.0, 1.0) - 0.5;
        let last = self.points.len() - 2;
        let other = if share < 0.0 { edge.saturating_sub(1) } else { (edge + 1).min(last) };
        let here = self.edge_direction(edge);
        here.lerp(self.edge_direction(other), share.abs()).normalize_or(here)
    }

    /// Projects a point onto the line. For `along_m` and `left_m` the line continues straight beyond its ends.
    pub fn foot(&self, point: DVec2) -> Foot {
        let mut best = Foot { along_m: 0.0, left_m: 0.0, distance_m: f64::INFINITY };
        let edges = self.points.len().max(2) - 1;
        for edge in 0..edges {
            let (start, direction) = (self.points[edge], self.edge_direction(edge));
            let length = self.lengths_m.get(edge + 1).map_or(0.0, |l| l - self.lengths_m[edge]);
            let free = (point - start).dot(direction);
            let along = free.clamp(0.0, length);
            let distance_m = point.distance(start + direction * along);
            if distance_m < best.distance_m {
                let ends = (edge == 0 && free < 0.0) || (edge + 1 == edges && free > length);
                let along = if ends { free } else { along };
                let side = direction.perp_dot(point - start);
                let left_m = if ends { side } else { distance_m.copysign(side) };
                best = Foot { along_m: self.lengths_m[edge] + along, left_m, distance_m };
            }
        }
        best
    }

    /// Returns points at even steps of at most `step_m` meters, both ends included.
    pub fn resampled(&self, step_m: f64) -> Vec<DVec2> {
        let steps = (self.length_m() / step_m).ceil().max(1.0) as usize;
        let mut points: Vec<DVec2> =
            (0..steps).map(|i| self.point(self.length_m() * i as f64 / steps as f64)).collect();
        points.extend(self.points.last());
        points
    }

    /// Returns the part between two distances from the start, meters.
    pub fn part(&self, from_m: f64, to_m: f64) -> Vec<DVec2> {
        let inner =
            (0..self.points.len()).filter(|i| (from_m + 1e-6..to_m - 1e-6).contains(&self.lengths_m[*i]));
        let mut points = vec![self.point(from_m)];
        points.extend(inner.map(|i| self.points[i]));
        points.push(self.point(to_m));
        points
    }
}

/// Returns the parallel line at a distance to the left, meters (negative: to the right), with a point for each input
/// point on the bisector of its edges.
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

/// Returns the area between two lines that run side by side, counter-clockwise: along the right one, back along the
/// left one.
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

/// Returns the curvature at each point, 1/m, positive to the left: of the circle through it and its neighbours; 0 at
/// the ends.
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
    fn places_along_a_line_and_back() {
        let path = Path::new(&circle(20.0, 90));
        for along_m in [-3.0, 0.0, 0.4, 7.7, 30.0, path.length_m(), path.length_m() + 2.0] {
            let (point, direction) = (path.point(along_m), path.direction(along_m));
            for left_m in [-2.5, 0.0, 1.5] {
                let foot = path.foot(point + direction.perp() * left_m);
                assert!((foot.left_m - left_m).abs() < 1e-2, "{along_m} {left_m} {foot:?}");
                assert!((foot.along_m - along_m).abs() < 0.06, "{along_m} {left_m} {foot:?}");
            }
        }
        let even = Path::new(&path.resampled(1.0));
        let steps: Vec<f64> = even.points().windows(2).map(|p| p[0].distance(p[1])).collect();
        assert!(steps.iter().all(|s| (0.95..=1.0 + 1e-9).contains(s)));
        assert_eq!(even.points().last(), path.points().last());
    }

    #[test]
    fn lines_of_a_single_point_have_no_length() {
        for points in [&[][..], &[DVec2::ONE], &[DVec2::ONE, DVec2::ONE]] {
            let path = Path::new(points);
            assert_eq!(path.length_m(), 0.0);
            assert_eq!(path.direction(1.0), DVec2::X);
            assert_eq!(path.smooth_direction(1.0), DVec2::X);
            assert!(path.foot(DVec2::ZERO).distance_m.is_finite());
            assert!(!path.resampled(1.0).is_empty());
        }
    }

    #[test]
    fn the_curvature_of_a_circle() {
        let curvature = curvature(&circle(8.0, 30));
        assert!(curvature[1..30].iter().all(|k| (k - 0.125).abs() < 1e-9));
        let polygon = circle(8.0, 30);
        assert!(contains(&polygon, DVec2::new(0.0, 4.0)) && !contains(&polygon, DVec2::new(0.0, -4.0)));
    }
}
