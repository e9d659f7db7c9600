//! nuPlan: a log is a SQLite database of tables that refer to each other by token; merged sweeps (PCD) and images
//! (JPEG) lie in a folder, maps (GeoPackage) in another.
//!
//! How it works: `place` finds the folders, `database` reads checked rows, `frames`, `images` and `annotations` turn
//! them into a [`Log`], `map` reads the place's map. Calibration columns are Python pickles, of which `pickle` decodes
//! lists of numbers and nothing else. Format: <https://nuplan-devkit.readthedocs.io>.

mod annotations;
mod database;
mod frames;
mod geometry;
mod images;
mod map;
mod pcd;
mod pickle;
mod place;
mod projection;
mod read;
mod situation;

pub use pcd::{check_pcd_file, parse_pcd, read_pcd_file};
pub use place::SIMGEN;

pub use place::expand;

use crate::error::FileError;

use super::{
    Dataset, DatasetError, ImageRecord, Log, LogLocator, Sweep, SweepRecord, VectorMap, read_picture,
};

/// One nuPlan log, or one scene of it.
#[derive(Debug)]
pub struct NuPlan {
    log: Log,
    place: place::Place,
    map_name: String,
}

impl NuPlan {
    /// Reads the tables of a log. The path is its `.db` file, and the scene a name or token of its table `scene`, if not
    /// all is wanted; or the path is a folder with logs, one of which the scene names, unless there is but one. No sweep
    /// and no image is opened; those that are not there are left out of their frames and counted.
    ///
    /// # Errors
    /// A file that is no log, tables, columns or tokens that are not there, values of a wrong type, poses, cameras or
    /// boxes that are none, times that do not grow; several logs and none chosen, an unknown scene.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        let locator = place::single(locator)?;
        let place = place::Place::new(&locator)?;
        let (log, map_name) = read::read(&place, locator.scene.as_deref())?;
        Ok(Self { log, place, map_name })
    }
}

impl Dataset for NuPlan {
    fn log(&self) -> &Log {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        Ok(read_pcd_file(&record.path)?)
    }

    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        Ok(Some(check_pcd_file(&record.path)?))
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        Ok(read_picture(&record.path, record.camera.height, record.camera.width)?)
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        let Some(folder) = &self.place.maps else { return Ok(None) };
        let map = map::read(folder, &self.map_name, &self.log.location)?;
        if map.is_none() && self.place.needs_map {
            return Err(
                FileError::content(format!("map {}", self.map_name), "none of that name", folder).into()
            );
        }
        Ok(map)
    }
}
