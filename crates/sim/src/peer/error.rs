/// Role and address of a peer, for error messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerName {
    /// Role: "planner", "denoiser".
    pub role: &'static str,
    /// Address.
    pub address: String,
}

/// Failure of a peer process or of its specification.
#[derive(Debug, thiserror::Error)]
pub enum PeerError {
    /// The address is invalid.
    #[error("expected unix:PATH, tcp:HOST:PORT or a command, found {found:?}")]
    Address {
        /// The given text.
        found: String,
    },
    /// The time-out is out of range.
    #[error("expected a time-out over 0 s, at most a day, found {found} s")]
    Timeout {
        /// The given time-out, seconds.
        found: f64,
    },
    /// The process cannot be started or reached, or the connection breaks.
    #[error("cannot {verb} the {}: {source}: {}", peer.role, peer.address)]
    Io {
        /// Failed operation: "start", "write to", ...
        verb: &'static str,
        /// I/O error of the system.
        source: std::io::Error,
        /// The peer.
        peer: PeerName,
    },
    /// The process does not answer in time.
    #[error("expected an answer of the {} within {timeout_s} s, found none: {}", peer.role, peer.address)]
    Silent {
        /// Time-out, seconds.
        timeout_s: f64,
        /// The peer.
        peer: PeerName,
    },
    /// The process ends or closes the connection.
    #[error("expected an answer of the {}, found its end{after}: {}", peer.role, peer.address)]
    Gone {
        /// Received part of a message and exit status, if known; begins with a space.
        after: String,
        /// The peer.
        peer: PeerName,
    },
    /// The answer is invalid.
    #[error("expected {expected} from the {}, found {found}: {}", peer.role, peer.address)]
    Answer {
        /// Answer that the protocol requires.
        expected: String,
        /// Received answer.
        found: String,
        /// The peer.
        peer: PeerName,
    },
}

/// An answer that violates the protocol.
#[derive(Debug, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct ProtocolError {
    expected: String,
    found: String,
}

impl ProtocolError {
    /// Creates the error of an answer other than expected.
    pub fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { expected: expected.into(), found: found.into() }
    }

    /// Adds the peer that sent the answer.
    pub(super) fn of(self, peer: PeerName) -> PeerError {
        PeerError::Answer { expected: self.expected, found: self.found, peer }
    }
}

/// Returns the beginning of a message in quotes: at most 80 characters.
pub fn begin_of(message: &[u8]) -> String {
    let text = String::from_utf8_lossy(&message[..message.len().min(400)]);
    format!("{:?}", text.chars().take(80).collect::<String>())
}
