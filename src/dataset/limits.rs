//! Checks that the readers of data sets have in common.

use std::path::Path;

use super::{DatasetError, LogLocator};
use crate::error::FileError;

/// Maximum distance of a time from 1970, microseconds: a thousand years. Later times are rejected as damaged,
/// so differences of times cannot overflow.
pub(super) const MAX_TIME_US: i64 = 31_557_600_000_000_000;

/// Maximum number of cameras. More are rejected as damaged, since each has an image in every frame.
pub(super) const MAX_CAMERAS: usize = 64;

/// Validates the given folders of sensors and maps.
///
/// # Errors
/// Fails if a folder does not exist or is a file.
pub(super) fn check_roots(locator: &LogLocator) -> Result<(), FileError> {
    for folder in locator.sensor_root.iter().chain(&locator.map_root) {
        let found = std::fs::metadata(folder).map_err(FileError::io("read", folder))?;
        if !found.is_dir() {
            return Err(FileError::content("a folder", "a file", folder));
        }
    }
    Ok(())
}

/// Returns the only one of the logs that a locator refers to; `name` names a log by its path in messages.
///
/// # Errors
/// Fails if there are several logs.
#[cfg(feature = "av2")]
pub(super) fn only_log(
    mut logs: Vec<LogLocator>,
    locator: &LogLocator,
    name: impl Fn(&Path) -> String,
) -> Result<LogLocator, DatasetError> {
    match (logs.pop(), logs.is_empty()) {
        (Some(log), true) => Ok(log),
        (last, _) => {
            let scenes = logs.iter().chain(&last).map(|log| name(&log.path)).collect();
            Err(DatasetError::Scene { found: locator.scene.clone(), scenes, path: locator.path.clone() })
        }
    }
}
