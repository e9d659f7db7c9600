/// Who is spoken to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerName {
    /// What it is: "planner", "denoiser".
    pub role: &'static str,
    /// Where it is.
    pub address: String,
}

/// How a process that is asked fails.
#[derive(Debug, thiserror::Error)]
pub enum PeerError {
    /// A name that is none.
    #[error("expected unix:PATH, tcp:HOST:PORT or a command, found {found:?}")]
    Address {
        /// What was given.
        found: String,
    },
    /// A limit that is none.
    #[error("expected a time-out over 0 s, at most a day, found {found} s")]
    Timeout {
        /// Seconds.
        found: f64,
    },
    /// It cannot be started or reached, or the connection breaks.
    #[error("cannot {verb} the {}: {source}: {}", peer.role, peer.address)]
    Io {
        /// "start", "write to", ...
        verb: &'static str,
        /// What the system said.
        source: std::io::Error,
        /// Who it is.
        peer: PeerName,
    },
    /// It does not answer.
    #[error("expected an answer of the {} within {timeout_s} s, found none: {}", peer.role, peer.address)]
    Silent {
        /// Seconds.
        timeout_s: f64,
        /// Who it is.
        peer: PeerName,
    },
    /// It ends, or closes the connection.
    #[error("expected an answer of the {}, found its end{after}: {}", peer.role, peer.address)]
    Gone {
        /// After what part of a message and with what exit status, where known; begins with a blank.
        after: String,
        /// Who it is.
        peer: PeerName,
    },
    /// It says something else.
    #[error("expected {expected} from the {}, found {found}: {}", peer.role, peer.address)]
    Answer {
        /// What the protocol asks for.
        expected: String,
        /// What it said.
        found: String,
        /// Who it is.
        peer: PeerName,
    },
}

/// An answer that a protocol does not allow.
#[derive(Debug)]
pub(crate) struct Wrong {
    expected: String,
    found: String,
}

impl Wrong {
    pub(crate) fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { expected: expected.into(), found: found.into() }
    }

    /// With who said it.
    pub(super) fn of(self, peer: PeerName) -> PeerError {
        PeerError::Answer { expected: self.expected, found: self.found, peer }
    }
}

/// How a message begins, in quotes.
pub(crate) fn begin_of(message: &[u8]) -> String {
    let text = String::from_utf8_lossy(&message[..message.len().min(400)]);
    format!("{:?}", text.chars().take(80).collect::<String>())
}
