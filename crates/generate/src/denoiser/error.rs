use pskel_sim::peer::PeerError;

/// Error of a network or a codec.
#[derive(Debug, thiserror::Error)]
pub enum DenoiserError {
    /// The network returned an invalid result.
    #[error("expected {expected} from the denoiser, found {found}")]
    Answer {
        /// Valid result.
        expected: String,
        /// Returned result.
        found: String,
    },
    /// The input does not fit the network.
    #[error("expected {expected}, found {found}")]
    Input {
        /// Accepted input.
        expected: String,
        /// Given input.
        found: String,
    },
    /// Error of a network in another process.
    #[error(transparent)]
    Process(#[from] PeerError),
    /// Error inside the network.
    #[error("the denoiser failed: {0}")]
    Network(#[from] Box<dyn std::error::Error + Send + Sync>),
}

impl DenoiserError {
    pub(crate) fn answer(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Answer { expected: expected.into(), found: found.into() }
    }

    /// Creates the error of an input other than expected.
    pub fn input(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Input { expected: expected.into(), found: found.into() }
    }
}
