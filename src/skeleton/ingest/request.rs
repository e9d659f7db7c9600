//! Request of a build: input frames, execution options.

use crate::dataset::LogReader;
use crate::memory::Available;

/// Frames of a log used in a build.
#[derive(Clone)]
pub struct BuildInput<'a> {
    /// Source log.
    pub reader: &'a dyn LogReader,
    /// Indices of the frames, in time order. Sweeps, images and boxes of others are ignored.
    pub frames: Vec<usize>,
}

impl<'a> BuildInput<'a> {
    /// Selects all frames of a log.
    pub fn all(reader: &'a dyn LogReader) -> Self {
        Self { reader, frames: (0..reader.recording().frames.len()).collect() }
    }
}

/// Execution options of a build; they do not affect the skeleton.
#[derive(Clone, Copy)]
pub struct BuildRun<'a> {
    /// Resumes an unfinished build of the same logs, frames and options, if there is one.
    pub resume: bool,
    /// Number of frames between checkpoints.
    pub checkpoint_frames: usize,
    /// Progress callback.
    pub progress: &'a dyn Progress,
}

impl Default for BuildRun<'_> {
    fn default() -> Self {
        Self { resume: false, checkpoint_frames: 20, progress: &() }
    }
}

/// What a build needs at most: as if every point had a color and a voxel of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildNeeds {
    /// Number of sweeps.
    pub sweeps: usize,
    /// Number of points, estimated from a frame of each log.
    pub points: u64,
    /// Size of the skeleton, bytes.
    pub skeleton_bytes: u64,
    /// Disk space during the build, bytes: the skeleton and intermediate files.
    pub disk_bytes: u64,
    /// Free disk space, bytes; `None` if the system does not say.
    pub free_bytes: Option<u64>,
    /// Memory in addition to the opened logs, bytes: it does not depend on the number of frames.
    pub memory_bytes: u64,
    /// Available memory.
    pub available: Available,
}

/// Progress callback of a long operation.
pub trait Progress: Sync {
    /// The operation is about to start. The function estimates what it needs, which takes a moment.
    fn needs(&self, _estimate: &dyn Fn() -> BuildNeeds) {}
    /// Starts a stage with a number of steps.
    fn start(&self, stage: &str, steps: usize);
    /// Completes a step of the stage.
    fn step(&self);
    /// A damaged file was skipped; the message names it. A resumed build may report files again.
    fn skipped(&self, _message: &str) {}
    /// Returns whether to stop before the next step.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// Ignores progress.
impl Progress for () {
    fn start(&self, _: &str, _: usize) {}
    fn step(&self) {}
}
