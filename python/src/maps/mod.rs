//! Condition maps as NumPy arrays over all cameras.

pub(super) mod arrays;
pub(super) mod lidar;
pub(super) mod points;

use numpy::{Element, PyArray1, PyArrayMethods};
use point_skeleton::conditions::MapPixels;
use point_skeleton::raster::PixelType;
use point_skeleton::{CameraConditions, MapKind};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Returns a dictionary of the rendered maps: color, boxes and map `[V, H, W, 3]` `uint8`; depth `[V, H, W]`
/// `float32`, meters, `inf` where empty; class `uint8`, instance and point `uint32`; points and layout
/// `float32` `[V, C, H, W]`.
pub(crate) fn dictionary<'py>(py: Python<'py>, cameras: &[CameraConditions]) -> PyResult<Bound<'py, PyDict>> {
    let dictionary = PyDict::new(py);
    let Some(first) = cameras.first() else { return Ok(dictionary) };
    if let Some(other) = cameras.iter().find(|camera| camera.size() != first.size()) {
        return Err(PyValueError::new_err(format!(
            "expected cameras of one size, found {} at {} and {} at {}: give out_size",
            first.name,
            first.size(),
            other.name,
            other.size()
        )));
    }
    let (height, width) = (first.height as usize, first.width as usize);
    let gray = vec![cameras.len(), height, width];
    let rgb = vec![cameras.len(), height, width, 3];
    for kind in MapKind::ALL {
        let array = match kind.description().pixels {
            PixelType::Rgb => {
                stacked(py, cameras, &rgb, |camera| camera.rgb(kind).map(<[[u8; 3]]>::as_flattened))?
            }
            PixelType::Depth => stacked(py, cameras, &gray, |camera| match camera.pixels(kind)? {
                MapPixels::Depth(map) => Some(map),
                _ => None,
            })?,
            PixelType::Class => stacked(py, cameras, &gray, |camera| match camera.pixels(kind)? {
                MapPixels::Class(map) => Some(map),
                _ => None,
            })?,
            PixelType::Number => stacked(py, cameras, &gray, |camera| match camera.pixels(kind)? {
                MapPixels::Number(map) => Some(map),
                _ => None,
            })?,
            PixelType::Channels => {
                let channels =
                    |count: usize| vec![cameras.len(), count / (height * width).max(1), height, width];
                if let Some(tensor) = &first.tensor {
                    let points = channels(tensor.points.len());
                    let points = stacked(py, cameras, &points, |camera| {
                        Some(camera.tensor.as_ref()?.points.as_slice())
                    })?;
                    let layout = channels(tensor.layout.len());
                    let layout = stacked(py, cameras, &layout, |camera| {
                        Some(camera.tensor.as_ref()?.layout.as_slice())
                    })?;
                    dictionary.set_item("points", points)?;
                    dictionary.set_item("layout", layout)?;
                }
                None
            }
        };
        if let Some(array) = array {
            dictionary.set_item(kind.name(), array)?;
        }
    }
    Ok(dictionary)
}

/// Copies one map of all cameras into an array; `None` if it was not rendered.
fn stacked<'py, T: Element + Copy + Default>(
    py: Python<'py>,
    cameras: &[CameraConditions],
    shape: &[usize],
    map: impl Fn(&CameraConditions) -> Option<&[T]>,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(parts) = cameras.iter().map(map).collect::<Option<Vec<_>>>() else { return Ok(None) };
    let array = PyArray1::from_vec(py, parts.concat());
    Ok(Some(array.reshape(shape.to_vec())?.into_any()))
}
