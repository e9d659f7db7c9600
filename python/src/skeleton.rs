use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use numpy::ndarray::ArrayView1;
use point_skeleton::cloud::Point;
use point_skeleton::dataset::Class;
use point_skeleton::skeleton::{AssetPoints, GlobalPoint};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Numbers, byte, shaped};
use crate::error::raise;
use crate::pool::detached;

/// Category, box size (length, width, height in meters) and points of an asset.
type AssetArrays<'py> = (String, [f64; 3], Numbers<'py>);

/// Points of a log: the static background, one asset per tracked actor, and category templates.
///
/// Opens the skeleton in a folder. Raises `BuildError`.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Skeleton {
    pub(crate) inner: Arc<point_skeleton::Skeleton>,
}

#[pymethods]
impl Skeleton {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let inner = Arc::new(detached(py, || point_skeleton::Skeleton::open(&path).map_err(raise))?);
        Ok(Self { inner })
    }

    /// Writes a skeleton of your own points: `background` `[N, 6]` (global x, y, z in meters; red, green, blue of 0 to 255)
    /// or `[N, 7]` (and class); `assets` by track: category, box size (length, width, height in meters), and points in the
    /// frame of the box. `log` is its name in `logs`. The points of the background are stored in cubes, in another order;
    /// those of an asset keep theirs. An existing skeleton is replaced. Raises `ValueError` for invalid points,
    /// `BuildError` if the folder cannot be written.
    #[staticmethod]
    #[pyo3(signature = (path, background, assets=None, *, log="points"))]
    fn from_points(
        py: Python<'_>,
        path: PathBuf,
        background: Numbers<'_>,
        assets: Option<BTreeMap<String, AssetArrays<'_>>>,
        log: &str,
    ) -> PyResult<Self> {
        let background = rows("background", &background, |row, point| {
            let (position, rgb, class) = values(row, point)?;
            Ok(GlobalPoint { position, rgb, class })
        })?;
        let asset = |(track, (category, size, points)): (String, AssetArrays<'_>)| {
            if !size.iter().all(|side| side.is_finite() && *side > 0.0) {
                return Err(PyValueError::new_err(format!(
                    "expected a size above 0 of asset {track:?}, found {size:?}"
                )));
            }
            let class = Class::from_category(&category);
            let points = rows(&format!("points of asset {track:?}"), &points, |row, point| {
                let (position, rgb, _) = values(row, point)?;
                Ok(Point::new(position.as_vec3().to_array(), rgb, class as u8))
            })?;
            Ok(AssetPoints { track, category, class, size, points })
        };
        let assets: Vec<AssetPoints> =
            assets.unwrap_or_default().into_iter().map(asset).collect::<PyResult<_>>()?;
        let log = log.to_owned();
        let write = || point_skeleton::Skeleton::from_points(&path, &log, &background, assets).map_err(raise);
        let inner = Arc::new(detached(py, write)?);
        Ok(Self { inner })
    }

    /// Folder.
    #[getter]
    fn path(&self) -> PathBuf {
        self.inner.path().to_owned()
    }

    /// Names of the logs it was built from.
    #[getter]
    fn logs(&self) -> Vec<&str> {
        self.inner.manifest.sources.iter().map(|source| source.log.as_str()).collect()
    }

    /// Track ids of the actors that have points, in all logs.
    #[getter]
    fn tracks(&self) -> Vec<&str> {
        self.inner.manifest.actors.iter().map(|asset| asset.track.as_str()).collect()
    }

    /// Number of points of the background.
    #[getter]
    fn background_points(&self) -> usize {
        self.inner.manifest.background_points()
    }

    fn __repr__(&self) -> String {
        format!("Skeleton({:?})", self.inner.path())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (PathBuf,)) {
        (slf.get_type().into_any(), (slf.get().path(),))
    }
}

/// Converts the rows of an array `[N, 6]` or `[N, 7]`.
pub(crate) fn rows<T>(
    name: &str,
    points: &Numbers<'_>,
    convert: impl Fn(usize, ArrayView1<'_, f64>) -> PyResult<T>,
) -> PyResult<Vec<T>> {
    let view = shaped(name, points, &[0, 0])?;
    let columns = view.shape()[1];
    if columns != 6 && columns != 7 {
        return Err(PyValueError::new_err(format!(
            "expected {name} [N, 6] or [N, 7], found {:?}",
            view.shape()
        )));
    }
    let each = view.outer_iter().enumerate();
    each.map(|(row, point)| convert(row, point.into_dimensionality().map_err(crate::error::invalid)?))
        .collect()
}

/// Reads position, color and class of a point.
pub(crate) fn values(row: usize, point: ArrayView1<'_, f64>) -> PyResult<(DVec3, [u8; 3], u8)> {
    let position = DVec3::new(point[0], point[1], point[2]);
    if !position.is_finite() {
        return Err(PyValueError::new_err(format!(
            "expected finite positions, found {position} at point {row}"
        )));
    }
    let rgb = [byte(point, 3, row)?, byte(point, 4, row)?, byte(point, 5, row)?];
    let class = if point.len() == 7 { byte(point, 6, row)? } else { 0 };
    Ok((position, rgb, class))
}
