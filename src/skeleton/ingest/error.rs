//! Errors of building a skeleton.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::dataset::{DatasetError, Gap};
use crate::error::FileError;
use crate::files::text::{printable, printable_path};

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
    #[error("expected frames with a LiDAR sweep, found none in {frames} frames of \
        {}{}", printable(&logs.join(", ")), first(gap.as_ref()))]
    NoSweeps {
        /// Number of inspected frames.
        frames: usize,
        /// Names of their logs.
        logs: Vec<String>,
        /// First missing part of the logs.
        gap: Option<Gap>,
    },
    /// No point has a color.
    #[error(
        "expected at least one point that an image colors, found none in {sweeps} sweeps ({points} points \
            read) and {images} images{}",
        listed(notes)
    )]
    Empty {
        /// Number of sweeps read.
        sweeps: usize,
        /// Number of points read.
        points: usize,
        /// Number of images read.
        images: usize,
        /// Numbers of skipped items, by kind.
        notes: BTreeMap<String, usize>,
    },
    /// No point has finite coordinates.
    #[error("expected points with finite coordinates, found none in {sweeps} sweeps ({points} points read)")]
    NotFinite {
        /// Number of sweeps read.
        sweeps: usize,
        /// Number of points read.
        points: usize,
    },
    /// The logs do not share a location, or one occurs twice.
    #[error(
        "expected logs of one place with different names, found {} (name and place of each)",
        printable(&found.join(", "))
    )]
    Places {
        /// Name and location of each log.
        found: Vec<String>,
    },
    /// The progress callback requested a stop.
    #[error("build cancelled")]
    Stopped,
    /// The build failed after its first checkpoint and can be resumed.
    #[error("{source}; {frames} frames are done and retained: {}", printable_path(path))]
    Interrupted {
        /// Cause of the failure.
        source: Box<BuildError>,
        /// Number of completed frames.
        frames: usize,
        /// Folder of the unfinished build.
        path: PathBuf,
    },
}

fn listed(notes: &BTreeMap<String, usize>) -> String {
    let notes: Vec<String> = notes.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    if notes.is_empty() { String::new() } else { printable(&format!(" ({})", notes.join(", "))).into_owned() }
}

fn first(gap: Option<&Gap>) -> String {
    gap.map_or(String::new(), |gap| format!(" ({gap})"))
}
