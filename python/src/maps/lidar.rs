//! LiDAR sweeps as NumPy arrays.

use numpy::{PyArray1, PyArrayMethods};
use point_skeleton::lidar::{LidarReturn, LidarSpec, LidarSweep};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::error::{LogError, invalid};

/// Reads the name of a LiDAR: a preset, or a JSON file. `position` is where devices without a mount are,
/// meters in the ego frame.
///
/// # Errors
/// Raises `ValueError` for an unknown name, and for a device without a mount if there is no position.
pub(crate) fn spec(name: &str, position: Option<[f64; 3]>) -> PyResult<LidarSpec> {
    let spec = LidarSpec::named(name).map_err(invalid)?;
    let spec = position.map_or(spec.clone(), |position| spec.mounted_at(position.into()));
    match spec.devices.iter().find(|device| device.ego_from_lidar.is_none()) {
        Some(device) => Err(invalid(format!(
            "expected a position of {} on the ego, found none: give position=(x, y, z)",
            device.name
        ))),
        None => Ok(spec),
    }
}

/// Returns the description of a LiDAR by name, a preset or a JSON file: a dictionary with `devices`, each
/// with `name`, `elevations_deg`, `columns`, `range_m`, .., and `seed`, as in the files
/// (docs/src/guide/lidar.md).
///
/// Raises `ValueError` for an unknown name or an invalid file.
#[pyfunction]
pub(crate) fn lidar_spec<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    let spec = LidarSpec::named(name).map_err(invalid)?;
    let text = serde_json::to_string(&spec).map_err(|error| LogError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Returns the arrays of a sweep: points `[N, 3]` `float32`, intensity, ring, device, class, instance and
/// time `[N]`, and range, a list of `[beams, columns]` `float32`.
pub(crate) fn dictionary<'py>(py: Python<'py>, sweep: &LidarSweep) -> PyResult<Bound<'py, PyDict>> {
    let returns: Vec<LidarReturn> = sweep.returns().collect();
    let dictionary = PyDict::new(py);
    let points: Vec<f32> = returns.iter().flat_map(|r| r.position).collect();
    let points = PyArray1::from_vec(py, points).reshape([returns.len(), 3])?;
    dictionary.set_item("points", points)?;
    dictionary.set_item("intensity", PyArray1::from_iter(py, returns.iter().map(|r| r.intensity)))?;
    dictionary.set_item("ring", PyArray1::from_iter(py, returns.iter().map(|r| r.ring)))?;
    dictionary.set_item("device", PyArray1::from_iter(py, returns.iter().map(|r| r.device)))?;
    dictionary.set_item("class", PyArray1::from_iter(py, returns.iter().map(|r| r.class)))?;
    dictionary.set_item("instance", PyArray1::from_iter(py, returns.iter().map(|r| r.instance)))?;
    dictionary.set_item("time", PyArray1::from_iter(py, returns.iter().map(|r| r.offset_s)))?;
    let ranges = PyList::empty(py);
    for image in &sweep.devices {
        let range = PyArray1::from_slice(py, &image.range_m).reshape([image.beams, image.columns])?;
        ranges.append(range)?;
    }
    dictionary.set_item("range", ranges)?;
    Ok(dictionary)
}
