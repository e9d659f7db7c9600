//! Exceptions: `pskel.Error` and its subclasses.

use point_skeleton::error::with_causes;
use pskel_sim::SimError;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;

create_exception!(pskel, Error, PyException, "Base class of all errors of this package.");
create_exception!(pskel, LogError, Error, "A log cannot be opened or read.");
create_exception!(pskel, BuildError, Error, "A skeleton cannot be built or read.");
create_exception!(pskel, RenderError, Error, "Maps cannot be rendered.");
create_exception!(pskel, SimulationError, Error, "A simulation cannot be started or continued.");

/// Converts an error of the library to the exception of its kind, with all causes in the text.
pub(crate) fn raise(error: impl Into<point_skeleton::Error>) -> PyErr {
    use point_skeleton::Error as Core;
    let error = error.into();
    let text = with_causes(&error).to_string();
    match error {
        Core::Log(_) => LogError::new_err(text),
        Core::Build(_) | Core::File(_) => BuildError::new_err(text),
        Core::Render(_) | Core::Raster(_) => RenderError::new_err(text),
        _ => Error::new_err(text),
    }
}

/// Converts an error of a simulation: invalid options to `ValueError`, failures to `SimulationError`.
pub(crate) fn raise_sim(error: SimError) -> PyErr {
    let text = with_causes(&error).to_string();
    match error {
        SimError::Plan(_) | SimError::NotPlanned { .. } => PyValueError::new_err(text),
        error if error.is_usage() => PyValueError::new_err(text),
        _ => SimulationError::new_err(text),
    }
}

/// Converts an error of parsing an argument to a `ValueError`.
pub(crate) fn invalid(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
