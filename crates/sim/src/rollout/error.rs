use std::error::Error;
use std::path::Path;

use point_skeleton::conditions::ConditionError;
use point_skeleton::error::FileError;
use point_skeleton::threads::ThreadError;

use crate::SimError;
#[cfg(feature = "video")]
use crate::report::VideoError;

/// Error of any type.
pub type AnyError = Box<dyn Error + Send + Sync>;

/// Error of a rollout.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    /// The simulation cannot be started or continued.
    #[error("{0}")]
    Simulation(#[from] SimError),
    /// A file of the rollout cannot be read or written.
    #[error("{0}")]
    File(#[from] FileError),
    /// The maps of a step cannot be written.
    #[error("{0}")]
    Maps(#[from] ConditionError),
    /// A thread could not be started.
    #[error("{0}")]
    Threads(#[from] ThreadError),
    /// The video cannot be encoded.
    #[cfg(feature = "video")]
    #[error("{0}")]
    Video(#[from] VideoError),
    /// The inputs cannot be described in `rollout.json`.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    /// A step or a file of an earlier run failed.
    #[error("{place}")]
    At {
        /// The step or the file.
        place: String,
        /// Cause.
        source: AnyError,
    },
}

impl RolloutError {
    /// Returns a closure for `map_err` that adds the name of a step.
    pub(super) fn step<E: Into<AnyError>>(name: &str) -> impl FnOnce(E) -> Self {
        let place = format!("step {name}");
        |source| Self::At { place, source: source.into() }
    }

    /// Returns a closure for `map_err` that adds a path.
    pub(super) fn file<E: Into<AnyError>>(path: &Path) -> impl FnOnce(E) -> Self {
        let place = path.display().to_string();
        |source| Self::At { place, source: source.into() }
    }
}
