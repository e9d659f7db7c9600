//! Arguments that are arrays: anything that `numpy.asarray` converts to numbers, of any memory layout.

use glam::{DAffine3, DMat3, DMat4, DQuat};
use numpy::ndarray::{Array2, Array3, ArrayViewD, Dimension};
use numpy::{Element, IntoPyArray, PyArray2, PyArray3, PyReadonlyArray, PyReadonlyArrayDyn};
use point_skeleton::geometry::{Camera, ImageSize, MAX_COORDINATE_M, Pose, is_position};
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyFloat, PyInt, PyList, PyTuple};

/// An argument that `numpy.asarray` converts to an array of real numbers, as `float64`.
pub(crate) struct Numbers<'py> {
    array: PyReadonlyArrayDyn<'py, f64>,
    /// Whether the numbers were floats.
    pub(crate) floats: bool,
    /// Whether the numbers had fewer bits than `float64`, and so less precision.
    pub(crate) single: bool,
}

impl<'py> FromPyObject<'_, 'py> for Numbers<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        check_unmasked(&object)?;
        let array = object.py().import("numpy")?.call_method1("asarray", (object,))?;
        let dtype = array.getattr("dtype")?;
        let kind: String = dtype.getattr("kind")?.extract()?;
        if !["i", "u", "f"].contains(&kind.as_str()) {
            return Err(PyTypeError::new_err(format!(
                "expected an array of real numbers, found dtype {dtype}"
            )));
        }
        let floats = kind == "f";
        let single = floats && dtype.getattr("itemsize")?.extract::<usize>()? < size_of::<f64>();
        let array = array.call_method1("astype", ("float64",))?;
        Ok(Self { array: array.extract()?, floats, single })
    }
}

impl Numbers<'_> {
    pub(crate) fn as_array(&self) -> ArrayViewD<'_, f64> {
        self.array.as_array()
    }
}

/// An argument that is a NumPy array of one type.
pub(crate) struct Typed<'py, T: Element, D: Dimension>(pub(crate) PyReadonlyArray<'py, T, D>);

impl<'py, T: Element, D: Dimension + 'static> FromPyObject<'_, 'py> for Typed<'py, T, D> {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        check_unmasked(&object)?;
        Ok(Self(object.extract()?))
    }
}

/// Checks that an array, or a list or tuple of arrays, has no masked values: conversion would uncover what
/// lies below.
///
/// # Errors
/// Raises `TypeError` with the number of masked values.
fn check_unmasked(object: &Bound<'_, PyAny>) -> PyResult<()> {
    if object.is_exact_instance_of::<PyFloat>() || object.is_exact_instance_of::<PyInt>() {
        return Ok(());
    }
    if object.is_instance_of::<PyList>() || object.is_instance_of::<PyTuple>() {
        return object.try_iter()?.try_for_each(|item| check_unmasked(&item?));
    }
    let masked = object.py().import("numpy")?.getattr("ma")?;
    if !masked.call_method1("is_masked", (object,))?.extract::<bool>()? {
        return Ok(());
    }
    let mask = masked.call_method1("getmaskarray", (object,))?;
    let count: usize = mask.call_method0("sum")?.extract()?;
    Err(PyTypeError::new_err(format!(
        "expected an array without masked values, found {count} masked: drop them \
            (points[~points.mask.any(axis=1)]) or fill them"
    )))
}

/// An argument that is a sequence of two integers: height and width, pixels.
pub(crate) struct Size(pub(crate) ImageSize);

impl<'py> FromPyObject<'_, 'py> for Size {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let sides = object.len().and_then(|count| {
            (0..count.min(3)).map(|i| object.get_item(i)?.extract()).collect::<PyResult<Vec<i64>>>()
        });
        let max = Camera::MAX_SIDE;
        let wrong = || -> PyResult<String> {
            Ok(format!("expected a height and a width of 1 to {max} pixels, found {}", object.repr()?))
        };
        let side = |value: i64| u32::try_from(value).ok().filter(|side| (1..=max).contains(side));
        let size = match sides {
            Ok(sides) => match sides[..] {
                [height, width] => side(height).zip(side(width)),
                _ => None,
            },
            Err(error) if error.is_instance_of::<PyOverflowError>(object.py()) => None,
            Err(error) if error.is_instance_of::<PyTypeError>(object.py()) => {
                return Err(PyTypeError::new_err(wrong()?));
            }
            Err(error) => return Err(error),
        };
        let Some((height, width)) = size else { return Err(PyValueError::new_err(wrong()?)) };
        Ok(Self(ImageSize { height, width }))
    }
}

/// Returns the array of an argument with a shape; 0 stands for any length.
///
/// # Errors
/// Raises `ValueError` for another shape.
pub(crate) fn shaped<'a>(
    name: &str,
    array: &'a Numbers<'_>,
    shape: &[usize],
) -> PyResult<ArrayViewD<'a, f64>> {
    let view = array.as_array();
    let fits = |(found, expected): (&usize, &usize)| found == expected || *expected == 0;
    if view.ndim() == shape.len() && view.shape().iter().zip(shape).all(fits) {
        return Ok(view);
    }
    let letters = ["N", "M"];
    let text = |i: usize| if shape[i] == 0 { letters[i.min(1)].to_owned() } else { shape[i].to_string() };
    let expected: Vec<String> = (0..shape.len()).map(text).collect();
    Err(PyValueError::new_err(format!("expected {name} [{}], found {:?}", expected.join(", "), view.shape())))
}

/// Reads a rigid transform `[4, 4]`, meters.
///
/// # Errors
/// Raises `ValueError` for another shape, values that are not finite, coordinates beyond the limit of all
/// files, and matrices that scale, shear or mirror.
pub(crate) fn pose(name: &str, array: &Numbers<'_>) -> PyResult<Pose> {
    let view = shaped(name, array, &[4, 4])?;
    let affine = affine(name, |row, column| view[[row, column]])?;
    let (rotation, translation) = (affine.matrix3, affine.translation);
    let rotation = DQuat::from_mat3(&DMat3::from_cols(rotation.x_axis, rotation.y_axis, rotation.z_axis));
    Ok(Pose { rotation: rotation.normalize(), translation })
}

/// Reads a rigid transform from its elements by row and column.
///
/// # Errors
/// Raises `ValueError` as [`pose`] does.
pub(crate) fn affine(name: &str, element: impl Fn(usize, usize) -> f64) -> PyResult<DAffine3> {
    let columns: [[f64; 4]; 4] =
        std::array::from_fn(|column| std::array::from_fn(|row| element(row, column)));
    let matrix = DMat4::from_cols_array_2d(&columns);
    let rotation = DMat3::from_mat4(matrix);
    let off = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array();
    let rigid = matrix.is_finite()
        && matrix.row(3).to_array() == [0.0, 0.0, 0.0, 1.0]
        && off.iter().all(|value| value.abs() < 1e-4)
        && rotation.determinant() > 0.0;
    if rigid {
        let affine = DAffine3::from_mat4(matrix);
        if !is_position(affine.translation) {
            return Err(PyValueError::new_err(format!(
                "expected {name} within {MAX_COORDINATE_M} m of the origin, found {:?}",
                affine.translation.to_array()
            )));
        }
        return Ok(affine);
    }
    let rows = matrix.transpose().to_cols_array_2d();
    Err(PyValueError::new_err(format!("expected a finite rigid transform as {name}, found {rows:?}")))
}

/// Reads intrinsics from their elements by row and column.
pub(crate) fn intrinsics(element: impl Fn(usize, usize) -> f64) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| element(row, column)))
}

/// Returns the rows of a homogeneous transform.
pub(crate) fn rows(affine: &DAffine3) -> [[f64; 4]; 4] {
    DMat4::from(*affine).transpose().to_cols_array_2d()
}

/// Returns a homogeneous transform as an array.
pub(crate) fn matrix<'py>(py: Python<'py>, affine: &DAffine3) -> Bound<'py, PyArray2<f64>> {
    Array2::from(rows(affine).to_vec()).into_pyarray(py)
}

/// Returns matrices as an array.
pub(crate) fn stack<const N: usize>(py: Python<'_>, all: Vec<[[f64; N]; N]>) -> Bound<'_, PyArray3<f64>> {
    Array3::from(all).into_pyarray(py)
}
