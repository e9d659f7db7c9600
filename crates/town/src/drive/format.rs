use point_skeleton::dataset::{DatasetError, LogFormat, LogLocator};
use point_skeleton::error::FileError;

use super::Town;
use crate::TownOptions;

/// Format of locators `town:OPTIONS`, whose path has the [`TownOptions`].
/// [`register`](point_skeleton::dataset::register) makes [`Log::open`](point_skeleton::Log::open) know it.
pub static FORMAT: LogFormat = LogFormat {
    name: "town",
    has_path: false,
    rates_hz: [10.0, 5.0],
    detect: |_| false,
    check: |locator| options(locator).map(drop),
    expand: |locator| Ok(vec![locator.clone()]),
    outline: LogFormat::outline_by_opening,
    open: |locator, _| Ok(Box::new(Town::open(locator)?)),
};

impl Town {
    /// Creates the town that a locator names.
    ///
    /// # Errors
    /// Fails if the locator has another format, names a folder of sensors or maps, or has invalid options, or
    /// if the town cannot be created.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        Ok(Self::new(&options(locator)?)?)
    }
}

fn options(locator: &LogLocator) -> Result<TownOptions, DatasetError> {
    if *locator.format != FORMAT {
        let expected = "the built-in town (town:OPTIONS)";
        return Err(FileError::content(expected, "another log", &locator.path).into());
    }
    if let Some(root) = locator.sensor_root.as_deref().or(locator.map_root.as_deref()) {
        let found = "a folder of sensors or maps";
        return Err(FileError::content("no folders with the town, which has no files", found, root).into());
    }
    Ok(locator.path.to_string_lossy().parse::<TownOptions>()?)
}
