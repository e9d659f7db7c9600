use std::collections::VecDeque;

use super::{FRAMES_IN_FLIGHT, FrameMaps, RasterError};

/// Queue of completed frames, for rasterizers that render synchronously in `begin`.
#[derive(Debug, Default)]
pub(super) struct CompletedFrames(VecDeque<FrameMaps<'static>>);

impl CompletedFrames {
    /// Fails if no further frame may be begun.
    pub(super) fn check(&self) -> Result<(), RasterError> {
        if self.0.len() < FRAMES_IN_FLIGHT {
            return Ok(());
        }
        Err(RasterError::TooManyFrames { max: FRAMES_IN_FLIGHT })
    }

    pub(super) fn push(&mut self, frame: FrameMaps<'static>) {
        self.0.push_back(frame);
    }

    pub(super) fn pop(&mut self) -> Result<FrameMaps<'static>, RasterError> {
        self.0.pop_front().ok_or(RasterError::NoFrame)
    }
}
