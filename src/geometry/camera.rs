use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::{CameraProjection, FTheta, LensModel, Mei};
use crate::files::{FileName, NameError};

/// Camera model: image size, intrinsics, and lens of recorded images.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Channel name, for instance `CAM_FRONT`; maps of the camera are written into a folder of this name.
    pub name: FileName,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// 3×3 matrix `image_from_camera` in pixels, last row `0 0 1`; pixel `(i, j)` covers `[i, i+1) × [j,
    /// j+1)`. With a lens, it is the matrix of the pinhole that agrees with the lens near the axis.
    pub intrinsics: DMat3,
    /// Lens of recorded images; `None` for a pinhole. Maps are rendered with the pinhole model.
    pub lens: Option<LensModel>,
}

/// Camera at a pose: the target of a rasterizer.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Size and intrinsics.
    pub camera: Camera,
    /// Transforms world (global or scene) coordinates to camera coordinates, meters.
    pub camera_from_world: DAffine3,
}

/// Reason why a camera is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// Invalid name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A side is zero or above the limit.
    #[error("expected a size of 1 to {max} pixels, found {height}x{width}")]
    Size {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// [`Camera::MAX_SIDE`].
        max: u32,
    },
    /// An intrinsic is NaN or infinite.
    #[error("expected finite intrinsics, found {0}")]
    NotFinite(f64),
    /// The last row is not `0 0 1`.
    #[error("expected intrinsics with last row 0 0 1, found {0:?}")]
    LastRow([f64; 3]),
    /// The determinant is zero, or a focal length is not positive or above [`Camera::MAX_FOCAL`].
    #[error(
        "expected invertible intrinsics with focal lengths above 0 and up to 1e9 pixels, found fx {fx:?}, fy \
            {fy:?}, determinant {determinant:?}"
    )]
    Singular {
        /// Pixels.
        fx: f64,
        /// Pixels.
        fy: f64,
        /// Square pixels.
        determinant: f64,
    },
    /// The mirror parameter of a MEI lens is negative.
    #[error("expected a mirror parameter of 0 or more, found {0:?}")]
    MirrorParameter(f64),
    /// The forward polynomial of an f-theta lens does not grow from about 0 at the axis.
    #[error(
        "expected an f-theta polynomial that begins with up to {max} pixels and grows, found the \
            coefficients {constant_px:?} and {focal_px:?}"
    )]
    FTheta {
        /// Pixels.
        constant_px: f64,
        /// Pixels per radian.
        focal_px: f64,
        /// [`FTheta::MAX_CONSTANT_PX`].
        max: f64,
    },
}

impl Camera {
    /// Maximum width and height in pixels. Every Vulkan driver that supports 16 Ki images can render it.
    pub const MAX_SIDE: u32 = 16_384;

    /// Maximum focal length in pixels, far beyond every lens.
    pub const MAX_FOCAL: f64 = 1e9;

    /// Creates a camera after validating its name and numbers. `rows` is the 3×3 intrinsic matrix in
    /// row-major order.
    ///
    /// # Errors
    /// Returns a [`CameraError`] if the name or a number is invalid.
    pub fn new(
        name: impl AsRef<str>,
        width: u32,
        height: u32,
        rows: [[f64; 3]; 3],
    ) -> Result<Self, CameraError> {
        let name = FileName::new(name.as_ref())?;
        if !(1..=Self::MAX_SIDE).contains(&width) || !(1..=Self::MAX_SIDE).contains(&height) {
            return Err(CameraError::Size { width, height, max: Self::MAX_SIDE });
        }
        if let Some(&value) = rows.iter().flatten().find(|v| !v.is_finite()) {
            return Err(CameraError::NotFinite(value));
        }
        if rows[2] != [0.0, 0.0, 1.0] {
            return Err(CameraError::LastRow(rows[2]));
        }
        let (fx, fy) = (rows[0][0], rows[1][1]);
        let intrinsics = DMat3::from_cols_array_2d(&rows).transpose();
        let determinant = intrinsics.determinant();
        let is_focal = |focal: f64| focal > 0.0 && focal <= Self::MAX_FOCAL;
        if !(is_focal(fx) && is_focal(fy) && determinant.is_finite() && determinant.abs() > 1e-9) {
            return Err(CameraError::Singular { fx, fy, determinant });
        }
        Ok(Self { name, width, height, intrinsics, lens: None })
    }

    /// Creates a fisheye camera in the model of [`Mei`] from the calibration's numbers: mirror parameter,
    /// distortion `k1 k2 p1 p2` (`p1` and `p2` are not used), and projection `gamma1 gamma2 u0 v0` in pixels.
    ///
    /// # Errors
    /// Returns a [`CameraError`] if the name or a number is invalid.
    pub fn fisheye_mei(
        name: impl AsRef<str>,
        width: u32,
        height: u32,
        xi: f64,
        distortion: [f64; 4],
        [gamma1, gamma2, u0, v0]: [f64; 4],
    ) -> Result<Self, CameraError> {
        let [k1, k2, p1, p2] = distortion;
        if let Some(&value) = [p1, p2].iter().find(|value| !value.is_finite()) {
            return Err(CameraError::NotFinite(value));
        }
        let lens = Mei::new(xi, [k1, k2])?;
        let [fx, fy] = [gamma1, gamma2].map(|gamma| gamma / (1.0 + xi));
        let rows = [[fx, 0.0, u0], [0.0, fy, v0], [0.0, 0.0, 1.0]];
        Ok(Self { lens: Some(LensModel::Mei(lens)), ..Self::new(name, width, height, rows)? })
    }

    /// Creates a camera in the model of [`FTheta`] from the calibration's numbers, in pixels: principal point
    /// `cx cy`, 6 coefficients of the forward polynomial (radius by angle), 6 of the backward one (not used).
    ///
    /// # Errors
    /// Returns a [`CameraError`] if the name or a number is invalid.
    pub fn f_theta(
        name: impl AsRef<str>,
        width: u32,
        height: u32,
        calibration: [f64; 14],
    ) -> Result<Self, CameraError> {
        let [cx, cy, c0, c1, c2, c3, c4, c5, backward @ ..] = calibration;
        if let Some(&value) = backward.iter().find(|value| !value.is_finite()) {
            return Err(CameraError::NotFinite(value));
        }
        let lens = FTheta::new([c0, c1, c2, c3, c4, c5])?;
        let rows = [[c1, 0.0, cx], [0.0, c1, cy], [0.0, 0.0, 1.0]];
        Ok(Self { lens: Some(LensModel::FTheta(lens)), ..Self::new(name, width, height, rows)? })
    }

    /// Returns the mapping between rays and pixels of recorded images, prepared for many.
    pub fn projection(&self) -> CameraProjection {
        CameraProjection::new(self)
    }

    /// Returns the intrinsics in row-major order.
    pub fn rows(&self) -> [[f64; 3]; 3] {
        self.intrinsics.transpose().to_cols_array_2d()
    }

    /// Returns the same camera with another image size. The intrinsics scale by the ratio of the sizes.
    pub fn resized(&self, height: u32, width: u32) -> Self {
        let scale = DVec3::new(
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
            1.0,
        );
        Self {
            name: self.name.clone(),
            width,
            height,
            intrinsics: DMat3::from_diagonal(scale) * self.intrinsics,
            lens: self.lens,
        }
    }
}

impl View {
    /// Returns the row-major 3×4 matrix that maps local homogeneous coordinates to `(x·z, y·z, z)` in pixels
    /// and meters. The product is computed in `f64` and rounded to `f32` once. The third component is the
    /// camera depth.
    pub fn image_from_local(&self, world_from_local: &DAffine3) -> [[f32; 4]; 3] {
        let camera_from_local = self.camera_from_world * *world_from_local;
        let linear = self.camera.intrinsics * camera_from_local.matrix3;
        let offset = self.camera.intrinsics * camera_from_local.translation;
        let rows = linear.transpose().to_cols_array_2d();
        let offset = offset.to_array();
        std::array::from_fn(|r| [rows[r][0] as f32, rows[r][1] as f32, rows[r][2] as f32, offset[r] as f32])
    }

    /// Projects a world point in `f64`. Returns pixel coordinates and camera depth in meters; `None` for a
    /// depth of at most 10⁻⁵ m.
    pub fn project(&self, world: DVec3) -> Option<(DVec2, f64)> {
        let q = self.camera.intrinsics * self.camera_from_world.transform_point3(world);
        (q.z > 1e-5).then(|| (DVec2::new(q.x, q.y) / q.z, q.z))
    }

    /// Projects a world point into recorded images, by the camera's lens. Returns pixel coordinates and
    /// camera depth in meters. Returns `None` where the lens does not show the point, and for a depth of at
    /// most 10⁻⁵ m unless the lens is wide.
    pub fn project_recorded(&self, world: DVec3) -> Option<(DVec2, f64)> {
        let Some(lens) = self.camera.lens else { return self.project(world) };
        let p = self.camera_from_world.transform_point3(world);
        let lens = lens.prepared();
        if p.z <= 1e-5 && !lens.is_wide() {
            return None;
        }
        let seen = lens.project(p)?;
        Some(((self.camera.intrinsics * seen.extend(1.0)).truncate(), p.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: [[f64; 3]; 3] = [[1000.0, 0.0, 800.0], [0.0, 1100.0, 450.0], [0.0, 0.0, 1.0]];

    #[test]
    fn bad_intrinsics_are_named() {
        let camera = |rows| Camera::new("c", 1600, 900, rows);
        let mut singular = K;
        singular[1] = [0.0, 0.0, 450.0];
        assert!(matches!(camera(singular), Err(CameraError::Singular { .. })));
        for focal in [1e308, -1e308] {
            let mut endless = K;
            endless[0][0] = focal;
            let message = camera(endless).unwrap_err().to_string();
            assert!(message.contains(&format!("found fx {focal:?}, fy 1100.0, ")), "{message}");
        }
        let mut row = K;
        row[2] = [0.0, 0.0, 2.0];
        assert!(matches!(camera(row), Err(CameraError::LastRow(_))));
        let mut nan = K;
        nan[0][2] = f64::NAN;
        assert!(matches!(camera(nan), Err(CameraError::NotFinite(_))));
        assert!(matches!(Camera::new("c", 0, 900, K), Err(CameraError::Size { .. })));
    }

    #[test]
    fn resizing_scales_the_projection() {
        let camera = Camera::new("c", 1600, 900, K).unwrap();
        let point = DVec3::new(0.5, -0.25, 4.0);
        let at =
            |camera: Camera| View { camera, camera_from_world: DAffine3::IDENTITY }.project(point).unwrap().0;
        let (full, half) = (at(camera.clone()), at(camera.resized(450, 800)));
        assert!((full / 2.0 - half).length() < 1e-9);
    }

    #[test]
    fn f32_matrix_projects_as_f64() {
        let camera = Camera::new("c", 1600, 900, K).unwrap();
        let origin = DAffine3::from_translation(DVec3::new(664_430.0, 3_997_650.0, 606.0));
        let view = View { camera, camera_from_world: origin.inverse() };
        let m = view.image_from_local(&origin);
        let p = DVec3::new(0.5, -0.25, 4.0);
        let q = m.map(|r| r[0] * 0.5 + r[1] * -0.25 + r[2] * 4.0 + r[3]);
        let (pixel, z) = view.project(origin.transform_point3(p)).unwrap();
        assert!((f64::from(q[0] / q[2]) - pixel.x).abs() < 1e-3 && (f64::from(q[2]) - z).abs() < 1e-6);
    }
}
