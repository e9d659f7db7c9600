use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;

/// Progress object of Python. Work stops at its first exception, or at a signal (Ctrl-C), which Python
/// handles in the main thread alone.
pub(crate) struct Callback {
    object: Option<Py<PyAny>>,
    raised: Mutex<Option<PyErr>>,
}

impl Callback {
    pub(crate) fn new(object: Option<Py<PyAny>>) -> Self {
        Self { object, raised: Mutex::new(None) }
    }

    /// Calls a method of the object, if there is one.
    pub(crate) fn call(&self, call: impl FnOnce(Python<'_>, &Py<PyAny>) -> PyResult<Py<PyAny>>) {
        Python::attach(|py| {
            let called = self.object.as_ref().map(|object| call(py, object));
            self.keep(called.transpose().and_then(|_| py.check_signals()));
        });
    }

    /// Returns whether to stop.
    pub(crate) fn is_stopped(&self) -> bool {
        Python::attach(|py| self.keep(py.check_signals()));
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Returns the exception that stopped the work.
    pub(crate) fn raised(&self) -> Option<PyErr> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn keep(&self, result: PyResult<()>) {
        if let Err(error) = result {
            self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }
    }
}
