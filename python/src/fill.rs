use numpy::ndarray::{Ix3, Ix4};
use numpy::{PyArray1, PyArray4, PyArrayMethods};
use pskel_network::fill_holes as fill;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::maps::arrays::Typed;
use crate::pool::detached;

/// Fills the holes of color maps `[V, H, W, 3]` `uint8`, where `depth` `[V, H, W]` `float32` is infinite,
/// with weighted means of the pixels around them (pull-push). Returns `[V, H, W, 3]` `uint8`; images without
/// any point are gray. Raises `ValueError` for other shapes.
#[pyfunction]
pub(crate) fn fill_holes<'py>(
    py: Python<'py>,
    color: Typed<'py, u8, Ix4>,
    depth: Typed<'py, f32, Ix3>,
) -> PyResult<Bound<'py, PyArray4<u8>>> {
    let (color, depth) = (color.0.as_array(), depth.0.as_array());
    let &[views, height, width, channels] = color.shape() else { unreachable!("an array of four axes") };
    if channels != 3 || depth.shape() != [views, height, width] {
        return Err(PyValueError::new_err(format!(
            "expected color [V, H, W, 3] and depth [V, H, W], found {:?} and {:?}",
            color.shape(),
            depth.shape()
        )));
    }
    let pixels: Vec<u8> = color.iter().copied().collect();
    let known: Vec<bool> = depth.iter().map(|depth| depth.is_finite()).collect();
    let image = (height * width).max(1);
    let filled = detached(py, || {
        let one = |(color, known): (&[[u8; 3]], &[bool])| fill(color, known, width);
        let images: Vec<Vec<[u8; 3]>> =
            pixels.as_chunks().0.par_chunks(image).zip(known.par_chunks(image)).map(one).collect();
        Ok(images.concat().as_flattened().to_vec())
    })?;
    PyArray1::from_vec(py, filled).reshape([views, height, width, 3])
}
