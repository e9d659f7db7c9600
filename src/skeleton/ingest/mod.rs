//! Building of a skeleton from recorded logs.
//!
//! # How it works
//! [`build()`] processes the frames of its logs in order. `stream` reads and colors them within a window that
//! moves along a log. `cells` collects their points by background chunk and by track, and `sums` accumulates
//! them per voxel. `runs` stores these sums on disk. A `checkpoint` every few frames records the progress. At
//! the end, cells are merged one by one into the skeleton. Memory does not grow with the length of the logs
//! (without voxels: except for a cell's points). An interrupted build resumes from its last checkpoint and
//! gives the same bytes.

mod blocks;
mod builder;
mod cells;
mod checkpoint;
mod color;
mod error;
mod finish;
mod needs;
pub(super) mod occlusion;
pub(super) mod projector;
mod request;
mod runs;
pub(super) mod split;
mod stream;
mod sums;
pub(super) mod sweep;

pub use error::BuildError;
pub use request::{BuildInput, BuildNeeds, BuildRun, Progress};

use std::path::Path;

use self::builder::Builder;
use self::checkpoint::{Plan, PlannedLog, Unfinished};
use self::stream::Stream;
use super::{BuildOptions, GenerateTemplates, Manifest, Skeleton, SkeletonWriter};
use crate::dataset::LogReader;
use crate::files::Inputs;
use crate::files::input::is_taken;

/// Builds a skeleton from some frames of one or more logs of the same location. The result depends only on
/// the input and the options, not on the number of threads or interruptions. During the build there is a
/// folder named `out` with the suffix `.partial`.
///
/// # Errors
/// Fails if a log or file cannot be read or written, if a frame does not exist, if the logs have different
/// locations or one occurs twice, or if there is no sweep or no colored point. After the first checkpoint,
/// completed frames are retained ([`BuildError::Interrupted`]).
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
    SkeletonWriter::check_target(out, &Inputs::default())?;
    run.progress.needs(&|| needs::estimate(&streams, out));
    let work = Unfinished::open(out, plan(&streams, options), run.resume)?;
    let mut builder = Builder::new(streams, options, run, work);
    let built = builder.gather().and_then(|()| builder.finish(out, templates));
    if let Err(source) = built {
        if matches!(
            source,
            BuildError::Empty { .. } | BuildError::NoSweeps { .. } | BuildError::NotFinite { .. }
        ) {
            builder.work.close()?;
            return Err(source);
        }
        if !builder.work.is_retained() {
            return Err(source);
        }
        let (frames, path) = (builder.done.frames, builder.work.path().to_owned());
        return Err(BuildError::Interrupted { source: Box::new(source), frames, path });
    }
    builder.work.close()?;
    Ok(Skeleton::open(out)?)
}

/// Opens the skeleton of a whole log. If there is no such folder, builds it first, with default options.
///
/// # Errors
/// Fails if the skeleton is damaged or of another recording, even of one with the same name. Returns any
/// error of [`build()`].
pub fn open_or_build(path: &Path, reader: &dyn LogReader) -> Result<Skeleton, BuildError> {
    if !is_free(path) {
        let skeleton = Skeleton::open_for(path, reader.recording())?;
        skeleton.check_recording(reader.recording())?;
        Unfinished::remove_leftovers(path);
        return Ok(skeleton);
    }
    let options = BuildOptions::default();
    build(path, &[BuildInput::all(reader)], &options, &|_| Ok(Vec::new()), &BuildRun::default())
}

/// Returns whether a path has nothing or an empty folder, like a mount point.
fn is_free(path: &Path) -> bool {
    match std::fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_none(),
        Err(_) => !is_taken(path),
    }
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
        recording: stream.log.fingerprint(),
        t_us: stream.frames.iter().map(|f| f.t_us).collect(),
        reading: stream.log.reading.names().into_iter().map(str::to_owned).collect(),
    };
    Plan {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        format: Manifest::VERSION,
        options: options.clone(),
        logs: streams.iter().map(log).collect(),
    }
}
