use point_skeleton::dataset::{DatasetError, LogLocator};
use point_skeleton::error::FileError;
use pskel_town::{FORMAT, Town, TownOptions};

/// Parses `town:OPTIONS`; `None` for other formats.
pub(super) fn locate(text: &str) -> Option<Result<LogLocator, DatasetError>> {
    let options = text.strip_prefix(FORMAT.name())?.strip_prefix(':')?;
    let town = LogLocator::new(FORMAT, options);
    Some(town_options(&town).map(|_| town))
}

/// Returns whether a locator names the town.
pub(super) fn is_town(locator: &LogLocator) -> bool {
    locator.format == FORMAT
}

/// Opens the built-in synthetic town, which provides ground truth in addition to a log.
///
/// # Errors
/// Fails if the locator has another format, names a folder of sensors or maps, or has invalid options.
pub fn open_town(locator: &LogLocator) -> Result<Town, DatasetError> {
    Ok(Town::new(&town_options(locator)?)?)
}

fn town_options(locator: &LogLocator) -> Result<TownOptions, DatasetError> {
    if locator.format != FORMAT {
        return Err(
            FileError::content("the built-in town (town:OPTIONS)", "another log", &locator.path).into()
        );
    }
    if let Some(root) = locator.sensor_root.as_deref().or(locator.map_root.as_deref()) {
        let found = "a folder of sensors or maps";
        return Err(FileError::content("no folders with the town, which has no files", found, root).into());
    }
    Ok(locator.path.to_string_lossy().parse::<TownOptions>()?)
}
