//! Motion along a path with a speed at each point.
//!
//! Between two points the acceleration is constant: a piece of length `l` from speed `a` to `b` takes
//! `2 l / (a + b)`, and after `t` of it the actor is at `a t + (b - a) (a + b) t² / (4 l)`.

use glam::DVec2;

use crate::geometry::{Polyline, wrap_angle};

/// Path in the global frame with speeds.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Motion {
    line: Polyline,
    /// Headings at the points: the mean of both pieces', radians.
    yaws_rad: Vec<f64>,
    /// Speeds at the points, meters per second.
    speeds_mps: Vec<f64>,
    /// Times at the points, seconds after the start.
    times_s: Vec<f64>,
}

impl Motion {
    /// Creates the motion through points (global meters) with speeds (meters per second). `None` if
    /// consecutive points coincide, a number is not finite, a speed is negative, or two consecutive ones
    /// are 0.
    pub(super) fn new(points: &[(DVec2, f64)]) -> Option<Self> {
        let line = Polyline::new(points.iter().map(|(point, _)| *point))?;
        let speeds_mps: Vec<f64> = points.iter().map(|(_, speed)| *speed).collect();
        let is_sound = speeds_mps.iter().all(|speed| speed.is_finite() && *speed >= 0.0)
            && speeds_mps.windows(2).all(|ends| ends[0] + ends[1] > 0.0);
        if line.points().len() != points.len() || !is_sound {
            return None;
        }
        let mut times_s = vec![0.0];
        for (stations, speeds) in line.stations_m().windows(2).zip(speeds_mps.windows(2)) {
            let took_s = 2.0 * (stations[1] - stations[0]) / (speeds[0] + speeds[1]);
            times_s.push(times_s[times_s.len() - 1] + took_s);
        }
        let direction = |piece: usize| (line.points()[piece + 1] - line.points()[piece]).to_angle();
        let last = points.len() - 1;
        let yaw = |i: usize| match i {
            0 => direction(0),
            i if i == last => direction(last - 1),
            i => direction(i - 1) + wrap_angle(direction(i) - direction(i - 1)) / 2.0,
        };
        let yaws_rad = (0..points.len()).map(yaw).collect();
        times_s.iter().all(|time| time.is_finite()).then_some(Self { line, yaws_rad, speeds_mps, times_s })
    }

    /// Returns position (global meters) and heading (radians) after a time, seconds from the start, at
    /// least 0.
    pub(super) fn at(&self, t_s: f64) -> (DVec2, f64) {
        let last = self.times_s.len() - 1;
        let stations_m = self.line.stations_m();
        if t_s >= self.times_s[last] {
            let beyond_m = self.speeds_mps[last] * (t_s - self.times_s[last]);
            return (self.line.at(stations_m[last] + beyond_m).0, self.yaws_rad[last]);
        }
        let piece = self.times_s.partition_point(|time| *time <= t_s).clamp(1, last) - 1;
        let (since_s, length_m) = (t_s - self.times_s[piece], stations_m[piece + 1] - stations_m[piece]);
        let [from, to] = [self.speeds_mps[piece], self.speeds_mps[piece + 1]];
        let along_m = from * since_s + (to - from) * (to + from) * since_s * since_s / (4.0 * length_m);
        let along_m = along_m.clamp(0.0, length_m);
        let turn = wrap_angle(self.yaws_rad[piece + 1] - self.yaws_rad[piece]);
        let yaw_rad = self.yaws_rad[piece] + turn * along_m / length_m;
        (self.line.at(stations_m[piece] + along_m).0, yaw_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accelerations_between_points_are_constant() {
        // 0 to 10 m/s over 20 m: 4 s at 2.5 m/s². Then 10 m/s for 1 s, then on at 10 m/s.
        let points = [(0.0, 0.0), (20.0, 10.0), (30.0, 10.0)].map(|(x, v)| (DVec2::new(x, 1.0), v));
        let motion = Motion::new(&points).unwrap();
        for (t_s, x_m) in [(0.0, 0.0), (2.0, 5.0), (4.0, 20.0), (4.5, 25.0), (5.0, 30.0), (7.0, 50.0)] {
            let (place, yaw_rad) = motion.at(t_s);
            assert!(place.distance(DVec2::new(x_m, 1.0)) < 1e-12 && yaw_rad == 0.0, "{t_s}: {place}");
        }
    }

    #[test]
    fn a_stop_is_final_and_headings_turn_between_points() {
        let points = [(0.0, 0.0, 4.0), (4.0, 0.0, 4.0), (4.0, 4.0, 0.0)];
        let motion = Motion::new(&points.map(|(x, y, v)| (DVec2::new(x, y), v))).unwrap();
        let quarter = std::f64::consts::FRAC_PI_4;
        assert_eq!(motion.at(1.0), (DVec2::new(4.0, 0.0), quarter));
        assert_eq!(motion.at(0.5), (DVec2::new(2.0, 0.0), quarter / 2.0));
        let (place, yaw_rad) = motion.at(60.0);
        assert!(place.distance(DVec2::new(4.0, 4.0)) < 1e-12 && (yaw_rad - 2.0 * quarter).abs() < 1e-12);
    }

    #[test]
    fn impossible_motions_are_refused() {
        let motion = |points: &[(f64, f64)]| {
            Motion::new(&points.iter().map(|(x, v)| (DVec2::new(*x, 0.0), *v)).collect::<Vec<_>>())
        };
        for points in [
            &[(0.0, 1.0)][..],
            &[(0.0, 0.0), (5.0, 0.0)],
            &[(0.0, 1.0), (0.0, 1.0)],
            &[(0.0, 1.0), (5.0, -1.0)],
            &[(0.0, 1.0), (f64::NAN, 1.0)],
            &[(0.0, 1.0), (5.0, f64::INFINITY)],
        ] {
            assert!(motion(points).is_none(), "{points:?}");
        }
    }
}
