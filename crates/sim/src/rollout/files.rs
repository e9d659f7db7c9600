//! Names of the files in a rollout's folder and in the folders of its steps.

use std::path::{Path, PathBuf};

pub(super) use crate::report::{ROLLOUT, STATES, STEPS};

pub(super) const INDEX: &str = "index.json";
/// Metrics of the driving, and the reason for the end.
pub const METRICS: &str = "metrics.json";
pub(super) const VIDEO: &str = "rollout.mp4";
pub(super) const PAGE: &str = "index.html";
pub(super) const META: &str = "meta.json";
pub(super) const SHEET: &str = "sheet.png";
pub(super) const STATE: &str = "state.json";
pub(super) const FORECAST: &str = "forecast";
/// State of the generator that is carried over to the next frame.
pub(super) const GENERATOR_STATE: &str = "generator.safetensors";

/// Returns the folder of a step.
pub(super) fn step_folder(folder: &Path, name: &str) -> PathBuf {
    folder.join(STEPS).join(name)
}
