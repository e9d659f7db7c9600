//! Names of the files in a rollout's folder and in the folders of its steps.

use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;

use crate::report::images::TRUTH;
use crate::report::view;

pub(in super::super) use crate::report::{ROLLOUT, STATES, STEPS};

pub(in super::super) const INDEX: &str = "index.json";
/// Metrics of the driving, and the reason for the end.
pub const METRICS: &str = "metrics.json";
pub(in super::super) const VIDEO: &str = "rollout.mp4";
pub(in super::super) const PAGE: &str = "index.html";
pub(in super::super) const META: &str = "meta.json";
pub(in super::super) const SHEET: &str = "sheet.png";
pub(in super::super) const STATE: &str = "state.json";
pub(in super::super) const FORECAST: &str = "forecast";
/// State of the generator that is carried over to the next frame.
pub(in super::super) const GENERATOR_STATE: &str = "generator.safetensors";

/// Returns the folder of a step.
pub(in super::super) fn step_folder(folder: &Path, name: &str) -> PathBuf {
    folder.join(STEPS).join(name)
}

/// Returns the files of a step that a planner may read, sorted: its maps and metadata.
pub(in super::super) fn shown_files(folder: &Path) -> Result<Vec<PathBuf>, FileError> {
    let folder = std::path::absolute(folder).map_err(FileError::io("read", folder))?;
    let entries = |folder: &Path| -> std::io::Result<Vec<PathBuf>> {
        std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
    };
    let mut files = Vec::new();
    for path in entries(&folder).map_err(FileError::io("read", &folder))? {
        // Planners must not see ground truth.
        if [view::VIEW, FORECAST, STATE, TRUTH, GENERATOR_STATE].iter().any(|name| path.ends_with(name)) {
            continue;
        }
        match path.is_dir() {
            true => files.extend(entries(&path).map_err(FileError::io("read", &path))?),
            false => files.push(path),
        }
    }
    files.sort();
    Ok(files)
}
