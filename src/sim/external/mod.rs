//! A planner in another process: lines of JSON over its standard input and output or a socket.
//!
//! # How it works
//! See `docs/PLANNER.md` for what is said. One thread writes and one reads, so that a planner that neither reads nor
//! answers is noticed when its time is over. The process is killed, with all that it started in its group, when the
//! rollout is over or the planner fails.

mod protocol;
mod transport;

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use serde::Serialize;

use self::protocol::{Hello, Observation, read_hello, read_plan};
use self::transport::Link;
use super::clock::Clock;
use super::recorded::Recorded;
use super::simulation::World;
use super::{SimOptions, Trajectory};

/// Where a planner is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlannerAddress {
    /// A command for `sh`; lines go over its standard input and output.
    Command(String),
    /// A Unix socket that it listens at.
    Unix(PathBuf),
    /// `HOST:PORT` that it listens at.
    Tcp(String),
}

/// A planner in another process.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannerSpec {
    /// Where it is.
    pub address: PlannerAddress,
    /// How long to wait for each of its answers, and for a socket to be there, seconds. Not saved: a rollout that ended
    /// for want of time may go on with more.
    #[serde(skip)]
    pub timeout_s: f64,
}

/// How a planner in another process fails.
#[derive(Debug, thiserror::Error)]
pub enum PlannerError {
    /// A name that is none.
    #[error("expected a planner unix:PATH, tcp:HOST:PORT or a command, found {found:?}")]
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
    #[error("cannot {verb} the planner: {source}: {planner}")]
    Io {
        /// "start", "write to", ...
        verb: &'static str,
        /// What the system said.
        source: std::io::Error,
        /// Its address.
        planner: String,
    },
    /// It does not answer.
    #[error("expected an answer of the planner within {timeout_s} s, found none: {planner}")]
    Silent {
        /// Seconds.
        timeout_s: f64,
        /// Its address.
        planner: String,
    },
    /// It ends, or closes the connection.
    #[error("expected an answer of the planner, found its end{status}: {planner}")]
    Gone {
        /// With what exit status, where known; begins with a blank.
        status: String,
        /// Its address.
        planner: String,
    },
    /// It says something else.
    #[error("expected {expected} from the planner, found {found}: {planner}")]
    Answer {
        /// What the protocol asks for.
        expected: String,
        /// What it said.
        found: String,
        /// Its address.
        planner: String,
    },
}

impl FromStr for PlannerAddress {
    type Err = PlannerError;

    fn from_str(text: &str) -> Result<Self, PlannerError> {
        let wrong = || PlannerError::Address { found: text.to_owned() };
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

impl std::fmt::Display for PlannerAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Command(command) => write!(f, "{command}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

/// A planner that has said hello.
pub(super) struct Planner {
    link: Link,
    shown: Vec<PathBuf>,
}

impl Planner {
    /// Starts or reaches it and exchanges hellos; the rollout starts or goes on at `step`.
    pub(super) fn start(
        spec: &PlannerSpec,
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
        step: usize,
    ) -> Result<Self, PlannerError> {
        if !(spec.timeout_s > 0.0 && spec.timeout_s <= 86_400.0) {
            return Err(PlannerError::Timeout { found: spec.timeout_s });
        }
        let mut link = Link::open(&spec.address, Duration::from_secs_f64(spec.timeout_s))?;
        let hello = Hello::new(options, clock, &recorded.log.name, step);
        let answer = link.ask(protocol::line(&hello, &link.name())?)?;
        read_hello(&answer).map_err(|error| error.of(&link.name()))?;
        Ok(Self { link, shown: Vec::new() })
    }

    /// Its plan at a state.
    pub(super) fn plan(
        &mut self,
        recorded: &Recorded<'_>,
        clock: &Clock,
        world: &World,
    ) -> Result<Trajectory, PlannerError> {
        let now = &world.instant;
        let observation = Observation::new(recorded, clock, world, std::mem::take(&mut self.shown));
        let answer = self.link.ask(protocol::line(&observation, &self.link.name())?)?;
        let due_us = clock.at(now.step + clock.steps_per_plan);
        read_plan(&answer, now, due_us).map_err(|error| {
            self.link.close();
            error.of(&self.link.name())
        })
    }

    /// Files for the next observation.
    pub(super) fn show(&mut self, files: Vec<PathBuf>) {
        self.shown = files;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_apart() {
        let address = |text: &str| text.parse::<PlannerAddress>();
        assert_eq!(address("unix:/tmp/a b").unwrap(), PlannerAddress::Unix("/tmp/a b".into()));
        assert_eq!(address("tcp:[::1]:80").unwrap(), PlannerAddress::Tcp("[::1]:80".into()));
        assert_eq!(address("python3 p.py").unwrap(), PlannerAddress::Command("python3 p.py".into()));
        for text in ["", "  ", "unix:", "tcp:", "tcp:host", "tcp::80", "tcp:host:99999"] {
            assert!(matches!(address(text), Err(PlannerError::Address { .. })), "{text:?}");
        }
    }
}
