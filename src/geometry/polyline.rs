use std::ops::Range;

use glam::DVec2;

/// Path in the plane, parameterized by arc length and extended straight beyond both ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    /// At least two points; consecutive points differ.
    points: Vec<DVec2>,
    /// Arc length of each point from the first one, meters.
    stations_m: Vec<f64>,
    /// Unit direction of each piece.
    directions: Vec<DVec2>,
}

/// Point of a path that is nearest to a given point (foot).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineProjection {
    /// Arc length from the path's first point, meters; negative or above its length on the straight
    /// extensions.
    pub station_m: f64,
    /// Signed distance of the point from the path, positive to the left, meters.
    pub offset_m: f64,
}

impl Polyline {
    /// Creates a path through points, meters, and skips repeated ones. Returns `None` if fewer than two
    /// remain or a point is not finite.
    pub fn new(points: impl IntoIterator<Item = DVec2>) -> Option<Self> {
        Self::with_directions(points, |step| step / step.length())
    }

    /// As [`new`](Self::new), with a function that returns the unit direction of a piece from its vector.
    /// Division by the length and multiplication by its reciprocal differ in the last bit, which traffic
    /// amplifies.
    pub fn with_directions(
        points: impl IntoIterator<Item = DVec2>,
        direction: impl Fn(DVec2) -> DVec2,
    ) -> Option<Self> {
        let (mut retained, mut stations_m): (Vec<DVec2>, Vec<f64>) = Default::default();
        for point in points {
            let step_m = retained.last().map_or(0.0, |last| last.distance(point));
            let station_m = stations_m.last().unwrap_or(&0.0) + step_m;
            if !station_m.is_finite() || !point.is_finite() {
                return None;
            }
            // Far along a path, a step may vanish in the rounding of the station.
            if retained.is_empty() || stations_m.last().is_some_and(|last| station_m > *last) {
                retained.push(point);
                stations_m.push(station_m);
            }
        }
        let directions = retained.windows(2).map(|ends| direction(ends[1] - ends[0])).collect();
        (retained.len() >= 2).then_some(Self { points: retained, stations_m, directions })
    }

    /// Returns the points, meters.
    pub fn points(&self) -> &[DVec2] {
        &self.points
    }

    /// Returns the stations of the points: arc length from the first one, meters.
    pub fn stations_m(&self) -> &[f64] {
        &self.stations_m
    }

    /// Returns the length, meters.
    pub fn length_m(&self) -> f64 {
        self.stations_m[self.stations_m.len() - 1]
    }

    /// Returns the piece that contains a station (meters), as the index of its first point. The first and
    /// last piece extend beyond the ends.
    pub fn piece(&self, station_m: f64) -> usize {
        let next = self.stations_m.partition_point(|s| *s <= station_m);
        next.clamp(1, self.points.len() - 1) - 1
    }

    /// Returns the position and unit direction at a station (meters).
    pub fn at(&self, station_m: f64) -> (DVec2, DVec2) {
        let piece = self.piece(station_m);
        let direction = self.directions[piece];
        (self.points[piece] + direction * (station_m - self.stations_m[piece]), direction)
    }

    /// Returns the foot of a point (meters) on the pieces in a range of stations. Ties go to the first piece.
    pub fn project(&self, point: DVec2, stations_m: Range<f64>) -> LineProjection {
        let (first, last) = (self.piece(stations_m.start), self.piece(stations_m.end));
        let mut best = (f64::INFINITY, LineProjection { station_m: 0.0, offset_m: 0.0 });
        for piece in first..=last.max(first) {
            let (from, direction) = (self.points[piece], self.directions[piece]);
            let length_m = from.distance(self.points[piece + 1]);
            let low_m = if piece == 0 { f64::NEG_INFINITY } else { 0.0 };
            let high_m = if piece + 2 == self.points.len() { f64::INFINITY } else { length_m };
            let along_m = direction.dot(point - from).clamp(low_m, high_m);
            let away = point - (from + direction * along_m);
            if away.length() < best.0 {
                let side = if direction.perp_dot(away) < 0.0 { -1.0 } else { 1.0 };
                let station_m = self.stations_m[piece] + along_m;
                best = (away.length(), LineProjection { station_m, offset_m: side * away.length() });
            }
        }
        best.1
    }

    /// Returns the station of a point's foot on the whole path, and the distance from the path itself,
    /// meters. Beyond an end, the distance is measured to the end, and the station to the foot on the
    /// straight extension.
    pub fn nearest(&self, point: DVec2) -> (f64, f64) {
        let mut best = (0.0, f64::INFINITY);
        let last = self.directions.len() - 1;
        for (piece, direction) in self.directions.iter().enumerate() {
            let (from, start_m) = (self.points[piece], self.stations_m[piece]);
            let length_m = self.stations_m[piece + 1] - start_m;
            let free_m = direction.dot(point - from);
            let along_m = free_m.clamp(0.0, length_m);
            let distance_m = point.distance(from + *direction * along_m);
            if distance_m < best.1 {
                let is_beyond = (piece == 0 && free_m < 0.0) || (piece == last && free_m > length_m);
                best = (start_m + if is_beyond { free_m } else { along_m }, distance_m);
            }
        }
        best
    }

    /// Returns points at even steps of at most `step_m` meters, both ends included.
    pub fn resampled(&self, step_m: f64) -> Vec<DVec2> {
        let steps = (self.length_m() / step_m).ceil().max(1.0) as usize;
        let mut points: Vec<DVec2> =
            (0..steps).map(|i| self.at(self.length_m() * i as f64 / steps as f64).0).collect();
        points.extend(self.points.last());
        points
    }

    /// Returns the part between two stations, meters.
    pub fn part(&self, from_m: f64, to_m: f64) -> Vec<DVec2> {
        let inner = from_m + 1e-6..to_m - 1e-6;
        let inner =
            self.points.iter().zip(&self.stations_m).filter(|(_, station_m)| inner.contains(station_m));
        let mut points = vec![self.at(from_m).0];
        points.extend(inner.map(|(point, _)| *point));
        points.push(self.at(to_m).0);
        points
    }
}

/// Wraps an angle in radians into `[-pi, pi]`.
pub fn wrap_angle(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle_rad.abs() <= PI { angle_rad } else { angle_rad - TAU * (angle_rad / TAU).round() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> Polyline {
        let points = [(0.0, 0.0), (0.0, 0.0), (3.0, 0.0), (3.0, 4.0)];
        Polyline::new(points.map(DVec2::from)).unwrap()
    }

    #[test]
    fn stations_are_arc_lengths() {
        let line = corner();
        assert_eq!((line.points().len(), line.length_m()), (3, 7.0));
        assert_eq!(line.at(1.0), (DVec2::new(1.0, 0.0), DVec2::X));
        assert_eq!(line.at(5.0), (DVec2::new(3.0, 2.0), DVec2::Y));
        assert_eq!(line.at(-2.0), (DVec2::new(-2.0, 0.0), DVec2::X));
        assert_eq!(line.at(9.0), (DVec2::new(3.0, 6.0), DVec2::Y));
    }

    #[test]
    fn projection_inverts_position() {
        let line = corner();
        for station_m in [-3.0, 0.5, 2.0, 4.0, 6.5, 11.0] {
            for offset_m in [-0.9, 0.0, 0.4] {
                let (place, direction) = line.at(station_m);
                let projection = line.project(place + direction.perp() * offset_m, -100.0..100.0);
                assert!(
                    (projection.station_m - station_m).abs() < 1e-12
                        && (projection.offset_m - offset_m).abs() < 1e-12
                );
            }
        }
        // The range selects only the second piece.
        assert_eq!(
            line.project(DVec2::new(1.0, 1.0), 3.5..6.0),
            LineProjection { station_m: 4.0, offset_m: 2.0 }
        );
    }

    #[test]
    fn the_nearest_point_is_on_the_path_itself() {
        let line = corner();
        assert_eq!(line.nearest(DVec2::new(1.0, 2.0)), (1.0, 2.0));
        assert_eq!(line.nearest(DVec2::new(4.0, 2.0)), (5.0, 1.0));
        assert_eq!(line.nearest(DVec2::new(-3.0, 4.0)), (-3.0, 5.0));
        assert_eq!(line.nearest(DVec2::new(3.0, 6.0)), (9.0, 2.0));
    }

    #[test]
    fn parts_retain_corners_and_samples_are_even() {
        let line = corner();
        let points = |points: &[(f64, f64)]| points.iter().copied().map(DVec2::from).collect::<Vec<_>>();
        assert_eq!(line.part(1.0, 5.0), points(&[(1.0, 0.0), (3.0, 0.0), (3.0, 2.0)]));
        assert_eq!(line.part(-1.0, 3.0), points(&[(-1.0, 0.0), (0.0, 0.0), (3.0, 0.0)]));
        assert_eq!(line.resampled(4.0), points(&[(0.0, 0.0), (3.0, 0.5), (3.0, 4.0)]));
    }

    #[test]
    fn rejects_paths_without_length() {
        assert_eq!(Polyline::new([DVec2::ONE; 5]), None);
        assert_eq!(Polyline::new([DVec2::ONE]), None);
        assert_eq!(Polyline::new([DVec2::ZERO, DVec2::new(f64::NAN, 0.0)]), None);
        assert_eq!(Polyline::new([DVec2::ZERO, DVec2::MAX, -DVec2::MAX]), None);
    }

    #[test]
    fn angles_are_wrapped_by_full_turns() {
        use std::f64::consts::PI;
        for turns in -3..=3 {
            let angle = wrap_angle(0.25 + f64::from(turns) * 2.0 * PI);
            assert!((angle - 0.25).abs() < 1e-12);
        }
        assert_eq!((wrap_angle(PI), wrap_angle(-PI)), (PI, -PI));
    }
}
