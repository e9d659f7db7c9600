//! Past and predicted values. They are different types, so that a prediction cannot be taken for the past.

use pyo3::prelude::*;

/// A value of the simulated past. Created by a `Simulation`.
#[pyclass(frozen, module = "pskel", generic)]
pub(crate) struct Committed {
    pub(crate) inner: pskel_sim::Committed<Py<PyAny>>,
}

#[pymethods]
impl Committed {
    /// The value.
    #[getter]
    fn value(&self, py: Python<'_>) -> Py<PyAny> {
        self.inner.get().clone_ref(py)
    }

    /// Returns a function's result for the value, as committed.
    fn map(&self, function: &Bound<'_, PyAny>) -> PyResult<Self> {
        let value = function.call1((self.inner.get(),))?.unbind();
        let inner = self.inner.as_ref().map(|_| value);
        Ok(Self { inner })
    }
}

/// A predicted value.
#[pyclass(frozen, module = "pskel", generic)]
pub(crate) struct Forecast {
    pub(crate) inner: pskel_sim::Forecast<Py<PyAny>>,
}

#[pymethods]
impl Forecast {
    /// The value.
    #[getter]
    fn value(&self, py: Python<'_>) -> Py<PyAny> {
        self.inner.get().clone_ref(py)
    }

    /// Returns a function's result for the value, as a forecast.
    fn map(&self, function: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(Self { inner: pskel_sim::Forecast::new(function.call1((self.inner.get(),))?.unbind()) })
    }
}
