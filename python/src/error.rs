//! Exceptions: `pskel.Error` and its subclasses.

use point_skeleton::conditions::ConditionError;
use point_skeleton::error::with_causes;
use point_skeleton::gpu::GpuError;
use point_skeleton::raster::RasterError;
use pskel_sim::SimError;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;

create_exception!(pskel, Error, PyException, "Base class of all errors of this package.");
create_exception!(pskel, LogError, Error, "A log cannot be opened or read.");
create_exception!(pskel, BuildError, Error, "A skeleton cannot be built or read.");
create_exception!(pskel, RenderError, Error, "Maps cannot be rendered.");
create_exception!(pskel, SimulationError, Error, "A simulation cannot be started or continued.");

/// How to avoid errors in forks.
pub(crate) const FORKS: &str =
    "a DataLoader takes multiprocessing_context=\"forkserver\", an AsyncVectorEnv context=\"forkserver\"";

/// Converts an error of the library to the exception of its kind, with all causes in the text.
pub(crate) fn raise(error: impl Into<point_skeleton::Error>) -> PyErr {
    use point_skeleton::Error as Core;
    let error = error.into();
    let mut text = with_causes(&error).to_string();
    if is_forked(&error) {
        text = format!("{text}; {FORKS}");
    }
    match error {
        Core::Render(ConditionError::NoMap { .. }) => PyValueError::new_err(text),
        Core::Log(_) => LogError::new_err(text),
        Core::Build(_) | Core::File(_) => BuildError::new_err(text),
        Core::Render(_) | Core::Raster(_) | Core::Lidar(_) => RenderError::new_err(text),
        _ => Error::new_err(text),
    }
}

/// Returns whether an error comes from a device in a forked process.
fn is_forked(error: &point_skeleton::Error) -> bool {
    use point_skeleton::Error as Core;
    let (Core::Raster(error) | Core::Render(ConditionError::Raster(error))) = error else { return false };
    matches!(error, RasterError::Gpu(GpuError::Forked { .. }))
}

/// Converts an error of a simulation: invalid options to `ValueError`, failures to `SimulationError`.
pub(crate) fn raise_sim(error: SimError) -> PyErr {
    let text = with_causes(&error).to_string();
    match error {
        SimError::NoPlan { .. } => SimulationError::new_err(format!("{text}: call act before the next step")),
        SimError::Plan(_) | SimError::NotPlanned { .. } => PyValueError::new_err(text),
        error if error.is_usage() => PyValueError::new_err(text),
        _ => SimulationError::new_err(text),
    }
}

/// Converts an error of parsing an argument to a `ValueError`.
pub(crate) fn invalid(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
