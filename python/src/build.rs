use std::path::PathBuf;
use std::sync::Arc;

use point_skeleton::BuildOptions;
use point_skeleton::skeleton::{self, BuildInput, BuildRun, Progress};
use pyo3::prelude::*;

use crate::error::raise;
use crate::log::Log;
use crate::pool::detached;
use crate::simulation::callback::Callback;
use crate::skeleton::Skeleton;

/// Builds a skeleton from all frames of a log, and writes it to a folder; an existing skeleton is replaced.
/// `progress` has the methods `start(stage, steps)` and `step()`. Ctrl-C stops the build; the next call with
/// `resume=True` continues it from its last checkpoint, at most 20 frames before. Raises `BuildError`, and
/// `RenderError` in the fork of a process that has rendered images of the log.
#[pyfunction]
#[pyo3(signature = (log, out, *, resume=false, progress=None))]
pub(crate) fn build(
    py: Python<'_>,
    log: &Log,
    out: PathBuf,
    resume: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Skeleton> {
    let log = Arc::clone(&log.inner);
    log.claim_images()?;
    let callback = Callback::new(progress);
    let build = || {
        let run = BuildRun { resume, progress: &callback, ..BuildRun::default() };
        let input = BuildInput::all(log.reader());
        let built = skeleton::build(&out, &[input], &BuildOptions::default(), &|_| Ok(Vec::new()), &run);
        match callback.raised() {
            Some(raised) => Err(raised),
            None => built.map_err(raise),
        }
    };
    Ok(Skeleton { inner: Arc::new(detached(py, build)?) })
}

impl Progress for Callback {
    fn start(&self, stage: &str, steps: usize) {
        self.call(|py, object| object.call_method1(py, "start", (stage, steps)));
    }

    fn step(&self) {
        self.call(|py, object| object.call_method0(py, "step"));
    }

    fn is_stopped(&self) -> bool {
        Self::is_stopped(self)
    }
}
