use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use point_skeleton::BuildOptions;
use point_skeleton::cloud::Point;
use point_skeleton::skeleton::{
    self, Asset, BuildInput, BuildRun, CHUNK_M, Progress, TemplateKind, TemplateLibrary, TemplateSources,
    read_template,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{invalid, raise};
use crate::keywords::Keywords;
use crate::log::Log;
use crate::log::owned::OwnedLog;
use crate::pool::detached;
use crate::simulation::callback::Callback;
use crate::skeleton::Skeleton;

/// Builds a skeleton from logs and writes it to a folder, with the keyword arguments of `pskel.build`.
/// `progress` has the methods `start(stage, steps)` and `step()`.
#[pyfunction]
pub(crate) fn build(
    py: Python<'_>,
    logs: Vec<PyRef<'_, Log>>,
    out: PathBuf,
    keywords: &Bound<'_, PyDict>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Skeleton> {
    let keywords = Keywords(keywords);
    let logs: Vec<Arc<OwnedLog>> = logs.iter().map(|log| Arc::clone(&log.inner)).collect();
    logs.iter().try_for_each(|log| log.claim_images())?;
    let inputs = inputs(&logs, keywords)?;
    let (options, sources) = (options(keywords)?, templates(keywords)?);
    let (resume, checkpoint_frames) = (keywords.get("resume")?, keywords.count("checkpoint")?);
    let callback = Callback::new(progress);
    let build = || {
        let run = BuildRun { resume, checkpoint_frames, progress: &callback };
        let templates = |assets: &[(&Asset, &[Point])]| Ok(sources.templates(assets).0);
        let built = skeleton::build(&out, &inputs, &options, &templates, &run);
        match callback.raised() {
            Some(raised) => Err(raised),
            None => built.map_err(raise),
        }
    };
    Ok(Skeleton { inner: Arc::new(detached(py, build)?) })
}

/// Returns the frames of each log to build from.
fn inputs<'a>(logs: &'a [Arc<OwnedLog>], keywords: Keywords<'_, '_>) -> PyResult<Vec<BuildInput<'a>>> {
    let (frames, every) = (keywords.frames()?, keywords.count("every")?);
    let input = |log: &'a Arc<OwnedLog>| {
        let count = log.recording().frames.len();
        let frames = frames.clone().unwrap_or(0..count);
        if frames.end > count {
            return Err(PyValueError::new_err(format!(
                "expected frames up to {count} of {}, found {}",
                log.name(),
                frames.end
            )));
        }
        Ok(BuildInput { reader: log.unedited_reader(), frames: frames.step_by(every).collect() })
    };
    logs.iter().map(input).collect()
}

fn options(keywords: Keywords<'_, '_>) -> PyResult<BuildOptions> {
    let mut options = BuildOptions::of(keywords.named("coloring")?);
    let expected = format!("of 0 m (keeps all points), or of 0.0001 to {CHUNK_M} m");
    options.voxel_m =
        keywords.number("voxel", &expected, BuildOptions::is_voxel_m)?.unwrap_or(options.voxel_m);
    options.actor_voxel_m = keywords.number("actor_voxel", &expected, BuildOptions::is_voxel_m)?;
    let margin_m = keywords.number("box_margin", "of 0 m or more", |margin| margin >= 0.0)?;
    options.split.margin_m = margin_m.unwrap_or(options.split.margin_m);
    options.between_sweeps = keywords.get("sweeps")?;
    Ok(options)
}

fn templates(keywords: Keywords<'_, '_>) -> PyResult<TemplateSources> {
    let given: Option<BTreeMap<String, PathBuf>> = keywords.get("template")?;
    let read = |(kind, path): (String, PathBuf)| {
        let kind: TemplateKind = kind.parse().map_err(invalid)?;
        Ok(read_template(kind, &path).map_err(raise)?.0)
    };
    let library = keywords.path("templates_from")?.as_deref().map(TemplateLibrary::open).transpose();
    Ok(TemplateSources {
        given: given.unwrap_or_default().into_iter().map(read).collect::<PyResult<_>>()?,
        own: keywords.get("templates")?,
        library: library.map_err(raise)?.unwrap_or_default().clouds,
    })
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
