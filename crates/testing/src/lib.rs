//! What the tests of several crates share: synthetic logs, locations of recordings, and comparators.
//!
//! It has no tests of its own but those of its comparators, and is never a dependency outside of tests.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

#[cfg(feature = "av2")]
pub mod av2_log;
pub mod devices;
pub mod npz;
#[cfg(feature = "nuplan")]
pub mod nuplan_log;
pub mod parity;
pub mod shared;
pub mod tiny_log;
