use glam::DVec2;

/// Lens distortion of Brown and Conrady, as OpenCV has it: three radial and two tangential coefficients, on coordinates
/// in the plane at depth 1.
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

impl Distortion {
    /// From OpenCV's order `k1 k2 p1 p2 k3`; `None` for all zeros, which distort nothing.
    pub fn from_opencv([k1, k2, p1, p2, k3]: [f64; 5]) -> Option<Self> {
        ([k1, k2, p1, p2, k3] != [0.0; 5]).then_some(Self { k1, k2, p1, p2, k3 })
    }

    /// OpenCV's order: `k1 k2 p1 p2 k3`.
    pub fn coefficients(&self) -> [f64; 5] {
        [self.k1, self.k2, self.p1, self.p2, self.k3]
    }

    /// Where the lens puts a point of the plane at depth 1. `None` beyond the radius at which the polynomial turns
    /// back: no ray from there reaches the image.
    pub fn distort(&self, ideal: DVec2) -> Option<DVec2> {
        let r2 = ideal.length_squared();
        // The derivative of r·(1 + k1 r² + k2 r⁴ + k3 r⁶).
        let grows = |r2: f64| 1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + r2 * 7.0 * self.k3)) > 0.0;
        const STEPS: u32 = 16;
        if !(1..=STEPS).all(|i| grows(r2 * f64::from(i) / f64::from(STEPS))) {
            return None;
        }
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let DVec2 { x, y } = ideal;
        let tangential = DVec2::new(
            2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        );
        Some(ideal * radial + tangential)
    }
}
