//! `C.json`: `{"cameras": [{"name", "width", "height", "intrinsics": 3x3, "camera_from_world": 4x4}]}`,
//! row-major.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DMat4};
use serde::{Deserialize, Serialize};

use crate::error::FileError;
use crate::files::text::{printable, printable_path};
use crate::files::{first_twice, json};
use crate::geometry::{Camera, CameraError, MAX_COORDINATE_M, View, is_position};

/// Tolerance of `R·Rᵀ` around the identity: files round to 4 or more digits.
const RIGID_TOLERANCE: f64 = 1e-3;

/// Error of a camera list.
#[derive(Debug, thiserror::Error)]
pub enum CamerasError {
    /// The file cannot be read or its JSON is invalid.
    #[error(transparent)]
    File(#[from] FileError),
    /// Invalid name, size or intrinsics.
    #[error("{source} in camera {}: {}", printable(camera), printable_path(path))]
    Camera {
        /// Reason.
        source: CameraError,
        /// Name of the camera.
        camera: String,
        /// The file.
        path: PathBuf,
    },
    /// Invalid `camera_from_world`.
    #[error(
        "expected {expected}, found {} in camera {}: {}",
        printable(found),
        printable(camera),
        printable_path(path)
    )]
    Value {
        /// Value required by the format.
        expected: String,
        /// Value found in the file.
        found: String,
        /// Name of the camera.
        camera: String,
        /// The file.
        path: PathBuf,
    },
}

/// JSON layout of the file.
#[derive(Debug, Serialize, Deserialize)]
struct RawCameras {
    cameras: Vec<RawCamera>,
}

#[derive(Debug, Serialize, Deserialize)]
struct RawCamera {
    name: String,
    width: u32,
    height: u32,
    intrinsics: [[f64; 3]; 3],
    camera_from_world: [[f64; 4]; 4],
}

/// Reads a list of at least one camera.
///
/// # Errors
/// Fails if the file is missing, its JSON has another layout, or the list is empty. Fails if a name is not a
/// valid `FileName` or repeats another (ignoring case), a size or intrinsics are invalid, or a pose is not
/// rigid.
pub fn read(path: &Path) -> Result<Vec<View>, CamerasError> {
    let expected =
        r#"{"cameras": [{"name", "width", "height", "intrinsics": 3x3, "camera_from_world": 4x4}]}"#;
    let raw: RawCameras = json::read(path, expected)?;
    if raw.cameras.is_empty() {
        return Err(FileError::content("at least one camera", "an empty list", path).into());
    }
    let views: Vec<View> =
        raw.cameras.into_iter().map(|camera| view(camera, path)).collect::<Result<_, _>>()?;
    match first_twice(views.iter().map(|view| &view.camera.name)) {
        None => Ok(views),
        Some(name) => {
            let expected = "names that differ in more than case";
            Err(FileError::content(expected, format!("{name:?} twice"), path).into())
        }
    }
}

/// Writes cameras in the format of [`read`].
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(path: &Path, views: &[View]) -> Result<(), FileError> {
    if let Some((view, lens)) = views.iter().find_map(|view| Some((view, view.camera.lens.as_ref()?))) {
        let found = format!("a {} lens of {}", lens.name(), view.camera.name);
        return Err(FileError::content("pinhole cameras", found, path));
    }
    let cameras = views.iter().map(|view| RawCamera {
        name: view.camera.name.to_string(),
        width: view.camera.width,
        height: view.camera.height,
        intrinsics: view.camera.rows(),
        camera_from_world: rows(&view.camera_from_world),
    });
    crate::files::write_json(path, &RawCameras { cameras: cameras.collect() })
}

/// Returns a transform as a row-major 4×4 matrix.
pub fn rows(transform: &DAffine3) -> [[f64; 4]; 4] {
    DMat4::from(*transform).transpose().to_cols_array_2d()
}

fn view(raw: RawCamera, path: &Path) -> Result<View, CamerasError> {
    let value = |expected: &str, found: String| CamerasError::Value {
        expected: expected.to_owned(),
        found,
        camera: raw.name.clone(),
        path: path.to_owned(),
    };
    let m = raw.camera_from_world;
    if let Some(number) = m.iter().flatten().find(|v| !v.is_finite()) {
        return Err(value("finite numbers in camera_from_world", number.to_string()));
    }
    if m[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(value("camera_from_world with last row 0 0 0 1", format!("{:?}", m[3])));
    }
    let camera_from_world = DAffine3::from_mat4(DMat4::from_cols_array_2d(&m).transpose());
    let rotation = camera_from_world.matrix3;
    let off = rotation * rotation.transpose() - DMat3::IDENTITY;
    let worst = off.to_cols_array().into_iter().fold(0.0, |a: f64, b| a.max(b.abs()));
    if !(worst <= RIGID_TOLERANCE && rotation.determinant() > 0.0) {
        let found = format!("determinant {}, R Rt off by {worst}", rotation.determinant());
        return Err(value("camera_from_world to rotate and move only", found));
    }
    let position = camera_from_world.inverse().translation;
    if !is_position(position) {
        let found = format!("{:?}", position.to_array());
        return Err(value(&format!("a camera within {MAX_COORDINATE_M} m of the origin"), found));
    }
    let camera = Camera::new(&raw.name, raw.width, raw.height, raw.intrinsics)
        .map_err(|source| CamerasError::Camera { source, camera: raw.name.clone(), path: path.to_owned() })?;
    Ok(View { camera, camera_from_world })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn views() -> Vec<View> {
        let rows = [[1000.0, 0.0, 800.0], [0.0, 1100.0, 450.0], [0.0, 0.0, 1.0]];
        let pose = DAffine3::from_rotation_y(0.7) * DAffine3::from_translation(DVec3::new(4e6, -2.0, 3.5));
        let view =
            |name| View { camera: Camera::new(name, 1600, 900, rows).unwrap(), camera_from_world: pose };
        vec![view("left"), view("right")]
    }

    #[test]
    fn written_cameras_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.json");
        write(&path, &views()).unwrap();
        assert_eq!(read(&path).unwrap(), views());
    }

    #[test]
    fn errors_state_the_expected_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.json");
        write(&path, &views()).unwrap();
        let good: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let with = |pointer: &str, value: serde_json::Value| {
            let mut json = good.clone();
            *json.pointer_mut(pointer).unwrap() = value;
            json.to_string()
        };
        for (text, message) in [
            (with("/cameras", serde_json::json!([])), "at least one camera, found an empty list"),
            (with("/cameras/0/name", "right".into()), "\"right\" twice"),
            (with("/cameras/0/name", "../x".into()), "a name without /"),
            (with("/cameras/0/width", 0.into()), "a size of 1 to 16384 pixels, found 900x0 in camera left"),
            (
                with("/cameras/0/width", (-1).into()),
                "found -1 instead of a whole number from 0 in cameras[0].width of record left",
            ),
            (with("/cameras/0/intrinsics/0/0", 0.0.into()), "invertible intrinsics"),
            (
                with("/cameras/1/intrinsics/2/2", 2.0.into()),
                "last row 0 0 1, found [0.0, 0.0, 2.0] in camera right",
            ),
            (with("/cameras/0/camera_from_world/3/0", 1.0.into()), "last row 0 0 0 1"),
            (with("/cameras/0/camera_from_world/1/1", (-1.0).into()), "rotate and move only"),
            (with("/cameras/0/camera_from_world/1/1", 2.0.into()), "rotate and move only"),
            (
                with("/cameras/1/camera_from_world/0/3", 3e38.into()),
                "a camera within 100000000 m of the origin, found [-",
            ),
            (
                good.to_string().replace("1000.0", "1e999"),
                "found a number out of range in cameras[0].intrinsics[0][0]",
            ),
            ("{".to_owned(), "found the end of the file after 1 bytes"),
        ] {
            std::fs::write(&path, text).unwrap();
            let found = read(&path).unwrap_err().to_string();
            assert!(found.contains(message) && found.ends_with("c.json"), "{found}, expected {message}");
        }
    }
}
