use point_skeleton::error::FileError;
use pskel_generate::DenoiserError;

/// Error of creating, reading or running a network.
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
    /// Error of a weights file.
    #[error(transparent)]
    File(#[from] FileError),
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
