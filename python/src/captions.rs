use std::path::PathBuf;

use point_skeleton::conditions::{Captions as CaptionFile, Prompts};
use point_skeleton::error::with_causes;
use pyo3::prelude::*;

use crate::error::Error;
use crate::log::Log;
use crate::pool::detached;

/// Captions of a JSON file: by name of a log, token of an image, or scene, camera and time.
///
/// Parameters
/// ----------
/// path : path
///     File as for `--captions`.
///
/// Raises
/// ------
/// Error
///     If the file cannot be read or has other content.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Captions(CaptionFile);

#[pymethods]
impl Captions {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read =
            || CaptionFile::read(&path).map_err(|error| Error::new_err(with_causes(&error).to_string()));
        detached(py, read).map(Self)
    }

    /// Texts of a log, for each key frame and for the cameras of its scenes; `None` without any. They are
    /// those that generators get as prompts.
    fn of(&self, log: &Log) -> Option<Vec<Vec<String>>> {
        let recording = log.inner.recording();
        let captions = self.0.of_frames(recording)?;
        let texts = |t_us| match captions.at(t_us) {
            Prompts::Frame(text) => vec![text.clone(); recording.rig.len()],
            Prompts::Cameras(texts) => texts.clone(),
        };
        Some(recording.frames.iter().map(|frame| texts(frame.t_us)).collect())
    }
}
