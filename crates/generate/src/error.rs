//! Errors of the generator.

use super::DenoiserError;

/// Error of generating a frame.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// Inconsistent options, or frames, a cache or forecasts that do not fit them.
    #[error("expected {expected}, found {found}")]
    Options {
        /// Accepted values.
        expected: String,
        /// Given values.
        found: String,
    },
    /// Error of the network.
    #[error("frame {frame}: {source}")]
    Denoiser {
        /// Number of the frame being generated.
        frame: usize,
        /// Underlying error.
        source: DenoiserError,
    },
}
