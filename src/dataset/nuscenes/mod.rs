//! nuScenes: 13 JSON tables that refer to each other by token, with LiDAR sweeps and camera images beside them.
//!
//! How it works: `tables` holds the raw records, `read` turns those of one scene into a [`Log`], `sweep` reads and
//! writes `.pcd.bin` files. Format: <https://www.nuscenes.org/nuscenes#data-format>.

mod annotations;
mod choose;
mod frames;
mod read;
mod sweep;
mod tables;
mod write;

pub use sweep::{POINT_BYTES, check_sweep_len, parse_sweep, read_sweep_file, write_sweep_file};

pub use write::write_log;

use super::{Dataset, DatasetError, ImageRecord, Log, LogLocator, Sweep, SweepRecord, read_picture};
use crate::error::FileError;

/// One scene of a nuScenes data set.
#[derive(Debug)]
pub struct NuScenes {
    log: Log,
    box_points: Vec<Vec<u32>>,
}

impl NuScenes {
    /// Reads the tables in `PATH/VERSION`. Without a version the only `v1.0-*` folder is taken, without a scene
    /// the only scene. No sweep and no image is opened.
    ///
    /// # Errors
    /// Tables that are missing or damaged, tokens that lead nowhere, poses, cameras or boxes that are none, times
    /// that do not grow; versions or scenes to choose from and none chosen.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        let tables = choose::version_folder(&locator.path, locator.version.as_deref())?;
        let (log, box_points) = read::read(&locator.path, &tables, locator.scene.as_deref())?;
        Ok(Self { log, box_points })
    }
}

impl Dataset for NuScenes {
    fn log(&self) -> &Log {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        Ok(read_sweep_file(&record.path)?)
    }

    fn check_sweep(&self, record: &SweepRecord) -> Result<u64, DatasetError> {
        let path = &record.path;
        let bytes = std::fs::metadata(path).map_err(FileError::io("read", path))?.len();
        Ok(check_sweep_len(bytes, path)?)
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        Ok(read_picture(&record.path, record.camera.height, record.camera.width)?)
    }

    fn box_points(&self) -> Option<&[Vec<u32>]> {
        Some(&self.box_points)
    }
}
