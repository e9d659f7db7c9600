//! Camera models of py123d.

use std::path::Path;

use super::metadata::CameraMetadata;
use crate::dataset::recording::notes::{Notes, note};
use crate::dataset::{DatasetError, ImageDistortion};
use crate::error::FileError;
use crate::geometry::{Camera, CameraError, LensModel};

/// Returns the camera of a table; `None` if its model or its intrinsics are not known, which is counted.
///
/// # Errors
/// Fails if a number is invalid, or their count is wrong.
pub(super) fn camera(
    name: &str,
    about: &CameraMetadata,
    option: ImageDistortion,
    path: &Path,
    notes: &mut Notes,
) -> Result<Option<Camera>, DatasetError> {
    let camera = match about.camera_model.as_str() {
        "pinhole" => pinhole(name, about, option, path)?,
        "fisheye_mei" => fisheye(name, about, path)?,
        "ftheta" => f_theta(name, about, path)?,
        _ => None,
    };
    if camera.is_none() {
        let model = &about.camera_model;
        note(notes, &format!("cameras without intrinsics, or of the unknown model {model} (left out)"), 1);
    }
    camera.transpose().map_err(|source| wrong(source, name, path))
}

type Found = Option<Result<Camera, CameraError>>;

fn wrong(source: CameraError, name: &str, path: &Path) -> DatasetError {
    DatasetError::Camera { source, record: format!("the metadata of {name}"), path: path.to_owned() }
}

fn pinhole(
    name: &str,
    about: &CameraMetadata,
    option: ImageDistortion,
    path: &Path,
) -> Result<Found, FileError> {
    let Some(intrinsics) = &about.intrinsics else { return Ok(None) };
    let [fx, fy, cx, cy, skew] = numbers(intrinsics, "intrinsics fx fy cx cy skew", path)?;
    let rows = [[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
    let is_applied = match option {
        // Rectified images keep the coefficients of the lens before.
        ImageDistortion::Usual => !about.is_undistorted,
        ImageDistortion::Apply => true,
        ImageDistortion::Ignore => false,
    };
    let coefficients = match about.distortion.as_deref().filter(|_| is_applied) {
        Some(given) => numbers(given, "finite distortion k1 k2 p1 p2 k3", path)?,
        None => [0.0; 5],
    };
    let camera = Camera::new(name, about.width, about.height, rows);
    Ok(Some(camera.map(|camera| Camera { lens: LensModel::from_opencv(coefficients), ..camera })))
}

fn fisheye(name: &str, about: &CameraMetadata, path: &Path) -> Result<Found, FileError> {
    let (Some(xi), Some(projection)) = (about.mirror_parameter, &about.projection) else { return Ok(None) };
    let distortion =
        numbers(about.distortion.as_deref().unwrap_or(&[0.0; 4]), "finite distortion k1 k2 p1 p2", path)?;
    let projection = numbers(projection, "a finite projection gamma1 gamma2 u0 v0", path)?;
    Ok(Some(Camera::fisheye_mei(name, about.width, about.height, xi, distortion, projection)))
}

fn f_theta(name: &str, about: &CameraMetadata, path: &Path) -> Result<Found, FileError> {
    let Some(intrinsics) = &about.intrinsics else { return Ok(None) };
    let intrinsics = numbers(intrinsics, "finite intrinsics: cx cy, 6 forward, 6 backward", path)?;
    Ok(Some(Camera::f_theta(name, about.width, about.height, intrinsics)))
}

/// Returns `N` finite numbers.
fn numbers<const N: usize>(given: &[f64], expected: &str, path: &Path) -> Result<[f64; N], FileError> {
    let found = <[f64; N]>::try_from(given).ok().filter(|numbers| numbers.iter().all(|n| n.is_finite()));
    found.ok_or_else(|| FileError::content(expected, format!("{given:?}"), path))
}
