use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use point_skeleton::cloud::Point;
use point_skeleton::dataset::Class;
use point_skeleton::geometry::{MAX_COORDINATE_M, MAX_SIDE_M, is_position, is_size};
use point_skeleton::skeleton::{AssetPoints, GlobalPoint};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::error::raise;
use crate::maps::arrays::Numbers;
use crate::maps::points::{ArrayPoint, points};
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

    /// Writes a skeleton of your own points: `background` `[N, 6]` (global x, y, z in meters; red, green,
    /// blue of 0 to 255) or `[N, 7]` (and class); `assets` by track: category, box size (length, width,
    /// height in meters), and points in the frame of the box. `log` is its name in `logs`. Background points
    /// are stored in cubes, in another order; asset points keep theirs. An existing skeleton is replaced.
    /// Raises `ValueError` for invalid points, `BuildError` if the folder cannot be written.
    #[staticmethod]
    #[pyo3(signature = (path, background, assets=None, *, log="points"))]
    fn from_points(
        py: Python<'_>,
        path: PathBuf,
        background: Numbers<'_>,
        assets: Option<BTreeMap<String, AssetArrays<'_>>>,
        log: &str,
    ) -> PyResult<Self> {
        let point = |(row, point): (usize, ArrayPoint), name: &str| {
            let ArrayPoint { position, rgb, class } = point;
            if !is_position(position) {
                let found = position.to_array();
                return Err(PyValueError::new_err(format!(
                    "expected positions within {MAX_COORDINATE_M} m of zero, found {found:?} at point {row} \
                        of {name}"
                )));
            }
            Ok(GlobalPoint { position, rgb, class })
        };
        let name = "background";
        let background = points(py, name, &background)?.into_iter().enumerate();
        let background: Vec<GlobalPoint> =
            background.map(|each| point(each, name)).collect::<PyResult<_>>()?;
        let asset = |(track, (category, size, array)): (String, AssetArrays<'_>)| {
            if !is_size(DVec3::from(size)) {
                return Err(PyValueError::new_err(format!(
                    "expected a size above 0 and up to {MAX_SIDE_M} m of asset {track:?}, found {size:?}"
                )));
            }
            let class = Class::from_category(&category);
            let name = format!("points of asset {track:?}");
            let local = |each| {
                let GlobalPoint { position, rgb, .. } = point(each, &name)?;
                Ok(Point::new(position.as_vec3().to_array(), rgb, class as u8))
            };
            let points = points(py, &name, &array)?.into_iter().enumerate().map(local);
            Ok(AssetPoints { points: points.collect::<PyResult<_>>()?, track, category, class, size })
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

    /// Point count of the background.
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
