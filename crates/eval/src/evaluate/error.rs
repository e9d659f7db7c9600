use std::error::Error;
use std::path::Path;

use point_skeleton::error::FileError;

use crate::NetworkError;

/// Error of scoring rollouts.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The number of mask folders differs from the number of rollouts.
    #[error("expected masks for each of {rollouts} rollouts, found {found}")]
    Masks {
        /// Number of rollouts.
        rollouts: usize,
        /// Number of mask folders.
        found: usize,
    },
    /// A network for metrics failed.
    #[error("{0}")]
    Network(#[from] NetworkError),
    /// A file is missing or damaged.
    #[error("{0}")]
    File(#[from] FileError),
    /// Images or masks do not fit.
    #[error("{source}: {place}")]
    At {
        /// Cause.
        source: Box<dyn Error + Send + Sync>,
        /// Files or folders.
        place: String,
    },
}

impl EvaluateError {
    /// Returns a closure for `map_err` that adds a path.
    pub(super) fn at<E: Error + Send + Sync + 'static>(path: &Path) -> impl FnOnce(E) -> Self {
        Self::in_files(path.display().to_string())
    }

    /// Returns a closure for `map_err` that adds the names of files or folders.
    pub(super) fn in_files<E: Error + Send + Sync + 'static>(place: String) -> impl FnOnce(E) -> Self {
        |source| Self::At { source: Box::new(source), place }
    }
}
