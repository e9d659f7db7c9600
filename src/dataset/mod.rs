//! Recorded drives, whatever their format.
//!
//! A reader turns its raw tables into one [`Log`] (light: poses, calibration, boxes and where the files are) and
//! reads sweeps and images on demand. Nothing is dropped in silence: a reader counts what it left out in
//! [`Log::notes`].

pub mod av2;
mod category;
mod ego_track;
mod locator;
mod log;
mod map;
pub mod nuplan;
pub mod nuscenes;
mod picture;

pub use category::{Class, layout_rgb};
pub use ego_track::EgoTrack;
pub use locator::{LogFormat, LogLocator};
pub use log::{Frame, ImageRecord, Log, RigCamera, SweepRecord, Track, TrackBox, TrafficLight};
pub use map::{Area, Lane, VectorMap};
pub use picture::{picture_size, read_picture};

use std::path::PathBuf;

use crate::error::FileError;
use crate::files::text::{printable, printable_path};
use crate::geometry::{CameraError, CuboidError, PoseError};

/// Times further from 1970 are a mistake, microseconds: a thousand years. So no difference of two overflows.
const MAX_TIME_US: i64 = 31_557_600_000_000_000;

/// More cameras are a mistake: each has an image in every frame.
const MAX_CAMERAS: usize = 64;

/// A drive on disk.
pub trait Dataset: Sync {
    /// Poses, calibration, boxes, and where the files are.
    fn log(&self) -> &Log;

    /// Reads a sweep; points that are not finite are left out and counted.
    ///
    /// # Errors
    /// A file that is missing or not as its format says.
    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError>;

    /// Number of points of a sweep by its header and size; `None` for one that is made when it is read.
    ///
    /// # Errors
    /// As [`Dataset::read_sweep`], but for what stands in the points.
    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        self.read_sweep(record).map(|sweep| Some((sweep.points.len() + sweep.dropped_non_finite) as u64))
    }

    /// Reads an image; its size is as the record says.
    ///
    /// # Errors
    /// A file that is missing, does not decode, or has another size.
    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError>;

    /// Whether an image is there and has the size that its record says, by its header alone.
    ///
    /// # Errors
    /// As [`Dataset::read_image`], but for what stands in the pixels.
    fn check_image(&self, record: &ImageRecord) -> Result<(), DatasetError> {
        let camera = &record.camera;
        let (height, width) = picture_size(&record.path)?;
        if (height, width) == (camera.height, camera.width) {
            return Ok(());
        }
        let expected = format!("an image of {}x{} pixels", camera.height, camera.width);
        Err(FileError::content(expected, format!("{height}x{width}"), &record.path).into())
    }

    /// Per frame and box, in the log's order, how many LiDAR points the data set states to lie in the box; `None`
    /// if it states nothing.
    fn box_points(&self) -> Option<&[Vec<u32>]> {
        None
    }

    /// Reads the HD map of the log's place; `None` where the data set has none for it.
    ///
    /// # Errors
    /// A file that is not as its format says.
    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        Ok(None)
    }
}

/// One LiDAR sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sweep {
    /// In the LiDAR frame.
    pub points: Vec<SweepPoint>,
    /// Points left out since a coordinate was NaN or infinite.
    pub dropped_non_finite: usize,
    /// Whether the points of several merged LiDARs are told apart by [`SweepPoint::ring`], rather than beams.
    pub devices: bool,
}

/// One LiDAR return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SweepPoint {
    /// Metres, LiDAR frame.
    pub position: [f32; 3],
    /// As recorded (0–255).
    pub intensity: f32,
    /// Beam number, or the device if [`Sweep::devices`].
    pub ring: u16,
}

/// What can be wrong with a recorded drive.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file.
    #[error(transparent)]
    File(#[from] FileError),
    /// A log's name.
    #[error("expected a log named FORMAT:PATH[@VERSION][#SCENE] with FORMAT {formats}, found {found:?}")]
    Locator {
        /// What was given.
        found: String,
        /// Known formats.
        formats: &'static str,
    },
    /// Several scenes and none chosen, or an unknown one.
    #[error("expected #SCENE to name one of {}, found {}: {}", printable(&scenes.join(", ")), printable(found.as_deref().unwrap_or("none")), printable_path(path))]
    Scene {
        /// What was asked for.
        found: Option<String>,
        /// What there is.
        scenes: Vec<String>,
        /// The data set's folder.
        path: PathBuf,
    },
    /// A token that leads nowhere.
    #[error(
        "expected {table}.json to hold token {}, found none (referred to by {}): {}",
        printable(token),
        printable(by),
        printable_path(path)
    )]
    DanglingToken {
        /// Table that should hold it.
        table: &'static str,
        /// The token.
        token: String,
        /// The record that names it.
        by: String,
        /// The table's file.
        path: PathBuf,
    },
    /// A pose that is none.
    #[error("{source} in {}: {}", printable(record), printable_path(path))]
    Pose {
        /// What is off.
        source: PoseError,
        /// The record.
        record: String,
        /// The file.
        path: PathBuf,
    },
    /// A camera that is none.
    #[error("{source} in {}: {}", printable(record), printable_path(path))]
    Camera {
        /// What is off.
        source: CameraError,
        /// The record.
        record: String,
        /// The file.
        path: PathBuf,
    },
    /// A box that is none.
    #[error("{source} in {}: {}", printable(record), printable_path(path))]
    Cuboid {
        /// What is off.
        source: CuboidError,
        /// The record.
        record: String,
        /// The file.
        path: PathBuf,
    },
    /// A log that is made rather than read: what went wrong at making it.
    #[error(transparent)]
    Made(Box<dyn std::error::Error + Send + Sync>),
}
