use point_skeleton::error::FileError;
use point_skeleton::memory::MemoryError;
use point_skeleton::threads::ThreadError;
use pskel_generate::DenoiserError;

/// Error of creating, reading, running or training a network.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The input does not fit the network.
    #[error("expected {expected}, found {found}")]
    Input {
        /// Accepted input.
        expected: String,
        /// Given input.
        found: String,
    },
    /// Training diverged.
    #[error("expected a finite {what} in step {step} of training, found {found}")]
    NotFinite {
        /// `loss` or `gradient`.
        what: &'static str,
        /// Number of steps done before.
        step: u64,
        /// The value found.
        found: f64,
    },
    /// Error of a weights file or a checkpoint.
    #[error(transparent)]
    File(#[from] FileError),
    /// A thread could not be started.
    #[error(transparent)]
    Threads(#[from] ThreadError),
    /// More memory is needed than available.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// Error of the tensor library.
    #[error("tensors: {0}")]
    Tensor(#[from] candle_core::Error),
}

impl NetworkError {
    pub(crate) fn input(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Input { expected: expected.into(), found: found.into() }
    }
}

impl From<NetworkError> for DenoiserError {
    fn from(error: NetworkError) -> Self {
        match error {
            NetworkError::Input { expected, found } => Self::Input { expected, found },
            other => Self::Network(Box::new(other)),
        }
    }
}
