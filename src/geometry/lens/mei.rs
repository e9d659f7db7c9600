//! Unified camera model of Mei and Rives, with radial distortion.

use glam::{DVec2, DVec3};

use super::growth::inverse;
use super::{Distortion, distortion::FARTHEST_R2};
use crate::geometry::CameraError;

/// Fisheye lens in the model of Mei: a ray meets the unit sphere, is projected from a point at distance `xi`
/// behind its center, and is distorted radially.
///
/// In units of the focal length near the axis: with `n` the unit vector of a ray and `m = (n.x, n.y) / (n.z +
/// xi)`, the ray appears at `(1 + xi) · m · (1 + k1 m² + k2 m⁴)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mei {
    xi: f64,
    k1: f64,
    k2: f64,
    /// Length of `m` up to which rays are shown.
    limit: f64,
}

impl Mei {
    /// Creates the model from the mirror parameter and two radial coefficients.
    ///
    /// # Errors
    /// Fails if a number is not finite or the mirror parameter is negative.
    pub fn new(xi: f64, [k1, k2]: [f64; 2]) -> Result<Self, CameraError> {
        if let Some(&value) = [xi, k1, k2].iter().find(|value| !value.is_finite()) {
            return Err(CameraError::NotFinite(value));
        }
        if xi < 0.0 {
            return Err(CameraError::MirrorParameter(xi));
        }
        // Where the polynomial stops growing, and where rays touch the sphere.
        let turning_r2 = Distortion { k1, k2, p1: 0.0, p2: 0.0, k3: 0.0 }.turning_r2();
        let touching_r2 = if xi > 1.0 { 1.0 / (xi * xi - 1.0) } else { f64::INFINITY };
        Ok(Self { xi, k1, k2, limit: turning_r2.min(touching_r2).min(FARTHEST_R2).sqrt() })
    }

    /// Mirror parameter.
    pub fn xi(&self) -> f64 {
        self.xi
    }

    /// Radial coefficients `k1 k2`.
    pub fn radial(&self) -> [f64; 2] {
        [self.k1, self.k2]
    }

    /// See [`Lens::project`](super::Lens::project).
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        let n = ray.try_normalize()?;
        // Beyond, a ray passes the point of projection, or the sphere hides its own back.
        if n.z <= -self.xi.min(1.0 / self.xi) {
            return None;
        }
        let m = n.truncate() / (n.z + self.xi);
        let length = m.length();
        (length <= self.limit).then(|| m * (1.0 + self.xi) * self.stretch(length * length))
    }

    /// See [`Lens::unproject`](super::Lens::unproject). The ray has length 1.
    pub fn unproject(&self, seen: DVec2) -> Option<DVec3> {
        let seen = seen / (1.0 + self.xi);
        let radius = seen.length();
        let length = inverse(radius, self.limit, |m| self.distorted(m))?;
        Some(self.ray(if radius > 0.0 { seen * (length / radius) } else { DVec2::ZERO }))
    }

    /// Returns the angle up to which rays are shown, radians.
    pub fn max_angle(&self) -> f64 {
        self.ray(DVec2::X * self.limit).angle_between(DVec3::Z)
    }

    fn stretch(&self, r2: f64) -> f64 {
        1.0 + r2 * (self.k1 + r2 * self.k2)
    }

    /// Returns the distorted length of `m`, and its slope.
    fn distorted(&self, m: f64) -> (f64, f64) {
        let r2 = m * m;
        (m * self.stretch(r2), 1.0 + r2 * (3.0 * self.k1 + r2 * 5.0 * self.k2))
    }

    /// Returns the unit vector that meets the sphere where the line from the point of projection through `m`
    /// leaves it.
    fn ray(&self, m: DVec2) -> DVec3 {
        let (xi, r2) = (self.xi, m.length_squared());
        let root = (1.0 + (1.0 - xi * xi) * r2).max(0.0).sqrt();
        let scale = (xi + root) / (1.0 + r2);
        (m * scale).extend(scale - xi)
    }
}
