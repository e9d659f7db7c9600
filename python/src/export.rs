use std::ffi::OsString;
use std::path::PathBuf;

use point_skeleton::error::with_causes;
use pskel::{ExportCommand, ListedExport};
use pskel_export::ExportProgress;
use pyo3::prelude::*;

use crate::error::{Error, invalid};
use crate::pool::detached;
use crate::simulation::callback::Callback;

/// An export of the condition maps of logs: the command `pskel export` with its arguments.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Export {
    command: ExportCommand,
    listed: ListedExport,
}

#[pymethods]
impl Export {
    /// Parses the arguments of `pskel export` and lists the shards. Raises `ValueError` for invalid
    /// arguments.
    #[new]
    fn new(py: Python<'_>, args: Vec<OsString>) -> PyResult<Self> {
        let command = ExportCommand::parse(args).map_err(|error| invalid(reason(&error.to_string())))?;
        let listed = detached(py, || command.list().map_err(failed))?;
        Ok(Self { command, listed })
    }

    /// Shards to write: name, log, first key frame and the one after the last.
    #[getter]
    fn shards(&self) -> Vec<(String, String, usize, usize)> {
        let logs = self.listed.part.logs.iter();
        let shard = |log: &str, unit: &pskel_export::WorkUnit| {
            (unit.name.clone(), log.to_owned(), unit.frames.start, unit.frames.end)
        };
        logs.flat_map(|log| {
            let name = log.locator.to_string();
            log.units.iter().map(move |unit| shard(&name, unit))
        })
        .collect()
    }

    /// Logs that cannot be opened, with the error.
    #[getter]
    fn failures(&self) -> Vec<(String, String)> {
        self.listed.failures.iter().map(|failure| (failure.name.clone(), failure.error.clone())).collect()
    }

    /// Writes `index.json` into a folder with the records of all shards, and returns whether all of them
    /// exist.
    fn write_index(&self, py: Python<'_>, folder: PathBuf) -> PyResult<bool> {
        detached(py, || self.command.write_index(&self.listed, &folder).map_err(failed))
    }

    /// Writes the shards with these names, by default all and their index, and returns a report as JSON.
    /// `progress` has the methods `frame(shard)` and `skip(frames)`. Raises `Error` if the folder cannot be
    /// written. Ctrl-C stops the export.
    #[pyo3(signature = (shards=None, *, progress=None))]
    fn run(
        &self,
        py: Python<'_>,
        shards: Option<Vec<String>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<String> {
        let callback = Callback::new(progress);
        let run = || {
            let mut listed = self.listed.clone();
            if let Some(shards) = &shards {
                listed.part = listed.part.only(|unit| shards.contains(&unit.name));
                listed.failures.clear();
                listed.list = None;
            }
            let report = self.command.run(&listed, &callback);
            match callback.raised() {
                Some(raised) => Err(raised),
                None => serde_json::to_string(&report.map_err(failed)?).map_err(invalid),
            }
        };
        detached(py, run)
    }
}

fn failed(error: impl AsRef<dyn std::error::Error + Send + Sync>) -> PyErr {
    Error::new_err(with_causes(error.as_ref()))
}

impl ExportProgress for Callback {
    fn frame(&self, shard: &str) {
        self.call(|py, object| object.call_method1(py, "frame", (shard,)));
    }

    fn skip(&self, frames: usize) {
        self.call(|py, object| object.call_method1(py, "skip", (frames,)));
    }

    fn is_stopped(&self) -> bool {
        Self::is_stopped(self)
    }
}

/// Returns the first paragraph of the message about a wrong argument, without the usage of the command, in
/// one line.
fn reason(message: &str) -> String {
    let message = message.strip_prefix("error: ").unwrap_or(message);
    message.lines().map(str::trim).take_while(|line| !line.is_empty()).collect::<Vec<_>>().join(" ")
}
