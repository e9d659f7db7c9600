//! `calibration/`: intrinsics and extrinsics of the ring cameras.
//!
//! The published images are undistorted: `k1 k2 k3` in the file describe the original lenses. The dataset's
//! own API projects with focal lengths and principal point only, so cameras are pinholes here unless asked
//! otherwise. Source: <https://argoverse.github.io/user-guide/datasets/sensor.html> ("Sensor suite") and
//! issues 219 and 226 of <https://github.com/argoverse/av2-api>.

use std::path::Path;

use super::poses::{POSE, poses};
use crate::dataset::recording::notes::Notes;
use crate::dataset::tables::ArrowFile;
use crate::dataset::{DatasetError, Gap, ImageDistortion, RigCamera};
use crate::error::FileError;
use crate::files::first_twice;
use crate::geometry::{Camera, LensModel};

/// The seven ring cameras in ring order, each next to its neighbors. The front stereo pair is excluded.
pub(super) const RING: [&str; 7] = [
    "ring_front_center",
    "ring_front_right",
    "ring_side_right",
    "ring_rear_right",
    "ring_rear_left",
    "ring_side_left",
    "ring_front_left",
];

/// Kind of a gap: a ring camera without a row in one of the files.
const NO_CALIBRATION: &str = "ring cameras without calibration";

/// Reads the ring cameras that both files contain, in ring order, and counts the others. `channel` is the
/// index in this list.
///
/// # Errors
/// Fails if a file is damaged, or a camera is invalid or occurs twice.
pub(super) fn read(
    folder: &Path,
    distortion: ImageDistortion,
    notes: &mut Notes,
) -> Result<Vec<RigCamera>, DatasetError> {
    let path = folder.join("egovehicle_SE3_sensor.feather");
    let extrinsics = ArrowFile::read(&path)?.table(&[&["sensor_name"], &POSE[..]].concat(), &[])?;
    let sensors = extrinsics.column("sensor_name")?.texts()?;
    let ego_from_sensor = poses(&extrinsics, |row| format!("sensor {}", sensors[row]))?;
    let inner = folder.join("intrinsics.feather");
    let cameras = intrinsics(&inner, distortion)?;
    let mut rig = Vec::new();
    for name in RING {
        let mut missing =
            |path: &Path| notes.gap(Gap::record(NO_CALIBRATION, format!("sensor {name}"), path));
        let Some(camera) = cameras.iter().find(|c| c.name == name) else {
            missing(&inner);
            continue;
        };
        let twice = |path: &Path| FileError::content("every sensor once", format!("{name} twice"), path);
        let mut places = sensors.iter().zip(&ego_from_sensor).filter(|(sensor, _)| **sensor == name);
        let Some((_, ego_from_camera)) = places.next() else {
            missing(&path);
            continue;
        };
        if places.next().is_some() {
            return Err(twice(&path).into());
        }
        let (channel, ego_from_camera) = (rig.len(), *ego_from_camera);
        rig.push(RigCamera { channel, ego_from_camera, camera: camera.clone() });
    }
    Ok(rig)
}

/// Reads the sizes and intrinsics of all cameras.
fn intrinsics(path: &Path, distortion: ImageDistortion) -> Result<Vec<Camera>, DatasetError> {
    const NUMBERS: [&str; 4] = ["fx_px", "fy_px", "cx_px", "cy_px"];
    const LENS: [&str; 3] = ["k1", "k2", "k3"];
    let lens = if distortion == ImageDistortion::Apply { &LENS[..] } else { &[] };
    let columns = [&["sensor_name", "width_px", "height_px"], &NUMBERS[..], lens].concat();
    let table = ArrowFile::read(path)?.table(&columns, &[])?;
    let names = table.column("sensor_name")?.texts()?;
    let (widths, heights) = (table.column("width_px")?.counts()?, table.column("height_px")?.counts()?);
    let numbers = |name: &str| table.column(name)?.numbers();
    let [fx, fy, cx, cy] = [numbers("fx_px")?, numbers("fy_px")?, numbers("cx_px")?, numbers("cy_px")?];
    let lens: Vec<Vec<f64>> = lens.iter().map(|name| numbers(name)).collect::<Result<_, _>>()?;
    let camera = |row: usize| {
        let rows = [[fx[row], 0.0, cx[row]], [0.0, fy[row], cy[row]], [0.0, 0.0, 1.0]];
        let camera = Camera::new(names[row], widths[row], heights[row], rows);
        let camera = camera.map_err(|source| DatasetError::Camera {
            source,
            record: format!("sensor {}", names[row]),
            path: path.to_owned(),
        })?;
        let [k1, k2, k3] = [0, 1, 2].map(|i| lens.get(i).map_or(0.0, |column| column[row]));
        if ![k1, k2, k3].iter().all(|v| v.is_finite()) {
            let found = format!("{k1} {k2} {k3} of sensor {}", names[row]);
            return Err(FileError::content("finite k1 k2 k3", found, path).into());
        }
        Ok(Camera { lens: LensModel::from_opencv([k1, k2, 0.0, 0.0, k3]), ..camera })
    };
    let cameras: Vec<Camera> = (0..table.rows()).map(camera).collect::<Result<_, DatasetError>>()?;
    match first_twice(cameras.iter().map(|camera| &camera.name)) {
        None => Ok(cameras),
        Some(name) => Err(FileError::content("every sensor once", format!("{name} twice"), path).into()),
    }
}
