//! Frames in flight, and files that another thread writes: the loop of everything that renders many states.
//!
//! # How it works
//! The device renders one state while the host works on the previous one ([`Pipeline`]), and another thread writes the
//! results ([`write_beside`]). The order of the results is that of the states, and so are the bytes that are written.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use crate::raster::FRAMES_IN_FLIGHT;
use crate::threads::{ThreadError, spawn_scoped};

/// Frames in flight, each with a tag of the caller, such as its name.
#[derive(Clone, Debug)]
pub struct Pipeline<T> {
    depth: usize,
    begun: VecDeque<T>,
}

impl<T> Default for Pipeline<T> {
    fn default() -> Self {
        Self::with_depth(FRAMES_IN_FLIGHT)
    }
}

impl<T> Pipeline<T> {
    /// Creates a pipeline with at most `depth` frames in flight, from 1 to [`FRAMES_IN_FLIGHT`].
    pub fn with_depth(depth: usize) -> Self {
        Self { depth, begun: VecDeque::new() }
    }

    /// Begins frames until as many as possible are in flight, then finishes the oldest one and returns it with its tag.
    /// `begin` begins the next frame and returns its tag, or `None` after the last. `begin` and `finish` receive `device`.
    /// Returns `None` if no frame is left.
    ///
    /// # Errors
    /// Returns any error of `begin` and `finish`.
    pub fn next<D: ?Sized, O, E>(
        &mut self,
        device: &mut D,
        mut begin: impl FnMut(&mut D) -> Result<Option<T>, E>,
        finish: impl FnOnce(&mut D, &T) -> Result<O, E>,
    ) -> Result<Option<(T, O)>, E> {
        while self.begun.len() < self.depth {
            let Some(tag) = begin(device)? else { break };
            self.begun.push_back(tag);
        }
        let Some(tag) = self.begun.pop_front() else { return Ok(None) };
        let output = finish(device, &tag)?;
        Ok(Some((tag, output)))
    }
}

/// Runs `produce` while another thread runs `write` with what `produce` sends. At most one item waits. `what` describes
/// the thread in errors, like `the thread that writes maps`. If the thread stops early, sending fails.
///
/// # Errors
/// Fails if the thread cannot be started.
pub fn write_beside<I: Send, P, W: Send>(
    what: &str,
    write: impl FnOnce(Receiver<I>) -> W + Send,
    produce: impl FnOnce(SyncSender<I>) -> P,
) -> Result<(P, W), ThreadError> {
    std::thread::scope(|scope| {
        let (sender, receiver) = sync_channel(1);
        let writer = spawn_scoped(scope, what, move || write(receiver))?;
        let produced = produce(sender);
        match writer.join() {
            Ok(written) => Ok((produced, written)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}
