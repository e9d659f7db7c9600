//! States before the committed one, for planners that observe motion over time.

use std::collections::VecDeque;
use std::path::PathBuf;

use super::actors::ControlledActors;
use super::clock::Clock;
use super::recorded::Recorded;
use super::world::World;

/// Time that a planner sees of the past, microseconds: as for nuPlan's planners, 2 s.
pub(super) const HISTORY_US: i64 = 2_000_000;
/// Maximum number of states, so that a message of many actors stays below the protocol's limit.
const MAX_STATES: usize = 100;

/// A state before the committed one.
pub(super) struct PastState {
    /// Steps since the start; negative before it.
    pub(super) step: i64,
    pub(super) world: World,
    /// Files that show the state.
    pub(super) files: Vec<PathBuf>,
}

/// States before the committed one that no planner has observed yet, oldest first.
#[derive(Default)]
pub(super) struct History {
    states: VecDeque<PastState>,
}

impl History {
    /// Returns the logged states before step 0 that are at most [`HISTORY_US`] before a time, microseconds.
    pub(super) fn before_start(recorded: &Recorded<'_>, clock: &Clock, now_us: i64) -> Self {
        let mut history = Self::default();
        let triggers = recorded.log.script.recorded(recorded.log, clock.start_us);
        for step in 1..=MAX_STATES as i64 {
            let t_us = clock.before_start(step);
            let known = recorded.log.script.known_at(&triggers, t_us);
            let Some(instant) = recorded.instant(0, t_us, &known).filter(|_| now_us - t_us <= HISTORY_US)
            else {
                break;
            };
            let projection = recorded.logged_projection(&instant.ego, t_us);
            let world = World { instant, driven: ControlledActors::default(), projection };
            history.states.push_front(PastState { step: -step, world, files: Vec::new() });
        }
        history
    }

    /// Adds the state before the one at a time, microseconds, and removes those that are too old for it.
    pub(super) fn push(&mut self, world: World, files: Vec<PathBuf>, now_us: i64) {
        let step = world.instant.step as i64;
        self.states.push_back(PastState { step, world, files });
        let is_old = |state: &PastState| now_us - state.world.instant.t_us > HISTORY_US;
        while self.states.len() > MAX_STATES || self.states.front().is_some_and(is_old) {
            self.states.pop_front();
        }
    }

    /// Returns the states, oldest first.
    pub(super) fn states(&self) -> impl Iterator<Item = &PastState> {
        self.states.iter()
    }
}
