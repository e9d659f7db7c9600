use std::path::PathBuf;

use point_skeleton::conditions::Captions;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::dataset::LogOpener;
use point_skeleton::error::with_causes;
use point_skeleton::files::FileName;
use point_skeleton::scene::RATES_HZ;
use pskel_export::{
    ExportError, ExportJob, ExportOptions, ExportProgress, ListedExport, Part, SampleFormat, SampleTimes,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{Error, invalid};
use crate::keywords::Keywords;
use crate::pool::detached;
use crate::simulation::callback::Callback;

/// An export of the condition maps of logs, with the keyword arguments of `pskel.export`.
#[pyclass(frozen, module = "pskel._pskel")]
pub(crate) struct Export {
    job: ExportJob,
    listed: ListedExport,
}

#[pymethods]
impl Export {
    /// Reads the arguments and lists the shards.
    #[new]
    fn new(py: Python<'_>, logs: Vec<String>, out: PathBuf, keywords: &Bound<'_, PyDict>) -> PyResult<Self> {
        let keywords = Keywords(keywords);
        let job = ExportJob {
            logs: logs.iter().map(|log| keywords.locate(log)).collect::<PyResult<_>>()?,
            out,
            skeletons: keywords.get("skeletons")?,
            options: options(keywords)?,
            only: keywords.get::<Option<(u32, u32)>>("only")?.map(part).transpose()?,
            rasterizer: keywords.rasterizer()?,
            jobs: keywords.count("jobs")?,
            verify: keywords.get("verify")?,
            opener: LogOpener::new(),
        };
        if job.jobs > ExportJob::MAX_JOBS {
            let max = ExportJob::MAX_JOBS;
            return Err(PyValueError::new_err(format!("expected jobs of 1 to {max}, found {}", job.jobs)));
        }
        let listed = detached(py, || job.list().map_err(failed))?;
        Ok(Self { job, listed })
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
        detached(py, || self.job.write_index(&self.listed, &folder).map_err(failed))
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
            let report = self.job.run(&listed, &callback);
            match callback.raised() {
                Some(raised) => Err(raised),
                None => serde_json::to_string(&report.map_err(failed)?).map_err(invalid),
            }
        };
        detached(py, run)
    }
}

fn options(keywords: Keywords<'_, '_>) -> PyResult<ExportOptions> {
    let layout = keywords.named("layout")?;
    let color_folder: FileName = keywords.get::<String>("color_folder")?.parse().map_err(invalid)?;
    let prompt = keywords.path("annotations")?.as_deref().map(PromptParts::read).transpose();
    let captions = keywords.path("captions")?.as_deref().map(Captions::read).transpose();
    let options = ExportOptions {
        layout,
        conditions: keywords.conditions()?,
        selection: keywords.selection()?,
        substitutes: keywords.substitutes()?,
        format: SampleFormat::of(keywords.named("format")?, layout).map_err(failed)?,
        frames: keywords.frames()?.map(|frames| [frames.start, frames.end]),
        shard_frames: keywords.count("shard_frames")?,
        images: keywords.get("images")?,
        times: times(keywords)?,
        color_folder: color_folder.to_string(),
        validation_logs: keywords
            .get::<Option<Vec<String>>>("validation_logs")?
            .into_iter()
            .flatten()
            .collect(),
        prompt: prompt.map_err(|error| failed(error.into()))?.unwrap_or_default(),
        captions: captions.map_err(|error| failed(error.into()))?.unwrap_or_default(),
    };
    options.check().map_err(failed)?;
    Ok(options)
}

fn times(keywords: Keywords<'_, '_>) -> PyResult<SampleTimes> {
    let hz = keywords.number("hz", "of 0.1 to 100", |hz| RATES_HZ.contains(&hz))?;
    match (hz, keywords.get("between_images")?) {
        (Some(_), true) => Err(PyValueError::new_err("expected hz or between_images, found both")),
        (Some(hz), false) => Ok(SampleTimes::Rate { hz }),
        (None, true) => Ok(SampleTimes::Images),
        (None, false) => Ok(SampleTimes::KeyFrames),
    }
}

fn part((index, count): (u32, u32)) -> PyResult<Part> {
    format!("{index}/{count}").parse().map_err(invalid)
}

fn failed(error: ExportError) -> PyErr {
    let text = with_causes(&error).to_string();
    match error {
        ExportError::Options { .. } => PyValueError::new_err(text),
        _ => Error::new_err(text),
    }
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
