//! Building a skeleton from recorded drives.
//!
//! # How it works
//! [`build()`] takes the frames of its logs one after the other: `stream` reads and colors them within a window that
//! moves along a log, `cells` gathers their points by chunk of the background and by track, `sums` adds them up by
//! voxel, `runs` holds on disk what memory need not. Every few frames a `checkpoint` says how far it is. At the end
//! cells are merged one by one into the skeleton. Memory does not grow with the length of the logs (without voxels: but
//! for a cell's points), and an interrupted build goes on from its last checkpoint to the same bytes.

mod cells;
mod checkpoint;
mod color;
mod finish;
mod runs;
mod stream;
mod sums;

use std::path::{Path, PathBuf};

use self::cells::Cells;
use self::checkpoint::{Done, Plan, PlannedLog, Unfinished};
use self::stream::{FrameCloud, Stream};
use self::sums::Voxels;
use super::manifest::{BuildReport, Source};
use super::{BuildOptions, Skeleton, SkeletonWriter, Template};
use crate::cloud::Point;
use crate::dataset::{Dataset, DatasetError};
use crate::error::FileError;
use crate::files::text::printable;

/// Why no skeleton could be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The log.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A file of the skeleton, or of the unfinished build.
    #[error(transparent)]
    File(#[from] FileError),
    /// A frame that the log does not have.
    #[error("expected frames below {frames}, found {found}")]
    Frame {
        /// How many the log has.
        frames: usize,
        /// The one asked for.
        found: usize,
    },
    /// No sweep at all.
    #[error("expected frames with a LiDAR sweep, found none in {frames} frames of {}", printable(&logs.join(", ")))]
    NoSweeps {
        /// Frames looked at.
        frames: usize,
        /// Names of their logs.
        logs: Vec<String>,
    },
    /// Nothing to build from.
    #[error(
        "expected at least one point that an image colors, found none in {sweeps} sweeps ({points} points read)"
    )]
    Empty {
        /// Sweeps read.
        sweeps: usize,
        /// Points read.
        points: usize,
    },
    /// Logs that cannot share a background.
    #[error("expected logs of one place, each once, found {}", printable(&found.join(", ")))]
    Places {
        /// Name and place of each.
        found: Vec<String>,
    },
    /// It failed on the way; what was done is kept.
    #[error("{source}; {frames} frames are done and kept, --resume goes on from there: {}", path.display())]
    Interrupted {
        /// What went wrong.
        source: Box<BuildError>,
        /// Frames that are done.
        frames: usize,
        /// The unfinished build.
        path: PathBuf,
    },
}

/// Hears how far a long work is.
pub trait Progress: Sync {
    /// A stage of so many steps begins.
    fn start(&self, stage: &str, steps: usize);
    /// One of its steps is done.
    fn step(&self);
}

/// Silence.
impl Progress for () {
    fn start(&self, _: &str, _: usize) {}
    fn step(&self) {}
}

/// Frames of a log.
#[derive(Clone)]
pub struct BuildInput<'a> {
    /// The log.
    pub dataset: &'a dyn Dataset,
    /// Numbers of the frames, in time order. Sweeps, images and boxes of others are not looked at.
    pub frames: Vec<usize>,
}

impl<'a> BuildInput<'a> {
    /// All frames of a log.
    pub fn all(dataset: &'a dyn Dataset) -> Self {
        Self { dataset, frames: (0..dataset.log().frames.len()).collect() }
    }
}

/// Makes templates from the assets of a skeleton: their entries in the manifest, with their points.
pub type MakeTemplates<'a> =
    dyn Fn(&[(&super::Asset, &[Point])]) -> Result<Vec<(Template, Vec<Point>)>, FileError> + 'a;

/// How a build is run; none of it changes the skeleton.
#[derive(Clone, Copy)]
pub struct BuildRun<'a> {
    /// Go on with an unfinished build of the same logs, frames and options, if there is one.
    pub resume: bool,
    /// Frames from one checkpoint to the next.
    pub checkpoint_frames: usize,
    /// Hears how far it is.
    pub progress: &'a dyn Progress,
}

impl Default for BuildRun<'_> {
    fn default() -> Self {
        Self { resume: false, checkpoint_frames: 20, progress: &() }
    }
}

/// Points in memory from which on they are written out, frames or not.
const MOST_POINTS: usize = 1_000_000;

/// Builds a skeleton from some frames of one or more logs of one place. The result depends on the input and the
/// options alone, not on the number of threads, nor on how often it was interrupted. While it is at work there is a
/// folder `out` with `.partial` behind its name.
///
/// # Errors
/// What a log's reader finds wrong, an unknown frame, logs of several places, no point that an image colors, and what
/// the system says about files. After the first checkpoint what was done is kept ([`BuildError::Interrupted`]).
pub fn build(
    out: &Path,
    inputs: &[BuildInput],
    options: &BuildOptions,
    templates: &MakeTemplates,
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

/// How many frames of an unfinished build of `out` are done; `None` if there is none to go on with.
pub fn unfinished_frames(out: &Path) -> Option<usize> {
    Unfinished::frames_done(out)
}

/// A background stands in the frame of one place.
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

/// A build at work.
struct Builder<'a> {
    streams: Vec<Stream<'a>>,
    options: &'a BuildOptions,
    run: &'a BuildRun<'a>,
    work: Unfinished,
    /// What the checkpoint says; the frames since are in `cells`.
    done: Done,
    cells: Cells,
    /// Frames since the checkpoint.
    since: usize,
}

impl Builder<'_> {
    /// Takes in all frames that are not done.
    fn gather(&mut self) -> Result<(), BuildError> {
        let frames: usize = self.streams.iter().map(|s| s.frames.len()).sum();
        self.run.progress.start("read and color frames", frames.saturating_sub(self.done.frames));
        let streams = std::mem::take(&mut self.streams);
        let mut before = 0;
        let mut gathered = Ok(());
        let mut now = Done { runs: Vec::new(), ..self.done.clone() };
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

    /// Adds a frame; `now` counts it.
    fn take_in(&mut self, log: usize, frame: &FrameCloud, now: &mut Done) -> Result<(), BuildError> {
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

    fn checkpoint(&mut self, now: &mut Done) -> Result<(), BuildError> {
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

/// Adds the notes of logs.
fn with_notes(mut report: BuildReport, streams: &[Stream]) -> BuildReport {
    for (kind, count) in streams.iter().flat_map(|stream| &stream.log.notes) {
        *report.notes.entry(kind.clone()).or_default() += count;
    }
    report
}
