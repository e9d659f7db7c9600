//! Argoverse 2 sensor logs: one folder per log with Feather files (boxes, poses, calibration, sweeps),
//! images, and a JSON map.
//!
//! # How it works
//! `read` combines the tables of a log. `sweep` and `map` read their
//! files on demand. A frame is an annotated time; its sweep is the file with the same time, its images are
//! the nearest in time. Times are nanoseconds in files and whole microseconds in a [`Recording`]. Format:
//! <https://argoverse.github.io/user-guide/datasets/sensor.html>.

mod annotations;
mod calibration;
mod choose;
mod map;
mod poses;
mod read;
mod sensors;
mod sweep;

pub use map::read_map_file;
pub use sweep::read_sweep_file;
#[cfg(feature = "123d")]
pub(super) use sweep::{declared_points, read_as as read_sweep_as};

use std::path::PathBuf;

use super::limits::check_roots;
use super::{
    DatasetError, ImageRecord, LogFormat, LogLocator, LogReader, Recording, RingMeaning, Sweep, SweepRecord,
    VectorMap, read_picture,
};
use crate::error::FileError;

/// One Argoverse 2 log.
#[derive(Debug)]
pub struct Argoverse {
    log: Recording,
    box_points: Vec<Vec<Option<u32>>>,
    /// Map files; only the first is read.
    maps: Vec<PathBuf>,
    /// Folder that must contain a map, because it was given explicitly.
    needs_map: Option<PathBuf>,
    rings: RingMeaning,
}

impl Argoverse {
    /// Reads the tables of a log: the folder itself, or the log `#LOG_ID` in it. Opens no sweeps, images or
    /// maps.
    ///
    /// # Errors
    /// Fails if the folder is not a log, or contains several and none is selected. Fails if tables are
    /// missing or damaged, poses, cameras or boxes are invalid, or times do not increase.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        check_roots(locator)?;
        let chosen = choose::choose(locator)?;
        let folder = &chosen.path;
        let sensors = choose::part(folder, chosen.sensor_root.as_deref(), "sensors");
        let map_folder = choose::part(folder, chosen.map_root.as_deref(), "map");
        let maps = map::find(&map_folder)?;
        let city = map::city(maps.first().map(PathBuf::as_path));
        let (log, box_points) =
            read::read(folder, &sensors, choose::log_name(folder), city, &chosen.reading)?;
        let needs_map = chosen.map_root.as_ref().map(|_| map_folder);
        Ok(Self { log, box_points, maps, needs_map, rings: chosen.reading.rings })
    }
}

/// Returns the logs that a locator refers to, sorted by name: the folder itself, the logs in it, or
/// `#LOG_ID`.
///
/// # Errors
/// Fails if the folder cannot be read or has no logs, `#LOG_ID` is unknown, or an `@VERSION` is given.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    choose::expand(locator)
}

/// The format Argoverse 2: folders of logs.
pub static FORMAT: LogFormat = LogFormat {
    name: "av2",
    has_path: true,
    rates_hz: [10.0, 5.0],
    detect: choose::has_logs,
    check: LogFormat::unchecked,
    expand,
    outline: LogFormat::outline_by_opening,
    open: |locator, _| Ok(Box::new(Argoverse::open(locator)?)),
};

impl LogReader for Argoverse {
    fn recording(&self) -> &Recording {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        Ok(sweep::read_as(&record.path, self.rings)?)
    }

    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        Ok(Some(sweep::declared_points(&record.path)?))
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        Ok(read_picture(&record.path, record.camera.height, record.camera.width)?)
    }

    fn box_points(&self) -> Option<&[Vec<Option<u32>>]> {
        Some(&self.box_points)
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        let Some((path, others)) = self.maps.split_first() else {
            let none =
                |folder: &PathBuf| FileError::content("a map (log_map_archive_*.json)", "none", folder);
            return self.needs_map.as_ref().map_or(Ok(None), |folder| Err(none(folder).into()));
        };
        let mut map = map::read_map_file(path, &self.log.location)?;
        if !others.is_empty() {
            map.notes.insert("further map files".to_owned(), others.len());
        }
        Ok(Some(map))
    }
}
