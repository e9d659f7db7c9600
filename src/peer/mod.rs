//! A process beside this one that is asked one message at a time: a planner, a denoiser.
//!
//! # How it works
//! It is a command, spoken to over its standard input and output, or listens at a socket ([`PeerAddress`]). One thread
//! writes and one reads, so that a process that neither reads nor answers is noticed when its time is over. A command is
//! killed, with all that it started in its group, when the link to it is dropped, and when this process ends in any other way.

mod address;
mod connection;
mod error;
mod framing;
mod group;
mod link;

pub use address::{MAX_TIMEOUT_S, PeerAddress, PeerSpec};
pub use error::{PeerError, PeerName};
pub use group::end_all;

pub(crate) use error::{Wrong, begin_of};
pub(crate) use framing::Framing;
pub(crate) use link::Link;
