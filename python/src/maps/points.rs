//! Arrays of points: `[N, 6]` (x, y, z, red, green, blue) or `[N, 7]` (and class).

use glam::DVec3;
use numpy::ndarray::ArrayView2;
use point_skeleton::cloud::{
    ColorRange, ColorScale, ColorValues, Point, Precision, local_position, origin_of,
};
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;

use super::arrays::{Numbers, shaped};
use crate::error::invalid;

/// Point of an array.
#[derive(Clone, Copy)]
pub(crate) struct ArrayPoint {
    /// Meters, finite.
    pub(crate) position: DVec3,
    pub(crate) rgb: [u8; 3],
    pub(crate) class: u8,
}

/// Reads an array of points. Colors are scaled as in NPY files; warns of scaled colors, and of positions that
/// `float32` has rounded.
///
/// # Errors
/// Raises `ValueError` for another shape, positions that are not finite, colors out of range, and classes
/// that are not integers of 0 to 255.
pub(crate) fn points(py: Python<'_>, name: &str, array: &Numbers<'_>) -> PyResult<Vec<ArrayPoint>> {
    let view = shaped(name, array, &[0, 0])?;
    let columns = view.shape()[1];
    if columns != 6 && columns != 7 {
        let found = view.shape();
        return Err(PyValueError::new_err(format!("expected {name} [N, 6] or [N, 7], found {found:?}")));
    }
    let view: ArrayView2<'_, f64> = view.into_dimensionality().map_err(invalid)?;
    let position = |row: usize| DVec3::new(view[[row, 0]], view[[row, 1]], view[[row, 2]]);
    let values = if array.floats { ColorValues::Levels } else { ColorValues::Bytes };
    let (mut range, mut precision) = (ColorRange::new(values), Precision::default());
    for row in 0..view.shape()[0] {
        range.add([view[[row, 3]], view[[row, 4]], view[[row, 5]]]);
        if array.single {
            precision.add(position(row).as_vec3().to_array());
        }
    }
    for note in range.note().into_iter().chain(precision.note(view.shape()[0], None)) {
        warn(py, &format!("{name}: {note}"))?;
    }
    let scale = range.scale();
    let read = |row: usize| {
        let position = position(row);
        if !position.is_finite() {
            return Err(PyValueError::new_err(format!(
                "expected finite positions, found {position} at point {row}"
            )));
        }
        let level = |column: usize| level(&scale, view[[row, column]], column, row);
        let class = if columns == 7 { class(view[[row, 6]], row)? } else { 0 };
        Ok(ArrayPoint { position, rgb: [level(3)?, level(4)?, level(5)?], class })
    };
    (0..view.shape()[0]).map(read).collect()
}

/// Returns points relative to an origin near most of them, and the origin, as for files. Warns of points too
/// far from it.
pub(crate) fn placed(py: Python<'_>, name: &str, points: &[ArrayPoint]) -> PyResult<(Vec<Point>, DVec3)> {
    let origin = origin_of(points.iter().map(|point| point.position));
    let mut precision = Precision::default();
    let local = |point: &ArrayPoint| match local_position(point.position, origin) {
        Some(local) => {
            precision.add(local);
            Point::new(local, point.rgb, point.class)
        }
        None => Point { position: [f32::NAN; 3], rgb_class: 0 },
    };
    let local: Vec<Point> = points.iter().map(local).collect();
    if let Some(note) = precision.note(points.len(), Some(origin)) {
        warn(py, &format!("{name}: {note}"))?;
    }
    Ok((local, origin))
}

fn warn(py: Python<'_>, note: &str) -> PyResult<()> {
    let note = std::ffi::CString::new(note).map_err(invalid)?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &note, 1)
}

fn level(scale: &ColorScale, value: f64, column: usize, row: usize) -> PyResult<u8> {
    scale.level(value).ok_or_else(|| {
        let max = scale.max();
        PyValueError::new_err(format!("expected 0 to {max} in column {column} of point {row}, found {value}"))
    })
}

fn class(value: f64, row: usize) -> PyResult<u8> {
    if (0.0..=255.0).contains(&value) && value.fract() == 0.0 {
        return Ok(value as u8);
    }
    let message = format!("expected an integer class of 0 to 255 in column 6 of point {row}, found {value}");
    Err(PyValueError::new_err(message))
}
