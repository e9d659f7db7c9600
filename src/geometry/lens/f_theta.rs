//! Lenses whose image radius is a polynomial of the angle to the axis.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::growth::{inverse, positive_until};
use crate::geometry::CameraError;

/// Lens in the f-theta model: a ray at an angle `t` (radians) to the axis appears at the radius `c0 + c1 t +
/// .. + c5 t⁵` from the principal point.
///
/// Rays are shown up to the angle at which the radius stops growing, and at most 180 degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FTheta {
    /// Coefficients in units of the focal length near the axis: the second is 1.
    polynomial: [f64; 6],
    /// Coefficients of the slope.
    slope: [f64; 5],
    /// Angle up to which rays are shown, radians.
    limit: f64,
}

impl FTheta {
    /// Maximum radius of rays along the axis, pixels. Calibrations state 0, or what a fit left.
    pub const MAX_CONSTANT_PX: f64 = 1.0;

    /// Creates the model from the forward polynomial: radius in pixels, from the constant coefficient.
    ///
    /// # Errors
    /// Fails if a number is not finite, the constant is above [`FTheta::MAX_CONSTANT_PX`] in amount, or the
    /// radius does not grow at the axis.
    pub fn new(forward_px: [f64; 6]) -> Result<Self, CameraError> {
        if let Some(&value) = forward_px.iter().find(|value| !value.is_finite()) {
            return Err(CameraError::NotFinite(value));
        }
        let [constant_px, focal_px, ..] = forward_px;
        if focal_px <= 0.0 || constant_px.abs() > Self::MAX_CONSTANT_PX {
            return Err(CameraError::FTheta { constant_px, focal_px, max: Self::MAX_CONSTANT_PX });
        }
        let polynomial = forward_px.map(|c| c / focal_px);
        let slope = [1, 2, 3, 4, 5].map(|power: usize| power as f64 * polynomial[power]);
        Ok(Self { polynomial, slope, limit: positive_until(&slope, PI) })
    }

    /// Coefficients in units of the focal length near the axis, from the constant; the second is 1.
    pub fn polynomial(&self) -> [f64; 6] {
        self.polynomial
    }

    /// See [`Lens::project`](super::Lens::project).
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        let across = ray.truncate();
        let distance = across.length();
        let angle = distance.atan2(ray.z);
        let shown = angle <= self.limit && ray.is_finite() && ray != DVec3::ZERO;
        // A ray along the axis has no direction in the image; with a constant it takes that of atan2(0, 0).
        let direction = if distance > 0.0 { across / distance } else { DVec2::X };
        shown.then(|| direction * self.radius(angle).0)
    }

    /// See [`Lens::unproject`](super::Lens::unproject). The ray has length 1.
    pub fn unproject(&self, seen: DVec2) -> Option<DVec3> {
        let radius = seen.length();
        // A positive constant leaves a disk around the axis that no other ray reaches. With a negative one,
        // rays next to the axis appear on its other side, among those of that side, which are returned.
        let angle = inverse(radius.max(self.polynomial[0]), self.limit, |angle| self.radius(angle))?;
        let direction = if radius > 0.0 { seen / radius } else { DVec2::ZERO };
        Some((direction * angle.sin()).extend(angle.cos()))
    }

    /// Returns the angle up to which rays are shown, radians.
    pub fn max_angle(&self) -> f64 {
        self.limit
    }

    /// Returns the radius at an angle, and its slope.
    fn radius(&self, angle: f64) -> (f64, f64) {
        let value = |coefficients: &[f64]| super::growth::value(coefficients, angle);
        (value(&self.polynomial), value(&self.slope))
    }
}
