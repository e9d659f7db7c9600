use std::sync::Arc;

use point_skeleton::dataset::Dataset;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::error::raise;
use crate::state::State;

/// A recorded drive: sensors, calibration, ego poses, tracked boxes and HD map. Its items are the states at key frames.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Log {
    pub(crate) inner: Arc<point_skeleton::Log>,
}

#[pymethods]
impl Log {
    /// Opens a log by name: `FORMAT:PATH[@VERSION][#SCENE]` or `town:OPTIONS`.
    #[new]
    fn new(py: Python<'_>, name: &str) -> PyResult<Self> {
        let open = || {
            let dataset: Box<dyn Dataset> = pskel::logs::open(&pskel::logs::locate(name)?)?;
            point_skeleton::Log::new(dataset)
        };
        Ok(Self { inner: Arc::new(py.detach(open).map_err(raise)?) })
    }

    /// Name, which identifies the log in skeletons.
    #[getter]
    fn name(&self) -> &str {
        self.inner.name()
    }

    /// Times of the key frames, microseconds.
    #[getter]
    fn times_us(&self) -> Vec<i64> {
        self.inner.dataset().log().frames.iter().map(|frame| frame.t_us).collect()
    }

    fn __len__(&self) -> usize {
        self.inner.dataset().log().frames.len()
    }

    /// Returns the state at a key frame; negative indices count from the end.
    fn __getitem__(&self, index: isize) -> PyResult<State> {
        let count = self.__len__();
        let at = if index < 0 { index.checked_add_unsigned(count) } else { Some(index) };
        let state = at.and_then(|at| usize::try_from(at).ok()).and_then(|at| self.inner.frame(at));
        state
            .map(State::new)
            .ok_or_else(|| PyIndexError::new_err(format!("expected a frame below {count}, found {index}")))
    }

    /// Returns the state at a time (microseconds), with interpolated ego and actors; `None` outside the log.
    fn at(&self, t_us: i64) -> Option<State> {
        self.inner.state_at(t_us).map(State::new)
    }

    fn __repr__(&self) -> String {
        format!("Log({:?}, {} frames)", self.name(), self.__len__())
    }
}
