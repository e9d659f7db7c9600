//! Paths with yaws, as PDM-Closed interpolates them.

use glam::DVec2;
use point_skeleton::geometry::{Polyline, wrap_angle};

/// Minimum station of an interpolation, meters.
const MIN_STATION_M: f64 = 1e-5;

/// Path through points with a yaw at each.
#[derive(Clone, Debug)]
pub(super) struct Path {
    points: Vec<DVec2>,
    /// Yaws without jumps, radians.
    headings_rad: Vec<f64>,
    stations_m: Vec<f64>,
    line: Polyline,
}

impl Path {
    /// Joins lines; each point has the direction to the next point of its line, and the last one that of the
    /// point before. `None` if there are not two different points.
    pub(super) fn through<'a>(lines: impl IntoIterator<Item = &'a [DVec2]>) -> Option<Self> {
        let (mut points, mut headings_rad) = (Vec::new(), Vec::new());
        for line in lines.into_iter().filter(|line| line.len() > 1) {
            let directions = line.windows(2).map(|pair| (pair[1] - pair[0]).to_angle());
            headings_rad.extend(directions);
            headings_rad.extend(headings_rad.last().copied());
            points.extend_from_slice(line);
        }
        Self::new(points, headings_rad)
    }

    fn new(points: Vec<DVec2>, mut headings_rad: Vec<f64>) -> Option<Self> {
        for index in 1..headings_rad.len() {
            let before = headings_rad[index - 1];
            headings_rad[index] = before + wrap_angle(headings_rad[index] - before);
        }
        let mut station_m = 0.0;
        let step = |index: usize| {
            if index > 0 {
                station_m += points[index].distance(points[index - 1]);
            }
            station_m
        };
        let stations_m = (0..points.len()).map(step).collect();
        let line = Polyline::new(points.iter().copied())?;
        Some(Self { points, headings_rad, stations_m, line })
    }

    /// Returns the path at a distance to the left, meters.
    pub(super) fn beside(&self, left_m: f64) -> Option<Self> {
        let shifted = |(point, heading): (&DVec2, &f64)| *point + left_m * DVec2::from_angle(*heading).perp();
        let points = self.points.iter().zip(&self.headings_rad).map(shifted).collect();
        Self::new(points, self.headings_rad.clone())
    }

    /// Returns the length, meters.
    pub(super) fn length_m(&self) -> f64 {
        self.stations_m.last().copied().unwrap_or_default()
    }

    /// Returns position and yaw (radians) at a station, meters.
    pub(super) fn at(&self, station_m: f64) -> (DVec2, f64) {
        let station_m = station_m.clamp(MIN_STATION_M, self.length_m().max(MIN_STATION_M));
        let last = self.points.len() - 1;
        let next = self.stations_m.partition_point(|s| *s < station_m).clamp(1, last);
        let (from_m, to_m) = (self.stations_m[next - 1], self.stations_m[next]);
        let s = if to_m > from_m { (station_m - from_m) / (to_m - from_m) } else { 0.0 };
        let point = self.points[next - 1].lerp(self.points[next], s);
        let heading =
            self.headings_rad[next - 1] + s * (self.headings_rad[next] - self.headings_rad[next - 1]);
        (point, wrap_angle(heading))
    }

    /// Returns the station of the nearest point, meters from 0 to the length.
    pub(super) fn station_m(&self, point: DVec2) -> f64 {
        self.line.nearest(point).0.clamp(0.0, self.length_m())
    }

    /// Returns the distance of a point, meters.
    pub(super) fn distance_m(&self, point: DVec2) -> f64 {
        self.line.nearest(point).1
    }

    /// Returns the points between two stations (meters), or the exact part if there are fewer than two.
    pub(super) fn part(&self, from_m: f64, to_m: f64) -> Vec<DVec2> {
        let (from_m, to_m) = (from_m.clamp(0.0, self.length_m()), to_m.clamp(0.0, self.length_m()));
        let range = from_m..=to_m;
        let inside =
            self.points.iter().zip(&self.stations_m).filter(|(_, station_m)| range.contains(station_m));
        let points: Vec<DVec2> = inside.map(|(point, _)| *point).collect();
        if points.len() > 1 { points } else { self.line.part(from_m, to_m) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn yaws_are_those_of_each_line() {
        let first = [DVec2::ZERO, DVec2::new(4.0, 0.0)];
        let second = [DVec2::new(4.0, 0.0), DVec2::new(4.0, 2.0), DVec2::new(2.0, 2.0)];
        let path = Path::through([&first[..], &second[..]]).unwrap();
        assert_eq!(path.length_m(), 8.0);
        assert_eq!(path.at(2.0), (DVec2::new(2.0, 0.0), 0.0));
        assert_eq!(path.at(4.0).1, 0.0);
        let (point, heading) = path.at(5.0);
        assert!((point - DVec2::new(4.0, 1.0)).length() < 1e-12 && (heading - 1.5 * FRAC_PI_2).abs() < 1e-12);
        assert_eq!(path.station_m(DVec2::new(1.0, -7.0)), 1.0);
        assert_eq!([path.station_m(DVec2::new(-3.0, 0.0)), path.station_m(DVec2::new(0.0, 4.0))], [0.0, 8.0]);
        assert_eq!(path.distance_m(DVec2::new(-3.0, 4.0)), 5.0);
        assert_eq!(path.part(-1.0, 4.5), [DVec2::ZERO, DVec2::new(4.0, 0.0), DVec2::new(4.0, 0.0)]);
        assert_eq!(path.part(1.0, 2.0), [DVec2::X, DVec2::new(2.0, 0.0)]);
        let beside = path.beside(1.0).unwrap();
        assert_eq!(beside.at(1.0).0, DVec2::new(1.0, 1.0));
        assert!(Path::through([&first[..1]]).is_none());
    }
}
