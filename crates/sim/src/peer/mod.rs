//! Request-response link to an external process, such as a planner or a denoiser.
//!
//! # How it works
//! The peer is a command that communicates over its standard input and output, or a process that listens on a
//! socket ([`PeerAddress`]). One thread writes and one reads, so that a process that neither reads nor
//! answers is noticed when the time-out expires. A command is killed, with all processes in its group, when
//! the link to it is dropped and when this process ends in any other way.

mod address;
mod connection;
mod error;
mod framing;
mod group;
mod link;

pub use address::{MAX_TIMEOUT_S, PeerAddress, PeerSpec};
pub use error::{PeerError, PeerName, ProtocolError, begin_of};
pub use framing::Framing;
pub use group::end_all;
pub use link::Link;
