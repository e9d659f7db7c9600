use std::path::PathBuf;

use clap::Args;
use point_skeleton::Log;
use point_skeleton::dataset::{
    DatasetError, ImageDistortion, LogLocator, LogOpener, MissingData, ReadOptions, Recording, RingMeaning,
};

use super::names::names;
use crate::{logs, warn};

/// Heading of these options in help texts; set for each, since a heading of the group would also apply to the
/// options after it.
const READING: &str = "Reading of the log";

/// Locations of a data set's parts, and how it is read.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct LogRoots {
    /// Folder of sweeps and images, if not in the data set's usual place
    #[arg(long, help_heading = READING, value_name = "DIR")]
    sensor_root: Option<PathBuf>,
    /// Folder of maps, if not in the data set's usual place
    #[arg(long, help_heading = READING, value_name = "DIR")]
    map_root: Option<PathBuf>,
    /// Also read files outside the data set's folder that it names by absolute paths or by paths with "..":
    /// only for data sets from trusted sources
    #[arg(long, help_heading = READING)]
    allow_outside: bool,
    /// Missing and damaged parts of the log (files, records, boxes without a size): skip and count them, or
    /// fail with the first
    #[arg(long, help_heading = READING, value_parser = names::<MissingData>(), default_value = "skip")]
    missing: MissingData,
    /// What the ring numbers in sweeps count: the beams of one LiDAR, or the LiDARs of a merged sweep. Of
    /// merged LiDARs, moving actors keep only the points of LiDAR 0, whose scan matches their boxes
    #[arg(long, help_heading = READING, value_name = "MEANING")]
    #[arg(value_parser = names::<RingMeaning>(), default_value = "auto")]
    ring_is: RingMeaning,
    /// Whether recorded images have the lens distortion that the calibration states
    #[arg(long, help_heading = READING, value_name = "HOW")]
    #[arg(value_parser = names::<ImageDistortion>(), default_value = "usual")]
    image_distortion: ImageDistortion,
}

/// Argument parser for the name of a log.
pub(crate) fn log(text: &str) -> Result<LogLocator, DatasetError> {
    logs::locate(text)
}

/// Checks that no log is given twice.
#[cfg(feature = "network")]
pub(crate) fn check_once(logs: &[LogLocator]) -> Result<(), crate::WrongUsage> {
    use crate::WrongUsage;
    match logs.iter().enumerate().find(|(place, log)| logs[..*place].contains(log)) {
        None => Ok(()),
        Some((_, log)) => Err(WrongUsage(format!("expected each log once, found {log} again"))),
    }
}

impl LogRoots {
    /// Adds these folders, the permission for outside files and the policy for gaps to the name of a log.
    pub(crate) fn locate(&self, log: &LogLocator) -> LogLocator {
        let (sensor_root, map_root) = (self.sensor_root.clone(), self.map_root.clone());
        let reading =
            ReadOptions { rings: self.ring_is, distortion: self.image_distortion, missing: self.missing };
        LogLocator { sensor_root, map_root, allow_outside: self.allow_outside, reading, ..log.clone() }
    }

    /// Opens a log, and warns if parts of it are missing.
    pub(crate) fn open(&self, log: &LogLocator) -> Result<Log, DatasetError> {
        self.open_by(log, &LogOpener::new())
    }

    /// Opens a log by an opener that may have read tables of it, and warns if parts of it are missing.
    pub(crate) fn open_by(&self, log: &LogLocator, opener: &LogOpener) -> Result<Log, DatasetError> {
        let log = logs::open_by(&self.locate(log), opener)?;
        warn_of_gaps(log.recording());
        Ok(log)
    }
}

/// Warns if parts of a log are missing.
pub(crate) fn warn_of_gaps(log: &Recording) {
    if let Some(first) = log.gaps.first() {
        let more = match log.gaps.len() - 1 {
            0 => String::new(),
            further => format!("; {further} further gaps (`pskel info` names them)"),
        };
        warn(&format!("log {} is incomplete: {first}{more}", log.shown_name()));
    }
}
