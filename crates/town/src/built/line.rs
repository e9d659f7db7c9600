use glam::DVec2;

/// Line along a road, with conversion between positions and distances along and to the left.
#[derive(Clone, Debug)]
pub(super) struct Line {
    points: Vec<DVec2>,
    /// Left offset vector of each point, scaled so that offset edges remain parallel.
    lefts: Vec<DVec2>,
    at_m: Vec<f64>,
}

impl Line {
    /// Creates a line through points and drops those that do not bend it. `None` without two distinct points.
    pub(super) fn new(points: &[DVec2]) -> Option<Self> {
        let retained = thinned(points);
        if retained.len() < 2 {
            return None;
        }
        let normals: Vec<DVec2> =
            retained.windows(2).map(|p| (p[1] - p[0]).normalize_or_zero().perp()).collect();
        let left = |i: usize| match (i.checked_sub(1).and_then(|i| normals.get(i)), normals.get(i)) {
            (Some(a), Some(b)) => {
                let middle = (*a + *b).normalize_or(*b);
                middle / middle.dot(*b).max(0.5)
            }
            (Some(n), None) | (None, Some(n)) => *n,
            (None, None) => DVec2::Y,
        };
        let lefts = (0..retained.len()).map(left).collect();
        let mut at_m = vec![0.0];
        for pair in retained.windows(2) {
            at_m.push(at_m[at_m.len() - 1] + pair[0].distance(pair[1]));
        }
        Some(Self { points: retained, lefts, at_m })
    }

    /// Returns the same line from its end to its start.
    pub(super) fn reversed(&self) -> Self {
        let length = self.length();
        Self {
            points: self.points.iter().rev().copied().collect(),
            lefts: self.lefts.iter().rev().map(|left| -*left).collect(),
            at_m: self.at_m.iter().rev().map(|s| length - s).collect(),
        }
    }

    /// Returns the length, meters.
    pub(super) fn length(&self) -> f64 {
        self.at_m[self.at_m.len() - 1]
    }

    /// Returns the distances of its points from the start, meters.
    pub(super) fn stations(&self) -> &[f64] {
        &self.at_m
    }

    /// Returns the point at a distance along and to the left, meters; extrapolates straight beyond the ends.
    pub(super) fn point(&self, along_m: f64, left_m: f64) -> DVec2 {
        let i = self.segment(along_m);
        let share = (along_m - self.at_m[i]) / (self.at_m[i + 1] - self.at_m[i]);
        let edge = |i: usize| self.points[i] + self.lefts[i] * left_m;
        if (0.0..=1.0).contains(&share) {
            return edge(i).lerp(edge(i + 1), share);
        }
        let beyond = if share < 0.0 { along_m } else { along_m - self.length() };
        edge(if share < 0.0 { 0 } else { i + 1 }) + self.direction(along_m) * beyond
    }

    /// Returns the unit forward direction.
    pub(super) fn direction(&self, along_m: f64) -> DVec2 {
        let i = self.segment(along_m);
        (self.points[i + 1] - self.points[i]).normalize_or(DVec2::X)
    }

    /// Returns the position along and the offset to the left of the line's nearest point, meters.
    pub(super) fn locate(&self, place: DVec2) -> [f64; 2] {
        let mut best = [f64::INFINITY, 0.0, 0.0];
        for (i, pair) in self.points.windows(2).enumerate() {
            let (length, along) = (self.at_m[i + 1] - self.at_m[i], (pair[1] - pair[0]).normalize_or_zero());
            let s = (place - pair[0]).dot(along).clamp(0.0, length);
            let off = place - pair[0] - along * s;
            if off.length() < best[0] {
                best = [off.length(), self.at_m[i] + s, off.length() * along.perp().dot(off).signum()];
            }
        }
        [best[1], best[2]]
    }

    fn segment(&self, along_m: f64) -> usize {
        self.at_m.partition_point(|s| *s <= along_m).clamp(1, self.points.len() - 1) - 1
    }
}

/// Maximum distance between retained points, meters, and maximum bend between them, radians.
const RETAINED: [f64; 2] = [10.0, 0.025];

fn thinned(points: &[DVec2]) -> Vec<DVec2> {
    let mut retained: Vec<DVec2> = Vec::new();
    let mut heading = None;
    for (i, point) in points.iter().enumerate() {
        let Some(last) = retained.last() else {
            retained.push(*point);
            continue;
        };
        let Some(next) = points.get(i + 1) else {
            if last.distance(*point) < 0.05 && retained.len() > 1 {
                retained.pop();
            }
            if retained.last().is_none_or(|last| last.distance(*point) > 1e-6) {
                retained.push(*point);
            }
            break;
        };
        let (here, ahead) = (*point - *last, *next - *point);
        let first: DVec2 = *heading.get_or_insert(here);
        if last.distance(*next) > RETAINED[0] || first.angle_to(ahead).abs() > RETAINED[1] {
            if here.length() > 0.05 {
                retained.push(*point);
            }
            heading = Some(ahead);
        }
    }
    retained
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_line_ends_and_arc_radius() {
        let straight: Vec<DVec2> = (0..=10).map(|x| DVec2::new(f64::from(x), 1.0)).collect();
        let line = Line::new(&straight).unwrap();
        assert_eq!(line.stations(), [0.0, 10.0]);
        assert_eq!(line.point(4.0, 2.0), DVec2::new(4.0, 3.0));
        assert_eq!(line.point(-3.0, -1.0), DVec2::new(-3.0, 0.0));
        assert_eq!(line.point(12.0, 0.0), DVec2::new(12.0, 1.0));
        assert_eq!(line.locate(DVec2::new(7.0, -4.0)), [7.0, -5.0]);

        let arc: Vec<DVec2> = (0..=60).map(|i| 40.0 * DVec2::from_angle(f64::from(i) / 40.0)).collect();
        let line = Line::new(&arc).unwrap();
        assert!((line.length() - 60.0).abs() < 0.05, "{}", line.length());
        for i in 0..=60 {
            for left in [-9.0, 0.0, 9.0] {
                let radius = line.point(f64::from(i), left).length();
                assert!((radius - 40.0 + left).abs() < 0.03, "{radius} at {i}, {left}");
            }
        }
        assert!(Line::new(&[DVec2::ONE, DVec2::ONE]).is_none());
        assert!(Line::new(&[]).is_none());
    }
}
