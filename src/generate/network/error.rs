use crate::error::FileError;
use crate::generate::DenoiserError;

/// Why a network is not made, read, run or trained.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// What it was given does not fit it.
    #[error("expected {expected}, found {found}")]
    Input {
        /// What would do.
        expected: String,
        /// What was given.
        found: String,
    },
    /// Training left the numbers that can be computed with.
    #[error("expected a finite {what} in step {step} of training, found {found}")]
    NotFinite {
        /// Loss or gradient.
        what: &'static str,
        /// Steps done before.
        step: u64,
        /// What it is.
        found: f64,
    },
    /// A file of weights or of training.
    #[error(transparent)]
    File(#[from] FileError),
    /// The tensor library.
    #[error("tensors: {0}")]
    Tensor(#[from] candle_core::Error),
}

impl NetworkError {
    pub(in crate::generate) fn input(expected: impl Into<String>, found: impl Into<String>) -> Self {
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
