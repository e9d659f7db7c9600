//! Timed changes of actors: they appear, vanish, move, or follow a path from a time or an event on.
//!
//! # How it works
//! [`Change`] is the form in files (`docs/src/reference/scenarios.md`). `resolve` checks the changes against
//! a log and places them in its global frame; the result is a [`Script`]. Where an actor is at a time is a
//! pure function of the script, the time, and the times at which conditions were met ([`Triggers`]). A log
//! meets them with its recorded ego; a simulation with its own, step by step, so both agree while the ego
//! follows the log, and a saved simulation resumes with its triggers alone.

mod apply;
mod change;
mod ground;
mod motion;
mod place;
mod resolve;
mod script;
#[cfg(test)]
mod tests;
mod triggers;

pub(super) use apply::apply;
pub use change::{Action, Anchor, Change, EgoWithin, Insert, Path, PathPoint, Place, Shift, Time, When};
pub use script::{Command, Script};
pub use triggers::Triggers;
