//! External planner process with a protocol of JSON lines, see `docs/PLANNER.md`.

mod protocol;

use std::path::PathBuf;

use serde::Serialize;

pub(super) use self::protocol::{Observation, read_plan};

use self::protocol::{Hello, read_hello};
use super::clock::Clock;
use super::recorded::Recorded;
use super::world::World;
use super::{PlannerError, PlannerSpec, SimOptions, Trajectory};
use crate::peer::{Framing, Link, ProtocolError};

/// Replies longer than this are rejected.
const LINES: Framing = Framing::Lines { max_bytes: 16 << 20 };

/// Planner after a successful hello exchange.
pub(super) struct Planner {
    link: Link,
    shown: Vec<PathBuf>,
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
        let mut planner = Self { link, shown: Vec::new() };
        let hello = Hello::new(options, clock, &recorded.log.name, step);
        planner.ask(&hello, read_hello)?;
        Ok(planner)
    }

    /// Requests a plan for a state.
    pub(super) fn plan(
        &mut self,
        recorded: &Recorded<'_>,
        clock: &Clock,
        world: &World,
    ) -> Result<Trajectory, PlannerError> {
        let now = &world.instant;
        let observation = Observation::new(recorded, clock, world, std::mem::take(&mut self.shown));
        let due_us = clock.at(now.step + clock.steps_per_plan);
        self.ask(&observation, |answer| read_plan(answer, now, due_us))
    }

    fn ask<T>(
        &mut self,
        message: &impl Serialize,
        read: impl FnOnce(&[u8]) -> Result<T, ProtocolError>,
    ) -> Result<T, PlannerError> {
        let line = serde_json::to_vec(message).map_err(|error| self.link.cannot_write(error.into()))?;
        let answer = self.link.ask(line)?;
        read(&answer).map_err(|wrong| self.link.refuse(wrong))
    }

    /// Sets the files sent with the next observation.
    pub(super) fn show(&mut self, files: Vec<PathBuf>) {
        self.shown = files;
    }
}
