//! Access to logs of all formats by locator: recorded logs and the built-in synthetic town.

use point_skeleton::dataset::{self, Dataset, DatasetError, LogLocator};
use point_skeleton::error::FileError;
use pskel_town::{FORMAT, Town, TownOptions};

/// Formats in error messages.
const FORMATS: &str = "nuscenes, nuplan, nuplan-simgen, av2 or town";

/// Parses a log locator, `FORMAT:PATH[@VERSION][#SCENE]` or `town:OPTIONS`. No file is opened.
///
/// # Errors
/// Fails if the text has another form or the town does not support an option.
pub fn locate(text: &str) -> Result<LogLocator, DatasetError> {
    match text.strip_prefix(FORMAT.name()).and_then(|rest| rest.strip_prefix(':')) {
        Some(options) => {
            let town = LogLocator::new(FORMAT, options);
            town_options(&town).map(|_| town)
        }
        None => text.parse().map_err(|error| match error {
            DatasetError::Locator { found, .. } => DatasetError::Locator { found, formats: FORMATS },
            error => error,
        }),
    }
}

/// Returns the logs that a locator refers to, in order: the locator itself unless it names a set of logs.
///
/// # Errors
/// Fails if the set is empty or its index cannot be read.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    if locator.format == FORMAT { Ok(vec![locator.clone()]) } else { dataset::expand(locator) }
}

/// Opens the log that a locator names.
///
/// # Errors
/// Fails if the locator is invalid. Returns any error of the format's reader.
pub fn open(locator: &LogLocator) -> Result<Box<dyn Dataset>, DatasetError> {
    if locator.format == FORMAT { Ok(Box::new(open_town(locator)?)) } else { dataset::open(locator) }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_town_is_located_by_options_it_has() {
        assert_eq!(locate("town:seed=3").unwrap().format, FORMAT);
        let message = locate("town:seed=3,color=red").unwrap_err().to_string();
        assert!(message.contains("expected the options") && message.contains("color"), "{message}");
        assert!(locate("nuscenes:a").is_ok() && locate("village:a").is_err());
        assert!(open_town(&locate("nuscenes:a").unwrap()).is_err());
        let rooted = LogLocator { map_root: Some("maps".into()), ..locate("town:").unwrap() };
        assert!(open(&rooted).err().unwrap().to_string().ends_with(": maps"));
    }
}
