//! Building of a skeleton from recorded logs.
//!
//! # How it works
//! [`build()`] processes the frames of its logs in order. `stream` reads and colors them within a window that moves
//! along a log. `cells` collects their points by background chunk and by track, and `sums` accumulates them per
//! voxel. `runs` stores these sums on disk. A `checkpoint` every few frames records the progress. At the end, cells
//! are merged one by one into the skeleton. Memory does not grow with the length of the logs (without voxels: except
//! for a cell's points). An interrupted build resumes from its last checkpoint and gives the same bytes.

mod cells;
mod checkpoint;
mod color;
mod finish;
mod runs;
mod stream;
mod sums;

use std::path::{Path, PathBuf};

use self::cells::Cells;
use self::checkpoint::{BuildState, Plan, PlannedLog, Unfinished};
use self::stream::{FrameCloud, Stream};
use self::sums::Voxels;
use super::manifest::{BuildReport, Source};
use super::{BuildOptions, Skeleton, SkeletonWriter, Template};
use crate::cloud::Point;
use crate::dataset::{Dataset, DatasetError};
use crate::error::FileError;
use crate::files::text::printable;

/// Errors of building a skeleton.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The log cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A file of the skeleton or of the unfinished build cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The log has no such frame.
    #[error("expected frames below {frames}, found {found}")]
    Frame {
        /// Number of frames in the log.
        frames: usize,
        /// Requested frame.
        found: usize,
    },
    /// The frames have no sweep.
    #[error("expected frames with a LiDAR sweep, found none in {frames} frames of {}", printable(&logs.join(", ")))]
    NoSweeps {
        /// Number of inspected frames.
        frames: usize,
        /// Names of their logs.
        logs: Vec<String>,
    },
    /// No point has a color.
    #[error(
        "expected at least one point that an image colors, found none in {sweeps} sweeps ({points} points read)"
    )]
    Empty {
        /// Number of sweeps read.
        sweeps: usize,
        /// Number of points read.
        points: usize,
    },
    /// The logs do not share a location, or one occurs twice.
    #[error("expected logs of one place, each once, found {}", printable(&found.join(", ")))]
    Places {
        /// Name and location of each log.
        found: Vec<String>,
    },
    /// The build failed after its first checkpoint and can be resumed.
    #[error("{source}; {frames} frames are done and kept, --resume goes on from there: {}", path.display())]
    Interrupted {
        /// Cause of the failure.
        source: Box<BuildError>,
        /// Number of completed frames.
        frames: usize,
        /// Folder of the unfinished build.
        path: PathBuf,
    },
}

/// Progress callback of a long operation.
pub trait Progress: Sync {
    /// Starts a stage with a number of steps.
    fn start(&self, stage: &str, steps: usize);
    /// Completes a step of the stage.
    fn step(&self);
}

/// Ignores progress.
impl Progress for () {
    fn start(&self, _: &str, _: usize) {}
    fn step(&self) {}
}

/// Frames of a log used in a build.
#[derive(Clone)]
pub struct BuildInput<'a> {
    /// Source log.
    pub dataset: &'a dyn Dataset,
    /// Indices of the frames, in time order. Sweeps, images and boxes of others are ignored.
    pub frames: Vec<usize>,
}

impl<'a> BuildInput<'a> {
    /// Selects all frames of a log.
    pub fn all(dataset: &'a dyn Dataset) -> Self {
        Self { dataset, frames: (0..dataset.log().frames.len()).collect() }
    }
}

/// Function that generates templates from the assets of a skeleton: manifest entries with their points.
pub type GenerateTemplates<'a> =
    dyn Fn(&[(&super::Asset, &[Point])]) -> Result<Vec<(Template, Vec<Point>)>, FileError> + 'a;

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

/// Number of points in memory that triggers a checkpoint before its regular frame.
const MOST_POINTS: usize = 1_000_000;

/// Builds a skeleton from some frames of one or more logs of the same location. The result depends only on the input
/// and the options, not on the number of threads or interruptions. During the build there is a folder named `out`
/// with the suffix `.partial`.
///
/// # Errors
/// Fails if a log or file cannot be read or written, if a frame does not exist, if the logs have different locations
/// or one occurs twice, or if there is no sweep or no colored point. After the first checkpoint, completed frames are
/// retained ([`BuildError::Interrupted`]).
pub fn build(
    out: &Path,
    inputs: &[BuildInput],
    options: &BuildOptions,
    templates: &GenerateTemplates,
    run: &BuildRun,
) -> Result<Skeleton, BuildError> {
    let streams: Vec<Stream> =
        inputs.iter().map(|input| Stream::new(input, options)).collect::<Result<_, _>>()?;
    check_places(&streams)?;
    SkeletonWriter::check_target(out)?;
    let (work, done) = Unfinished::open(out, plan(&streams, options), run.resume)?;
    let cells = Cells::new(Voxels { side_m: options.voxel_m });
    let mut builder = Builder { streams, options, run, work, done, cells, since: 0 };
    let built = builder.gather().and_then(|()| builder.finish(out, templates));
    if let Err(source) = built {
        if matches!(source, BuildError::Empty { .. } | BuildError::NoSweeps { .. }) {
            builder.work.close()?;
            return Err(source);
        }
        if !builder.work.is_kept() {
            return Err(source);
        }
        let (frames, path) = (builder.done.frames, builder.work.path().to_owned());
        return Err(BuildError::Interrupted { source: Box::new(source), frames, path });
    }
    builder.work.close()?;
    Ok(Skeleton::open(out)?)
}

/// Returns the number of completed frames in an unfinished build of `out`; `None` if there is none to resume.
pub fn unfinished_frames(out: &Path) -> Option<usize> {
    Unfinished::frames_done(out)
}

/// Checks that all logs have one location, since they share a global frame, and that none occurs twice.
fn check_places(streams: &[Stream]) -> Result<(), BuildError> {
    let (first, mut names) = (streams.first().map(|s| &s.log.location), Vec::new());
    for stream in streams {
        if Some(&stream.log.location) != first || names.contains(&&stream.log.name) {
            let place = |s: &Stream| format!("{} ({})", s.log.name, s.log.location);
            return Err(BuildError::Places { found: streams.iter().map(place).collect() });
        }
        names.push(&stream.log.name);
    }
    Ok(())
}

fn plan(streams: &[Stream], options: &BuildOptions) -> Plan {
    let log = |stream: &Stream| PlannedLog {
        log: stream.log.name.clone(),
        description: stream.log.description.clone(),
        t_us: stream.frames.iter().map(|f| f.t_us).collect(),
        held: stream.frames.iter().map(|f| [f.sweeps.len(), f.images.len(), f.boxes.len()]).collect(),
        tracks: stream.log.tracks.len(),
    };
    Plan {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        options: options.clone(),
        logs: streams.iter().map(log).collect(),
    }
}

/// Build in progress.
struct Builder<'a> {
    streams: Vec<Stream<'a>>,
    options: &'a BuildOptions,
    run: &'a BuildRun<'a>,
    work: Unfinished,
    /// State of the last checkpoint; later frames are in `cells`.
    done: BuildState,
    cells: Cells,
    /// Number of frames since the checkpoint.
    since: usize,
}

impl Builder<'_> {
    /// Processes all frames that are not completed.
    fn gather(&mut self) -> Result<(), BuildError> {
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
            gathered = stream.run(first, |cloud| self.take_in(number, &cloud, &mut now));
            if gathered.is_err() {
                break;
            }
        }
        self.streams = streams;
        gathered?;
        if self.since > 0 { self.checkpoint(&mut now) } else { Ok(()) }
    }

    /// Adds a frame; updates the counts in `now`.
    fn take_in(&mut self, log: usize, frame: &FrameCloud, now: &mut BuildState) -> Result<(), BuildError> {
        now.frames += 1;
        now.report.images += frame.images;
        for sweep in &frame.sweeps {
            now.report.sweeps += 1;
            now.report.points_read += sweep.read;
            now.report.dropped_not_finite += sweep.not_finite;
            now.report.dropped_ghost += sweep.ghosts;
            now.report.dropped_ego += sweep.ego;
            for track in self.cells.add(log, now.sweeps, sweep, &mut now.report) {
                *now.track_sweeps.entry(track).or_default() += 1;
            }
            now.sweeps += 1;
        }
        self.since += 1;
        self.run.progress.step();
        if self.since >= self.run.checkpoint_frames || self.cells.points >= MOST_POINTS {
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

fn source(stream: &Stream) -> Source {
    let time = |frame: Option<&&crate::dataset::Frame>| frame.map_or(0, |f| f.t_us);
    Source {
        log: stream.log.name.clone(),
        location: stream.log.location.clone(),
        frames: stream.frames.len(),
        t_us: [time(stream.frames.first()), time(stream.frames.last())],
    }
}

/// Adds the notes of logs to a report.
fn with_notes(mut report: BuildReport, streams: &[Stream]) -> BuildReport {
    for (kind, count) in streams.iter().flat_map(|stream| &stream.log.notes) {
        *report.notes.entry(kind.clone()).or_default() += count;
    }
    report
}
