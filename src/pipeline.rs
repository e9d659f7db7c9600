//! Frames in flight, and files that another thread writes: the loop of everything that renders many states.
//!
//! # How it works
//! The device renders one state while the host works on the previous one ([`Pipeline`]), and another thread
//! writes the results ([`write_beside`]). Results have the order of the states, and so have the written
//! bytes.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use crate::raster::FRAMES_IN_FLIGHT;
use crate::threads::{ThreadError, spawn_scoped};

/// Frames in flight, each with a tag of the caller, such as its name.
#[derive(Clone, Debug)]
pub struct Pipeline<T> {
    depth: usize,
    in_flight: VecDeque<T>,
}

impl<T> Default for Pipeline<T> {
    fn default() -> Self {
        Self::with_depth(FRAMES_IN_FLIGHT)
    }
}

impl<T> Pipeline<T> {
    /// Creates a pipeline with at most `depth` frames in flight, from 1 to [`FRAMES_IN_FLIGHT`].
    pub fn with_depth(depth: usize) -> Self {
        Self { depth, in_flight: VecDeque::new() }
    }

    /// Begins frames until as many as possible are in flight, then finishes the oldest one and returns it
    /// with its tag. `begin` begins the next frame and returns its tag, or `None` after the last. `begin` and
    /// `finish` receive `device`. Returns `None` if no frame is left.
    ///
    /// # Errors
    /// Returns any error of `begin` and `finish`.
    pub fn next<D: ?Sized, O, E>(
        &mut self,
        device: &mut D,
        mut begin: impl FnMut(&mut D) -> Result<Option<T>, E>,
        finish: impl FnOnce(&mut D, &T) -> Result<O, E>,
    ) -> Result<Option<(T, O)>, E> {
        while self.in_flight.len() < self.depth {
            let Some(tag) = begin(device)? else { break };
            self.in_flight.push_back(tag);
        }
        let Some(tag) = self.in_flight.pop_front() else { return Ok(None) };
        let output = finish(device, &tag)?;
        Ok(Some((tag, output)))
    }
}

/// Runs `produce` while another thread runs `write` with what `produce` sends. At most one item waits. `what`
/// describes the thread in errors, like `the thread that writes maps`. If the thread stops early, sending
/// fails.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Renders frames 0 to 3, with one call that fails. Returns the calls, `b` begins and `f` finishes, and
    /// the result.
    fn run(depth: usize, failing: Option<&str>) -> (Vec<String>, Result<Vec<usize>, String>) {
        let (mut calls, mut frames) = (Vec::new(), 0..4);
        let call = |calls: &mut Vec<String>, name: String| {
            calls.push(name.clone());
            if failing == Some(&*name) { Err(name) } else { Ok(()) }
        };
        let mut pipeline = Pipeline::with_depth(depth);
        let mut finished = Vec::new();
        let result = loop {
            let begin = |calls: &mut Vec<String>| {
                let frame = frames.next();
                frame.map_or(Ok(()), |frame| call(calls, format!("b{frame}")))?;
                Ok(frame)
            };
            let finish = |calls: &mut Vec<String>, frame: &usize| call(calls, format!("f{frame}"));
            match pipeline.next(&mut calls, begin, finish) {
                Ok(Some((frame, ()))) => finished.push(frame),
                Ok(None) => break Ok(finished),
                Err(error) => break Err(error),
            }
        };
        (calls, result)
    }

    #[test]
    fn frames_begin_before_older_ones_are_finished() {
        for (depth, expected) in [(1, "b0 f0 b1 f1 b2 f2 b3 f3"), (2, "b0 b1 f0 b2 f1 b3 f2 f3")] {
            let (calls, result) = run(depth, None);
            assert_eq!((calls.join(" ").as_str(), result), (expected, Ok(vec![0, 1, 2, 3])));
        }
    }

    #[test]
    fn errors_end_the_pipeline() {
        assert_eq!(run(2, Some("b2")).1, Err("b2".to_owned()));
        assert_eq!(
            run(2, Some("f1")),
            (["b0", "b1", "f0", "b2", "f1"].map(str::to_owned).into(), Err("f1".to_owned()))
        );
    }

    #[test]
    fn the_other_thread_receives_everything_in_order() {
        let send = |sender: SyncSender<usize>| (0..100).take_while(|i| sender.send(*i).is_ok()).count();
        let receive = |receiver: Receiver<usize>| receiver.into_iter().collect::<Vec<_>>();
        let (sent, received) = write_beside("a test", receive, send).unwrap();
        assert_eq!((sent, received), (100, (0..100).collect()));
        // A thread that stops ends the sending.
        let stop = |receiver: Receiver<usize>| receiver.into_iter().take(3).count();
        let (sent, received) = write_beside("a test", stop, send).unwrap();
        assert_eq!(received, 3);
        assert!(sent < 100, "{sent}");
    }
}
