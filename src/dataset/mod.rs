//! Driving logs, independent of their format.
//!
//! A reader converts its raw tables to a lightweight [`Recording`] (poses, calibration, boxes and file paths)
//! and reads sweeps and images on demand. Nothing is dropped silently: a reader counts skipped items in
//! [`Recording::notes`].
//!
//! # What a reader uses
//! - files: `DataRoot` (paths that data names stay below its folder), `json::read`, `read_picture`, `sweeps`
//!   (rows and PCD files to points), `limits` (numbers that readers accept), `clock` (units of times);
//! - skipped parts: `Notes` counts what is left out, a [`Gap`] names a missing part, and
//!   `settle`, the last step of each reader, applies [`MissingData`] to both;
//! - values: `CategoryKind` (words of data sets), `Cuboid::unless_flat`, [`RigCamera`] in the order around
//!   the vehicle, which is the order of maps.
//!
//! A [`Recording`] has frames in order of time, tracks in order of their names, at most one image of a camera
//! per frame, and the frame's own sweep before others.

// Each reader needs only some of the shared helpers.
#![cfg_attr(
    not(all(feature = "nuscenes", feature = "nuplan", feature = "av2", feature = "123d")),
    allow(dead_code, unreachable_pub, unused_imports, reason = "with only some of the readers")
)]

#[cfg(feature = "av2")]
pub mod av2;
mod category;
mod changed_log;
mod clock;
mod edited;
mod edits;
mod lenient;
mod limits;
mod map;
#[cfg(feature = "nuplan")]
pub mod nuplan;
#[cfg(feature = "nuscenes")]
pub mod nuscenes;
mod picture;
#[cfg(feature = "123d")]
pub mod py123d;
mod reading;
mod recording;
mod registry;
mod scenario;
mod summary;
mod sweeps;
#[cfg(feature = "av2")]
mod tables;
mod track_summary;
#[cfg(any(feature = "nuplan", feature = "123d"))]
mod wkb;

pub(crate) use category::CategoryKind;
pub use category::{Class, layout_rgb};
pub use changed_log::ChangedLog;
pub use edits::{ActorEdits, Appearance, EditError, HeldTrack, ReplacedTrack};
pub use map::{Area, Lane, RoadNetwork, VectorMap};
pub use picture::{picture_size, read_picture, undecodable};
pub use reading::{ImageDistortion, ReadOptions, RingMeaning};
pub use recording::ego_track::EgoTrack;
pub(crate) use recording::fingerprint::is_fingerprint;
pub use recording::gaps::{Gap, GapPlace, MissingData};
pub use recording::{
    Frame, ImageRecord, LogOutline, MapFiles, NavigationRoute, Recording, RigCamera, SweepRecord, Track,
    TrackBox, TrafficLight,
};
pub use registry::format::{LogFormat, LogLocator, LogOpener, OpenReader};
pub use registry::{expand, formats, open, register};
pub use scenario::{
    Action, Anchor, Change, Command, EgoWithin, Insert, Path, PathPoint, Place, Script, Shift, Time,
    Triggers, When,
};
pub use summary::{BoxCounts, CameraSummary, EgoPath, LogSummary, MapCounts};
pub use track_summary::TrackSummary;

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::PathBuf;

use crate::error::FileError;
use crate::files::text::{printable, printable_path};
use crate::geometry::{CameraError, Cuboid, CuboidError, PoseError, View};

/// Reader of one log (not of a whole data set): metadata, sweeps, images and map. For a format outside this
/// crate, implement it and pass it to [`Log::new`](crate::Log::new).
pub trait LogReader: Send + Sync {
    /// Returns poses, calibration, boxes and file paths.
    fn recording(&self) -> &Recording;

    /// Reads a sweep. Drops and counts points that are not finite.
    ///
    /// # Errors
    /// Fails if the file is missing or violates its format.
    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError>;

    /// Returns a sweep's point count from its header and size; `None` if the sweep is generated on reading.
    ///
    /// # Errors
    /// Fails as [`LogReader::read_sweep`], except for errors in the points themselves.
    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        self.read_sweep(record).map(|sweep| Some((sweep.points.len() + sweep.dropped_non_finite) as u64))
    }

    /// Reads an image of the size in its record.
    ///
    /// # Errors
    /// Fails if the file is missing, cannot be decoded, or has another size.
    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError>;

    /// Checks that an image exists, is not cut off, and has the size in its record. Only the header is
    /// decoded.
    ///
    /// # Errors
    /// Fails as [`LogReader::read_image`], except for errors in the pixel data.
    fn check_image(&self, record: &ImageRecord) -> Result<(), DatasetError> {
        Ok(check_size(picture_size(&record.path)?, record)?)
    }

    /// Returns the number of LiDAR points per frame and box, in the log's order, as stated by the dataset;
    /// `None` for boxes with an unknown number. `None` if the dataset states none.
    fn box_points(&self) -> Option<&[Vec<Option<u32>>]> {
        None
    }

    /// Reads the HD map of the log's location; `None` if the dataset has none.
    ///
    /// # Errors
    /// Fails if the file violates its format.
    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        Ok(None)
    }

    /// Returns the renderer of ground-truth images from any pose; `None` if the log is recorded.
    fn view_renderer(&self) -> Option<&dyn ViewRenderer> {
        None
    }
}

/// Checks the height and width of an image against its camera.
fn check_size((height, width): (u32, u32), record: &ImageRecord) -> Result<(), FileError> {
    let camera = &record.camera;
    if (height, width) == (camera.height, camera.width) {
        return Ok(());
    }
    let expected = format!("an image of {}x{} pixels", camera.height, camera.width);
    Err(FileError::content(expected, format!("{height}x{width}"), &record.path))
}

/// Renders ground-truth images of a synthetic log from any pose.
pub trait ViewRenderer {
    /// Renders an image per view, in their order. The views' world is the global frame. The actors default to
    /// the log's at that time.
    ///
    /// # Errors
    /// Fails if the log does not contain an actor or if rendering fails.
    fn render_views(
        &self,
        t_us: i64,
        actors: Option<&[PosedActor<'_>]>,
        views: &[View],
    ) -> Result<Vec<image::RgbImage>, DatasetError>;
}

/// Stated number of LiDAR points per frame and box; `None` for an unknown number.
pub(crate) type BoxPoints = Vec<Vec<Option<u32>>>;

/// Actor at a pose that may differ from the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosedActor<'a> {
    /// Track id.
    pub track: &'a str,
    /// Box in the global frame.
    pub cuboid: Cuboid,
}

/// One LiDAR sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sweep {
    /// Points in the LiDAR frame.
    pub points: Vec<SweepPoint>,
    /// Number of points dropped because a coordinate was NaN or infinite.
    pub dropped_non_finite: usize,
    /// Whether [`SweepPoint::ring`] identifies the devices of a merged sweep instead of beams.
    pub devices: bool,
    /// Number of unusual values and of decisions about them, by kind.
    pub notes: BTreeMap<String, usize>,
}

/// One LiDAR return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SweepPoint {
    /// Meters, LiDAR frame.
    pub position: [f32; 3],
    /// Recorded intensity (0–255), 0 if unknown; skeletons do not use it.
    pub intensity: f32,
    /// Beam number, or the device if [`Sweep::devices`].
    pub ring: u16,
}

/// Error of a log.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// Error of a file.
    #[error(transparent)]
    File(#[from] FileError),
    /// Invalid locator of a log.
    #[error(
        "expected a log named FORMAT:PATH[@VERSION][#SCENE] with FORMAT {formats}, or the path of one, found \
            {found:?}"
    )]
    Locator {
        /// Given text.
        found: String,
        /// Formats of this program.
        formats: String,
    },
    /// A path without a format, with files of several ones.
    #[error(
        "expected files of one format, or its name before the path, found those of {names}: {}",
        printable_path(path)
    )]
    SeveralFormats {
        /// Names of the formats.
        names: String,
        /// The path.
        path: PathBuf,
    },
    /// No scene selected among several, or an unknown one.
    #[error("expected #SCENE to name one of {}, found {}: \
        {}", printable(&scenes.join(", ")), printable(found.as_deref().unwrap_or("none")),
        printable_path(path))]
    Scene {
        /// Requested scene.
        found: Option<String>,
        /// Available scenes.
        scenes: Vec<String>,
        /// Folder of the dataset.
        path: PathBuf,
    },
    /// Token without a record.
    #[error(
        "expected {table}.json to hold token {}, found none (referred to by {}): {}",
        printable(token),
        printable(by),
        printable_path(path)
    )]
    DanglingToken {
        /// Table that should contain the record.
        table: &'static str,
        /// The token.
        token: String,
        /// Record that refers to it.
        by: String,
        /// File of the table.
        path: PathBuf,
    },
    /// Invalid pose.
    #[error("{source} in {}: {}", printable(record), printable_path(path))]
    Pose {
        /// Reason.
        source: PoseError,
        /// The record.
        record: String,
        /// The file.
        path: PathBuf,
    },
    /// Invalid camera.
    #[error("{source} in {}: {}", printable(record), printable_path(path))]
    Camera {
        /// Reason.
        source: CameraError,
        /// The record.
        record: String,
        /// The file.
        path: PathBuf,
    },
    /// Invalid box.
    #[error("{source} in {}: {}", printable(record), printable_path(path))]
    Cuboid {
        /// Reason.
        source: CuboidError,
        /// The record.
        record: String,
        /// The file.
        path: PathBuf,
    },
    /// Missing part of a log that was opened with [`MissingData::Error`].
    #[error("expected a log without gaps, found {first}{}", and_further(*further))]
    Missing {
        /// First missing part.
        first: Gap,
        /// Number of further gaps.
        further: usize,
    },
    /// Error while generating a synthetic log.
    #[error(transparent)]
    Synthetic(Box<dyn std::error::Error + Send + Sync>),
}

/// Ends an error about a gap with the number of further ones.
fn and_further(gaps: usize) -> String {
    match gaps {
        0 => String::new(),
        1 => ", and one further gap".to_owned(),
        _ => format!(", and {gaps} further gaps"),
    }
}

impl DatasetError {
    /// Returns whether the data is missing or damaged, as opposed to an error of the operating system
    /// (permissions, a network that is down), after which the data may be there again.
    pub fn is_damage(&self) -> bool {
        match self {
            Self::File(FileError::Io { source, .. }) => {
                matches!(
                    source.kind(),
                    ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::UnexpectedEof
                )
            }
            Self::File(FileError::Content { .. }) => true,
            _ => false,
        }
    }
}
