//! nuPlan: a log is a SQLite database of tables linked by tokens. Merged sweeps (PCD) and images (JPEG) are
//! in one folder, maps (GeoPackage) in another.
//!
//! # How it works
//! `place` finds the folders and `database` reads checked rows. `frames`, `images` and `annotations` convert
//! them to a [`Recording`], and `map` reads the HD map. Calibration columns are Python pickles; `pickle`
//! decodes only lists of numbers. Format: <https://nuplan-devkit.readthedocs.io>.

mod annotations;
mod clocks;
mod database;
mod frames;
mod images;
mod map;
mod pickle;
mod place;
mod projection;
mod read;
mod routes;
mod situation;

pub use super::sweeps::pcd::{check_pcd_file, parse_pcd, read_pcd_file};

pub use place::{expand, expand_set};

use super::{
    DatasetError, ImageRecord, LogFormat, LogLocator, LogReader, Recording, Sweep, SweepRecord, VectorMap,
    read_picture,
};
use crate::dataset::sweeps::RingDecision;
use crate::dataset::sweeps::pcd::pcd_rows;
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, read_file};

/// One nuPlan log, or one scene of it.
#[derive(Debug)]
pub struct NuPlan {
    log: Recording,
    place: place::LogPaths,
    map_name: String,
    rings: RingDecision,
}

impl NuPlan {
    /// Reads the tables of a log. The path is a `.db` file, and the optional scene is a name or token of its
    /// table `scene`. Or the path is a folder, and the scene names one of its logs; it is optional if there
    /// is only one. Opens no sweeps or images.
    ///
    /// # Errors
    /// Fails if the file is not a log, tables, columns or tokens are missing, or values have a wrong type.
    /// Fails if poses, cameras or boxes are invalid, or times do not increase. Fails if several logs exist
    /// and none is selected, or the scene is unknown.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        let locator = place::single(locator)?;
        let place = place::LogPaths::new(&locator)?;
        let (log, map_name) = read::read(&place, locator.scene.as_deref(), &locator.reading)?;
        Ok(Self { log, place, map_name, rings: RingDecision::new(locator.reading.rings) })
    }
}

/// The format nuPlan: SQLite files.
pub static FORMAT: LogFormat = LogFormat {
    name: "nuplan",
    has_path: true,
    rates_hz: [10.0, 5.0],
    detect: place::has_logs,
    check: LogFormat::unchecked,
    expand,
    outline: LogFormat::outline_by_opening,
    open: |locator, _| Ok(Box::new(NuPlan::open(locator)?)),
};

impl LogReader for NuPlan {
    fn recording(&self) -> &Recording {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        let rows =
            |record: &SweepRecord| pcd_rows(&read_file(&record.path, SWEEP_BYTES)?, |_| None, &record.path);
        Ok(self.rings.read(&self.log, record, rows)?)
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
