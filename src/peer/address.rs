use std::path::PathBuf;
use std::str::FromStr;

use serde::Serialize;

use super::PeerError;

/// Where a process is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PeerAddress {
    /// A command for `sh`; messages go over its standard input and output.
    Command(String),
    /// A Unix socket that it listens at.
    Unix(PathBuf),
    /// `HOST:PORT` that it listens at.
    Tcp(String),
}

/// A process that answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerSpec {
    /// Where it is.
    pub address: PeerAddress,
    /// How long to wait for each of its answers, and for a socket to be there, seconds. Not saved: a rollout that ended
    /// for want of time may go on with more.
    #[serde(skip)]
    pub timeout_s: f64,
}

/// Longest wait for an answer, seconds: a day.
pub const MAX_TIMEOUT_S: f64 = 86_400.0;

impl FromStr for PeerAddress {
    type Err = PeerError;

    fn from_str(text: &str) -> Result<Self, PeerError> {
        let wrong = || PeerError::Address { found: text.to_owned() };
        if let Some(path) = text.strip_prefix("unix:") {
            return if path.is_empty() { Err(wrong()) } else { Ok(Self::Unix(path.into())) };
        }
        if let Some(address) = text.strip_prefix("tcp:") {
            let port = address.rsplit_once(':').filter(|(host, _)| !host.is_empty());
            let known = port.is_some_and(|(_, port)| port.parse::<u16>().is_ok());
            return if known { Ok(Self::Tcp(address.to_owned())) } else { Err(wrong()) };
        }
        if text.trim().is_empty() { Err(wrong()) } else { Ok(Self::Command(text.to_owned())) }
    }
}

impl std::fmt::Display for PeerAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Command(command) => write!(f, "{command}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_apart() {
        let address = |text: &str| text.parse::<PeerAddress>();
        assert_eq!(address("unix:/tmp/a b").unwrap(), PeerAddress::Unix("/tmp/a b".into()));
        assert_eq!(address("tcp:[::1]:80").unwrap(), PeerAddress::Tcp("[::1]:80".into()));
        assert_eq!(address("python3 p.py").unwrap(), PeerAddress::Command("python3 p.py".into()));
        for text in ["", "  ", "unix:", "tcp:", "tcp:host", "tcp::80", "tcp:host:99999"] {
            assert!(matches!(address(text), Err(PeerError::Address { .. })), "{text:?}");
        }
    }
}
