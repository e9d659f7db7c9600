use std::path::PathBuf;

use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
use point_skeleton::dataset::{
    Dataset, DatasetError, ImageDistortion, LogLocator, LogOpener, ReadOptions, RingMeaning,
};
use point_skeleton::files::resolved_output;

use crate::{choices, logs};

/// Locations of the parts of a data set.
#[derive(Clone, Debug, Default, Args)]
pub(super) struct LogRoots {
    /// Folder of sweeps and images, if not in the data set's usual place
    #[arg(long, value_name = "DIR")]
    sensor_root: Option<PathBuf>,
    /// Folder of maps, if not in the data set's usual place
    #[arg(long, value_name = "DIR")]
    map_root: Option<PathBuf>,
    /// Also read files outside the data set's folder that it names by absolute paths or by paths with "..": only for
    /// data sets from trusted sources
    #[arg(long)]
    allow_outside: bool,
    /// What the ring numbers of sweeps are. Points of other LiDARs than number 0 on moving actors are dropped
    #[arg(long, value_name = "MEANING", value_parser = choices::RING_MEANING, default_value = "auto")]
    ring_is: RingMeaning,
    /// Whether recorded images have the lens distortion that the calibration states
    #[arg(long, value_name = "HOW", value_parser = choices::IMAGE_DISTORTION, default_value = "usual")]
    image_distortion: ImageDistortion,
}

/// Argument parser for the name of a log.
pub(super) fn log(text: &str) -> Result<LogLocator, DatasetError> {
    logs::locate(text)
}

/// Argument parser for an output folder.
pub(super) fn output_folder() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().map(resolved_output)
}

/// Checks that no log is given twice.
#[cfg(feature = "network")]
pub(super) fn check_once(logs: &[LogLocator]) -> Result<(), super::WrongUsage> {
    use super::WrongUsage;
    match logs.iter().enumerate().find(|(place, log)| logs[..*place].contains(log)) {
        None => Ok(()),
        Some((_, log)) => Err(WrongUsage(format!("expected each log once, found {log} again"))),
    }
}

impl LogRoots {
    /// Adds these folders and the permission for outside files to the name of a log.
    pub(super) fn locate(&self, log: &LogLocator) -> LogLocator {
        let (sensor_root, map_root) = (self.sensor_root.clone(), self.map_root.clone());
        let reading = ReadOptions { rings: self.ring_is, distortion: self.image_distortion };
        LogLocator { sensor_root, map_root, allow_outside: self.allow_outside, reading, ..log.clone() }
    }

    /// Opens a log.
    pub(super) fn open(&self, log: &LogLocator) -> Result<Box<dyn Dataset>, DatasetError> {
        logs::open(&self.locate(log))
    }

    /// Opens a log by an opener that may have read tables of it.
    pub(super) fn open_by(
        &self,
        log: &LogLocator,
        opener: &LogOpener,
    ) -> Result<Box<dyn Dataset>, DatasetError> {
        logs::open_by(&self.locate(log), opener)
    }
}
