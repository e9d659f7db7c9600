use glam::{DMat2, DVec2};

/// Brown–Conrady lens distortion in OpenCV's form: three radial and two tangential coefficients. It applies
/// to normalized coordinates, in the plane at depth 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// Radial, `r²`.
    pub k1: f64,
    /// Radial, `r⁴`.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, `r⁶`.
    pub k3: f64,
}

/// No image reaches beyond this squared radius: the angle from the axis exceeds 89.9 degrees.
pub(super) const FARTHEST_R2: f64 = 1e6;

impl Distortion {
    /// Creates the model from OpenCV's order `k1 k2 p1 p2 k3`; `None` if all are zero (no distortion).
    pub fn from_opencv([k1, k2, p1, p2, k3]: [f64; 5]) -> Option<Self> {
        ([k1, k2, p1, p2, k3] != [0.0; 5]).then_some(Self { k1, k2, p1, p2, k3 })
    }

    /// Returns `k1 k2 p1 p2 k3` of four or more coefficients in OpenCV's order; `None` unless they are finite
    /// and the rest is zero.
    #[cfg(any(feature = "nuscenes", feature = "nuplan"))]
    pub(crate) fn first_five(all: &[f64]) -> Option<[f64; 5]> {
        let mut five = [0.0; 5];
        let used = all.len().min(5);
        five[..used].copy_from_slice(&all[..used]);
        let fits = used >= 4 && five.iter().all(|v| v.is_finite()) && all[used..].iter().all(|v| *v == 0.0);
        fits.then_some(five)
    }

    /// Returns the coefficients in OpenCV's order: `k1 k2 p1 p2 k3`.
    pub fn coefficients(&self) -> [f64; 5] {
        [self.k1, self.k2, self.p1, self.p2, self.k3]
    }

    /// Returns the model with precomputed values, for distorting many points.
    pub fn lens(&self) -> BrownConradyLens {
        BrownConradyLens { distortion: *self, limit_r2: self.turning_r2() }
    }

    /// Distorts a point of the plane at depth 1; see [`BrownConradyLens::distort`].
    pub fn distort(&self, ideal: DVec2) -> Option<DVec2> {
        self.lens().distort(ideal)
    }

    /// Slope of `r·(1 + k1 r² + k2 r⁴ + k3 r⁶)` at `r²`.
    fn slope(&self, r2: f64) -> f64 {
        1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + r2 * 7.0 * self.k3))
    }

    /// Returns the smallest `r²` at which the slope is no longer positive; infinite if there is none.
    pub(super) fn turning_r2(&self) -> f64 {
        // Between two extrema, the slope has at most one zero.
        let (a, b, c) = (21.0 * self.k3, 10.0 * self.k2, 3.0 * self.k1);
        let root = (b * b - 4.0 * a * c).sqrt();
        let mut ends = [(-b - root) / (2.0 * a), (-b + root) / (2.0 * a), -c / b];
        ends.sort_by(f64::total_cmp);
        let mut start = 0.0;
        for end in ends.into_iter().filter(|r2| (0.0..FARTHEST_R2).contains(r2)).chain([FARTHEST_R2]) {
            if self.slope(end) <= 0.0 {
                return self.zero_of_slope(start, end);
            }
            start = end;
        }
        f64::INFINITY
    }

    /// Finds the zero by bisection; the slope is positive at `inside` and not positive at `outside`.
    fn zero_of_slope(&self, mut inside: f64, mut outside: f64) -> f64 {
        loop {
            let middle = f64::midpoint(inside, outside);
            if middle <= inside || middle >= outside {
                return inside;
            }
            if self.slope(middle) > 0.0 { inside = middle } else { outside = middle }
        }
    }
}

/// [`Distortion`] prepared for many points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrownConradyLens {
    distortion: Distortion,
    /// Squared radius beyond which the polynomial is no longer monotonic.
    limit_r2: f64,
}

impl BrownConradyLens {
    /// Distorts a point of the plane at depth 1, as OpenCV's `projectPoints`. Returns `None` beyond the
    /// radius at which the polynomial stops growing: no ray from there reaches the image.
    pub fn distort(&self, ideal: DVec2) -> Option<DVec2> {
        let r2 = ideal.length_squared();
        (r2 <= self.limit_r2).then(|| self.polynomial(ideal, r2))
    }

    fn polynomial(&self, ideal: DVec2, r2: f64) -> DVec2 {
        let Distortion { k1, k2, p1, p2, k3 } = self.distortion;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let DVec2 { x, y } = ideal;
        let tangential = DVec2::new(
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        ideal * radial + tangential
    }

    /// Jacobian of [`BrownConradyLens::polynomial`].
    fn jacobian(&self, ideal: DVec2) -> DMat2 {
        let Distortion { k1, k2, p1, p2, k3 } = self.distortion;
        let (DVec2 { x, y }, r2) = (ideal, ideal.length_squared());
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let growth = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let mixed = growth * x * y + 2.0 * (p1 * x + p2 * y);
        DMat2::from_cols(
            DVec2::new(radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x, mixed),
            DVec2::new(mixed, radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x),
        )
    }

    /// Inverts [`BrownConradyLens::distort`] to within 10⁻¹² focal lengths. Returns `None` if Newton's method
    /// finds no point that the lens maps to `seen`.
    pub fn undistort(&self, seen: DVec2) -> Option<DVec2> {
        const STEPS: u32 = 50;
        const CLOSE: f64 = 1e-12;
        let mut ideal = DVec2::ZERO;
        let mut error = self.distort(ideal)? - seen;
        for _ in 0..STEPS {
            if error.length() <= CLOSE {
                return Some(ideal);
            }
            (ideal, error) = self.newton_step(ideal, error, seen)?;
        }
        None
    }

    /// Takes a Newton step. Halves it until the point stays inside the lens and the error decreases.
    fn newton_step(&self, ideal: DVec2, error: DVec2, seen: DVec2) -> Option<(DVec2, DVec2)> {
        const HALVINGS: i32 = 30;
        let step = self.jacobian(ideal).inverse() * error;
        (0..HALVINGS).find_map(|halvings| {
            let next = ideal - step * 0.5_f64.powi(halvings);
            let next_error = self.distort(next)? - seen;
            (next_error.length_squared() < error.length_squared()).then_some((next, next_error))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(coefficients: [f64; 5]) -> BrownConradyLens {
        Distortion::from_opencv(coefficients).unwrap().lens()
    }

    #[test]
    fn the_valid_radius_ends_where_the_slope_is_zero() {
        // Zero of 1 + 3 k1 r².
        assert!((lens([-0.3, 0.0, 0.0, 0.0, 0.0]).limit_r2 - 1.0 / 0.9).abs() < 1e-12);
        // 1 - 2.5 r² + r⁴ = (1 - r²/2)(1 - 2 r²) has two zeros; the smaller one counts.
        assert!((lens([-2.5 / 3.0, 0.2, 0.0, 0.0, 0.0]).limit_r2 - 0.5).abs() < 1e-12);
        // (1 - r²)³ touches zero; (1 - r²/3)(1 + r⁴) has one zero, 1 + r⁶ + .. has none.
        let cubic = |c1: f64, c2: f64, c3: f64| lens([c1 / 3.0, c2 / 5.0, 0.0, 0.0, c3 / 7.0]).limit_r2;
        assert!((cubic(-3.0, 3.0, -1.0) - 1.0).abs() < 1e-4);
        assert!((cubic(-1.0 / 3.0, 1.0, -1.0 / 3.0) - 3.0).abs() < 1e-9);
        assert_eq!(cubic(0.1, 0.0, 1.0), f64::INFINITY);
        assert_eq!(lens([0.0, 0.0, 0.01, 0.0, 0.0]).limit_r2, f64::INFINITY);
    }

    #[test]
    fn points_beyond_the_valid_radius_are_rejected() {
        let lens = lens([-0.3, 0.0, 0.0, 0.0, 0.0]);
        let limit = (1.0_f64 / 0.9).sqrt();
        assert!(lens.distort(DVec2::X * (limit - 1e-9)).is_some());
        assert_eq!([DVec2::X * (limit + 1e-9), DVec2::splat(30.0)].map(|p| lens.distort(p)), [None; 2]);
        // Maximum radius in the image, r (1 - 0.3 r²), and beyond.
        let reach = limit * (1.0 - 0.3 * limit * limit);
        assert!(lens.undistort(DVec2::X * (reach - 1e-6)).is_some());
        assert_eq!([reach + 1e-6, 5.0, f64::NAN].map(|r| lens.undistort(DVec2::X * r)), [None; 3]);
    }

    #[test]
    fn undistorting_undoes_distortion() {
        for coefficients in [
            [-0.356123, 0.172545, -0.00213, 0.000464, -0.05231],
            [-0.28, 0.071, 0.0011, -0.0007, -0.0079],
            [0.18, -0.05, -0.004, 0.006, 0.012],
        ] {
            let lens = lens(coefficients);
            for i in 0..400 {
                let ideal = DVec2::from_angle(f64::from(i)) * (f64::from(i) / 400.0);
                let seen = lens.distort(ideal).unwrap();
                let back = lens.undistort(seen).unwrap();
                assert!((back - ideal).length() < 1e-10, "{ideal} {back}");
                assert!((lens.distort(back).unwrap() - seen).length() <= 1e-12);
            }
        }
    }
}
