//! The closed loop: ego and actors move step by step, and every step is a state that conditions are made of.
//!
//! # How it works
//! What has happened is [`Committed`], what is only expected is [`Forecast`]. They are different types, and nothing
//! turns a forecast into something committed.

mod state;

pub use state::{Committed, EgoState, Forecast, Instant, SimActor};
