//! Lenses of recorded images: where in an image a ray appears, and which ray a place in an image shows.
//!
//! A lens maps rays of a camera to the plane at depth 1, in units of the focal length near the axis. The
//! camera's intrinsics map that plane to pixels. Near the axis every lens is the pinhole of the same
//! intrinsics.

mod distortion;
mod f_theta;
mod growth;
mod mei;
mod projection;
#[cfg(test)]
mod tests;

pub use distortion::{BrownConradyLens, Distortion};
pub use f_theta::FTheta;
pub use mei::Mei;
pub use projection::CameraProjection;

use glam::{DVec2, DVec3};

/// Lens of recorded images, other than that of a pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LensModel {
    /// Brown–Conrady distortion, as in OpenCV.
    BrownConrady(Distortion),
    /// Unified camera model of Mei, for fisheye lenses.
    Mei(Mei),
    /// Radius in pixels as a polynomial of the angle to the axis, for wide lenses.
    FTheta(FTheta),
}

/// [`LensModel`] prepared for many rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// See [`LensModel::BrownConrady`].
    BrownConrady(BrownConradyLens),
    /// See [`LensModel::Mei`].
    Mei(Mei),
    /// See [`LensModel::FTheta`].
    FTheta(FTheta),
}

impl LensModel {
    /// Creates a Brown–Conrady lens from OpenCV's order `k1 k2 p1 p2 k3`; `None` if all are zero (a pinhole).
    pub fn from_opencv(coefficients: [f64; 5]) -> Option<Self> {
        Distortion::from_opencv(coefficients).map(Self::BrownConrady)
    }

    /// Returns the Brown–Conrady coefficients; `None` for other models.
    pub fn distortion(&self) -> Option<Distortion> {
        match self {
            Self::BrownConrady(distortion) => Some(*distortion),
            Self::Mei(_) | Self::FTheta(_) => None,
        }
    }

    /// Returns the name of the model for messages.
    pub fn name(&self) -> &'static str {
        match self {
            Self::BrownConrady(_) => "Brown-Conrady",
            Self::Mei(_) => "MEI",
            Self::FTheta(_) => "f-theta",
        }
    }

    /// Returns the lens with precomputed values, for many rays.
    pub fn prepared(&self) -> Lens {
        match self {
            Self::BrownConrady(distortion) => Lens::BrownConrady(distortion.lens()),
            Self::Mei(mei) => Lens::Mei(*mei),
            Self::FTheta(f_theta) => Lens::FTheta(*f_theta),
        }
    }
}

impl From<Distortion> for LensModel {
    fn from(distortion: Distortion) -> Self {
        Self::BrownConrady(distortion)
    }
}

impl Lens {
    /// Returns where the plane at depth 1 shows a ray of any length in the camera's frame; `None` if the lens
    /// does not show it. Only MEI and f-theta show rays at 90 degrees or more from the axis.
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        match self {
            Self::BrownConrady(lens) => (ray.z > 0.0).then(|| lens.distort(ray.truncate() / ray.z))?,
            Self::Mei(mei) => mei.project(ray),
            Self::FTheta(f_theta) => f_theta.project(ray),
        }
    }

    /// Returns the ray that a place of the plane at depth 1 shows: of any length, in the camera's frame;
    /// `None` if no ray reaches it.
    pub fn unproject(&self, seen: DVec2) -> Option<DVec3> {
        match self {
            Self::BrownConrady(lens) => lens.undistort(seen).map(|ideal| ideal.extend(1.0)),
            Self::Mei(mei) => mei.unproject(seen),
            Self::FTheta(f_theta) => f_theta.unproject(seen),
        }
    }

    /// Returns whether the lens may show rays at 90 degrees or more from the axis. The depth along the axis
    /// says nothing of their distance.
    pub fn is_wide(&self) -> bool {
        !matches!(self, Self::BrownConrady(_))
    }

    /// Returns an upper bound of the angle between the axis and a ray that the lens shows, radians.
    pub fn max_angle(&self) -> f64 {
        match self {
            Self::BrownConrady(_) => std::f64::consts::FRAC_PI_2,
            Self::Mei(mei) => mei.max_angle(),
            Self::FTheta(f_theta) => f_theta.max_angle(),
        }
    }
}
