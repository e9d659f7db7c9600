use std::path::PathBuf;

use point_skeleton::Log;
use point_skeleton::dataset::ActorEdits;
use point_skeleton::skeleton::Skeleton;
use pskel_sim::Rates;
use pskel_sim::rollout::{AnyError, ImageGenerator};
use serde_json::Value;

/// What is shown and driven in.
pub struct Inputs {
    /// Log, with the edits of the scenario.
    pub log: Log,
    /// Edits below those of the page.
    pub scenario: ActorEdits,
    /// Name of the log as on the command line.
    pub log_name: String,
    /// Arguments of the command line with which the log was opened, such as `--sensor-root DIR`.
    pub log_arguments: Vec<String>,
    /// Skeleton that was built from the log.
    pub skeleton: Skeleton,
    /// Its folder.
    pub skeleton_path: PathBuf,
    /// Default rates of the log.
    pub rates: Rates,
    /// Generator of camera images.
    pub generator: Option<LiveGenerator>,
}

/// Generator of camera images.
pub struct LiveGenerator {
    /// Name on the page.
    pub name: String,
    /// Images per second.
    pub hz: f64,
    /// Number of frames in its window; all but one are references at the beginning.
    pub window: usize,
    /// Number of forecasts that it takes at most.
    pub forecasts: usize,
    /// Arguments of the command line that choose it.
    pub arguments: Vec<String>,
    /// Network and options for `rollout.json`.
    pub record: Value,
    /// Line for the page of a rollout.
    pub fact: String,
    /// Starts a session.
    pub open: Box<OpenGenerator>,
}

/// Starts a session for the log of the inputs; the flag is whether its actors follow the log.
pub type OpenGenerator =
    dyn for<'a> Fn(&'a Inputs, bool) -> Result<Box<dyn ImageGenerator + 'a>, AnyError> + Send + Sync;
