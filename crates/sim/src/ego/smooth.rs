use glam::DVec2;
use point_skeleton::geometry::Polyline;

/// Spacing of control points, meters: recorded poses have errors of a centimeter, which hardly affect a curve
/// at this spacing.
const SPACING_M: f64 = 5.0;

/// Smooth curve near a path: a uniform cubic B-spline with continuous curvature.
///
/// Control points are computed from positions on the path by quasi-interpolation, so that the curve stays
/// near the path in bends (order 4; de Boor and Fix 1973).
pub(super) struct Smooth {
    controls: Vec<DVec2>,
}

/// Position, tangent and curvature at a station.
pub(super) struct Place {
    pub(super) position_m: DVec2,
    /// Derivative by station; its length is 1 up to an error of fourth order.
    pub(super) tangent: DVec2,
    /// Curvature to the left, per meter.
    pub(super) curvature: f64,
}

impl Smooth {
    /// Fits a curve to a path from a station (meters) to its end, extended straight by `beyond_m`.
    pub(super) fn new(path: &Polyline, start_m: f64, beyond_m: f64) -> Self {
        let left_m = (path.length_m() - start_m).max(0.0) + beyond_m;
        let pieces = (left_m / SPACING_M).ceil().max(1.0) as i64;
        let place = |i: i64| path.at(start_m + i as f64 * SPACING_M).0;
        // Four controls determine the spline at a station; the first lies one spacing before the start.
        let control = |i: i64| (place(i) * 8.0 - place(i - 1) - place(i + 1)) / 6.0;
        Self { controls: (-1..=pieces + 1).map(control).collect() }
    }

    /// Returns the length, meters.
    pub(super) fn length_m(&self) -> f64 {
        (self.controls.len() - 3) as f64 * SPACING_M
    }

    /// Evaluates the curve at a station (meters) between 0 and its length.
    pub(super) fn at(&self, station_m: f64) -> Place {
        let u = (station_m / SPACING_M).max(0.0);
        let first = (u as usize).min(self.controls.len() - 4);
        let t = u - first as f64;
        let (r, c) = (1.0 - t, &self.controls[first..first + 4]);
        let blend = |w: [f64; 4]| c[0] * w[0] + c[1] * w[1] + c[2] * w[2] + c[3] * w[3];
        let values = [
            r * r * r,
            3.0 * t * t * t - 6.0 * t * t + 4.0,
            -3.0 * t * t * t + 3.0 * t * t + 3.0 * t + 1.0,
            t * t * t,
        ];
        let slopes = [-r * r, 3.0 * t * t - 4.0 * t, -3.0 * t * t + 2.0 * t + 1.0, t * t];
        let bends = [r, 3.0 * t - 2.0, 1.0 - 3.0 * t, t];
        let tangent = blend(slopes) / (2.0 * SPACING_M);
        let bend = blend(bends) / (SPACING_M * SPACING_M);
        let length = tangent.length();
        let curvature = if length > 1e-6 { tangent.perp_dot(bend) / length.powi(3) } else { 0.0 };
        Place { position_m: blend(values) / 6.0, tangent, curvature }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(radius_m: f64, noise_m: f64) -> Polyline {
        let point = |i: i32| {
            let angle = f64::from(i) / radius_m;
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            DVec2::from_angle(angle) * (radius_m + sign * noise_m)
        };
        Polyline::new((0..(3.5 * radius_m) as i32).map(point)).unwrap()
    }

    #[test]
    fn smoothing_keeps_circles() {
        for radius_m in [12.0, 40.0] {
            let smooth = Smooth::new(&circle(radius_m, 0.0), 0.0, 0.0);
            // Beyond both ends the path is straight, which affects the curve for some meters.
            let mut before = smooth.at(11.9);
            for i in 120..(smooth.length_m() - 15.0) as usize * 10 {
                let place = smooth.at(i as f64 * 0.1);
                assert!((place.position_m.length() - radius_m).abs() < 0.02, "{}", place.position_m.length());
                assert!((place.tangent.length() - 1.0).abs() < 0.02);
                assert!((place.curvature * radius_m - 1.0).abs() < 0.12, "{}", place.curvature);
                let distance_m = before.position_m.distance(place.position_m);
                assert!((distance_m - 0.1).abs() < 0.002);
                // Continuous: no jump where the set of controls changes.
                assert!((place.curvature - before.curvature).abs() < 0.01);
                before = place;
            }
        }
    }

    #[test]
    fn smoothing_suppresses_noise_and_keeps_lines() {
        let smooth = Smooth::new(&circle(40.0, 0.01), 0.0, 0.0);
        for i in 12..40 {
            assert!((smooth.at(f64::from(i)).curvature - 0.025).abs() < 0.01);
        }
        let line = Polyline::new([DVec2::new(5.0, 5.0), DVec2::new(5.0, 9.0)]).unwrap();
        let smooth = Smooth::new(&line, 1.0, 20.0);
        assert_eq!(smooth.length_m(), 25.0);
        let place = smooth.at(23.0);
        assert!((place.position_m - DVec2::new(5.0, 29.0)).length() < 1e-12);
        assert!((place.tangent - DVec2::Y).length() < 1e-12 && place.curvature.abs() < 1e-12);
    }
}
