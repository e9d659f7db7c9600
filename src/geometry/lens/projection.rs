use glam::{DMat3, DVec2, DVec3};

use super::Lens;
use crate::geometry::Camera;

/// Mapping between rays of a camera and pixels of its recorded images, prepared for many. The size of the
/// image does not limit it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraProjection {
    image_from_plane: DMat3,
    plane_from_image: DMat3,
    lens: Option<Lens>,
}

impl CameraProjection {
    /// Prepares the projection of a camera.
    pub fn new(camera: &Camera) -> Self {
        let image_from_plane = camera.intrinsics;
        let lens = camera.lens.map(|lens| lens.prepared());
        Self { image_from_plane, plane_from_image: image_from_plane.inverse(), lens }
    }

    /// Returns the lens; `None` for a pinhole.
    pub fn lens(&self) -> Option<&Lens> {
        self.lens.as_ref()
    }

    /// Returns the pixel coordinates of a ray, of any length in the camera's frame; `None` if the lens does
    /// not show it. Pixel `(i, j)` covers `[i, i+1) × [j, j+1)`.
    pub fn pixel(&self, ray: DVec3) -> Option<DVec2> {
        let seen = match &self.lens {
            None => (ray.z > 0.0).then(|| ray.truncate() / ray.z)?,
            Some(lens) => lens.project(ray)?,
        };
        Some((self.image_from_plane * seen.extend(1.0)).truncate())
    }

    /// Returns the ray that pixel coordinates show: of any length, in the camera's frame; `None` if the lens
    /// shows nothing there.
    pub fn ray(&self, pixel: DVec2) -> Option<DVec3> {
        let seen = (self.plane_from_image * pixel.extend(1.0)).truncate();
        match &self.lens {
            None => Some(seen.extend(1.0)),
            Some(lens) => lens.unproject(seen),
        }
    }
}
