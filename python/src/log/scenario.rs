use std::path::{Path, PathBuf};

use point_skeleton::dataset::ActorEdits;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::error::raise;

/// Reads a scenario from a file, or from its content as a dictionary. Raises `LogError` if the file cannot be
/// read, and `ValueError` for other content.
pub(super) fn read(given: &Bound<'_, PyAny>) -> PyResult<ActorEdits> {
    let edits = match given.extract::<PathBuf>() {
        Ok(path) => ActorEdits::read(&path).map_err(raise)?,
        Err(_) => {
            let text: String = given.py().import("json")?.call_method1("dumps", (given,))?.extract()?;
            let parsed = ActorEdits::parse(text.as_bytes(), Path::new("scenario"));
            parsed.map_err(|error| PyValueError::new_err(error.to_string()))?
        }
    };
    if let Some(path) = edits.files().next() {
        let message = format!("expected a scenario without points of files, found {}", path.display());
        return Err(PyValueError::new_err(message));
    }
    Ok(edits)
}

/// Returns the content of a scenario as a dictionary.
pub(super) fn content<'py>(py: Python<'py>, edits: &ActorEdits) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(edits).map_err(|error| PyValueError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}
