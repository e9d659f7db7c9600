use std::path::PathBuf;
use std::str::FromStr;

use serde::Serialize;

use super::PeerError;

/// Address of a peer process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PeerAddress {
    /// Command for `sh`; messages are exchanged over its standard input and output.
    Command(String),
    /// Unix socket on which the process listens.
    Unix(PathBuf),
    /// TCP address `HOST:PORT` on which the process listens.
    Tcp(String),
}

/// Address of a peer process and its time-out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerSpec {
    /// Address of the process.
    pub address: PeerAddress,
    /// Time-out for each answer and for the connection, seconds. Not saved: a rollout that failed due to a
    /// time-out may be resumed with a longer one.
    #[serde(skip)]
    pub timeout_s: f64,
}

/// Maximum time-out, seconds: one day.
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
    fn parses_addresses() {
        let address = |text: &str| text.parse::<PeerAddress>();
        assert_eq!(address("unix:/tmp/a b").unwrap(), PeerAddress::Unix("/tmp/a b".into()));
        assert_eq!(address("tcp:[::1]:80").unwrap(), PeerAddress::Tcp("[::1]:80".into()));
        assert_eq!(address("python3 p.py").unwrap(), PeerAddress::Command("python3 p.py".into()));
        for text in ["", "  ", "unix:", "tcp:", "tcp:host", "tcp::80", "tcp:host:99999"] {
            assert!(matches!(address(text), Err(PeerError::Address { .. })), "{text:?}");
        }
    }
}
