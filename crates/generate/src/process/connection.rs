//! Connection to a network in another process.

use std::sync::{Mutex, PoisonError};

use pskel_sim::peer::{Framing, Link, PeerError, PeerSpec, ProtocolError};

use crate::DenoiserError;

/// Maximum length of an answer, bytes.
pub(crate) const MAX_ANSWER_BYTES: u64 = 1 << 30;

/// Connection to the process, shared with the codec.
pub(super) struct Shared(Mutex<Link>);

impl Shared {
    /// Starts the process or connects to it.
    pub(super) fn open(spec: &PeerSpec) -> Result<Self, PeerError> {
        let link = Link::open("denoiser", spec, Framing::Lengths { max_bytes: MAX_ANSWER_BYTES })?;
        Ok(Self(Mutex::new(link)))
    }

    /// Sends a message and reads the answer.
    pub(super) fn ask<T>(
        &self,
        message: Vec<u8>,
        read: impl FnOnce(&[u8]) -> Result<T, ProtocolError>,
    ) -> Result<T, DenoiserError> {
        // The link stays valid if a thread panicked while holding the lock: it rejects calls after a failure
        // itself.
        let mut link = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = link.ask(message)?;
        Ok(read(&answer).map_err(|wrong| link.refuse(wrong))?)
    }
}
