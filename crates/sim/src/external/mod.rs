//! External planner process with a protocol of JSON lines, see `docs/src/reference/planner.md`.

mod hello;
mod observation;
mod plan;
mod unreadable;

use point_skeleton::files::text::printable;
use serde::{Deserialize, Serialize};

pub(super) use self::observation::Observation;
pub(super) use self::plan::{plan_of, read_plan};

use self::hello::{Hello, read_hello};
use super::clock::Clock;
use super::recorded::Recorded;
use super::{Instant, PlannerError, PlannerSpec, SimOptions, Trajectory};
use crate::peer::{Framing, Link, ProtocolError};

/// Replies longer than this are rejected.
const LINES: Framing = Framing::Lines { max_bytes: 16 << 20 };

/// Planner after a successful hello exchange.
pub(super) struct Planner {
    link: Link,
}

impl Planner {
    /// Starts or connects to the planner and exchanges hello messages; `step` is the first or resumed step.
    pub(super) fn start(
        spec: &PlannerSpec,
        options: &SimOptions,
        clock: &Clock,
        recorded: &Recorded<'_>,
        step: usize,
    ) -> Result<Self, PlannerError> {
        let link = Link::open("planner", spec, LINES)?;
        let mut planner = Self { link };
        let hello = Hello::new(options, clock, recorded, step);
        planner.ask(&hello, read_hello)?;
        Ok(planner)
    }

    /// Requests a plan that extends to `due_us`, the time of the next one (microseconds).
    pub(super) fn plan(
        &mut self,
        observation: &Observation<'_>,
        now: &Instant,
        due_us: i64,
    ) -> Result<Trajectory, PlannerError> {
        self.ask(observation, |answer| read_plan(answer, now, due_us))
    }

    fn ask<T>(
        &mut self,
        message: &impl Serialize,
        read: impl FnOnce(&[u8]) -> Result<T, ProtocolError>,
    ) -> Result<T, PlannerError> {
        let line = serde_json::to_vec(message).map_err(|error| self.link.cannot_write(error.into()))?;
        let answer = self.link.ask(line)?;
        if let Ok(Failure { error }) = serde_json::from_slice(&answer) {
            let wrong = ProtocolError::new("an answer", format!("the error \"{}\"", printable(&error)));
            return Err(self.link.refuse(wrong));
        }
        read(&answer).map_err(|wrong| self.link.refuse(wrong))
    }
}

/// Answer of a planner that cannot go on.
#[derive(Deserialize)]
struct Failure {
    error: String,
}
