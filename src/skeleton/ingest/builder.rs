//! Build in progress: adds up frames, with checkpoints.

use super::cells::Cells;
use super::checkpoint::{BuildState, Unfinished};
use super::error::BuildError;
use super::request::BuildRun;
use super::stream::{FrameCloud, Stream};
use crate::skeleton::BuildOptions;

/// Number of points in memory that triggers a checkpoint before its regular frame.
pub(super) const MAX_BUFFERED_POINTS: usize = 1_000_000;

/// Build in progress.
pub(super) struct Builder<'a> {
    pub(super) streams: Vec<Stream<'a>>,
    pub(super) options: &'a BuildOptions,
    pub(super) run: &'a BuildRun<'a>,
    pub(super) work: Unfinished,
    /// State of the last checkpoint; later frames are in `cells`.
    pub(super) done: BuildState,
    pub(super) cells: Cells,
    /// Number of frames since the checkpoint.
    since: usize,
}

impl<'a> Builder<'a> {
    /// Resumes a build from its last checkpoint, or from the start.
    pub(super) fn new(
        streams: Vec<Stream<'a>>,
        options: &'a BuildOptions,
        run: &'a BuildRun<'a>,
        (work, done): (Unfinished, BuildState),
    ) -> Self {
        let cells = Cells::new(options);
        Self { streams, options, run, work, done, cells, since: 0 }
    }

    /// Processes all frames that are not completed.
    pub(super) fn gather(&mut self) -> Result<(), BuildError> {
        let frames: usize = self.streams.iter().map(|s| s.frames.len()).sum();
        self.run.progress.start("read and color frames", frames.saturating_sub(self.done.frames));
        let streams = std::mem::take(&mut self.streams);
        let mut before = 0;
        let mut gathered = Ok(());
        let mut now = BuildState { runs: Vec::new(), ..self.done.clone() };
        for (number, stream) in streams.iter().enumerate() {
            let first = self.done.frames.max(before) - before;
            before += stream.frames.len();
            if first >= stream.frames.len() {
                continue;
            }
            gathered = stream.run(first, self.run.progress, |cloud| self.add_frame(number, &cloud, &mut now));
            if gathered.is_err() {
                break;
            }
        }
        self.streams = streams;
        gathered?;
        if self.since > 0 { self.checkpoint(&mut now) } else { Ok(()) }
    }

    /// Adds a frame; updates the counts in `now`.
    fn add_frame(&mut self, log: usize, frame: &FrameCloud, now: &mut BuildState) -> Result<(), BuildError> {
        now.frames += 1;
        now.report.images += frame.images;
        for (kind, count) in ["damaged sweep files", "damaged image files"].into_iter().zip(frame.damaged) {
            if count > 0 {
                *now.report.notes.entry(kind.to_owned()).or_default() += count;
            }
        }
        for sweep in &frame.sweeps {
            now.report.sweeps += 1;
            now.report.points_read += sweep.read;
            now.report.dropped_not_finite += sweep.not_finite;
            now.report.dropped_ghost += sweep.ghosts;
            now.report.dropped_ego += sweep.ego;
            for (kind, count) in &sweep.notes {
                *now.report.notes.entry(kind.clone()).or_default() += count;
            }
            for track in self.cells.add(log, now.sweeps, sweep, &mut now.report) {
                *now.track_sweeps.entry(track).or_default() += 1;
            }
            now.sweeps += 1;
        }
        self.since += 1;
        self.run.progress.step();
        if self.since >= self.run.checkpoint_frames || self.cells.points >= MAX_BUFFERED_POINTS {
            return self.checkpoint(now);
        }
        Ok(())
    }

    fn checkpoint(&mut self, now: &mut BuildState) -> Result<(), BuildError> {
        now.runs.clone_from(&self.done.runs);
        let cells = self.cells.take();
        self.work.save(now, cells)?;
        self.done = now.clone();
        self.since = 0;
        Ok(())
    }
}
