use std::path::PathBuf;
use std::sync::Arc;

use point_skeleton::BuildOptions;
use pyo3::prelude::*;

use crate::error::raise;
use crate::log::Log;

/// Points of a log: the static background, one asset per tracked actor, and category templates.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Skeleton {
    pub(crate) inner: Arc<point_skeleton::Skeleton>,
}

#[pymethods]
impl Skeleton {
    /// Opens the skeleton in a folder.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let open = || Ok(point_skeleton::Skeleton::open(&path)?);
        Ok(Self { inner: Arc::new(py.detach(open).map_err(raise)?) })
    }

    /// Names of the logs it was built from.
    #[getter]
    fn logs(&self) -> Vec<&str> {
        self.inner.manifest.sources.iter().map(|source| source.log.as_str()).collect()
    }

    fn __repr__(&self) -> String {
        format!("Skeleton({})", self.logs().join(", "))
    }
}

/// Builds a skeleton from all frames of a log, and writes it to a folder. An existing skeleton is replaced.
#[pyfunction]
pub(crate) fn build(py: Python<'_>, log: &Log, out: PathBuf) -> PyResult<Skeleton> {
    let log = Arc::clone(&log.inner);
    let build = || point_skeleton::Skeleton::build(&log, &out, &BuildOptions::default());
    Ok(Skeleton { inner: Arc::new(py.detach(build).map_err(raise)?) })
}
