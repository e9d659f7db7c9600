//! Access to logs of all formats by locator: recorded logs and the synthetic town.

#[cfg(feature = "town")]
mod town;

#[cfg(feature = "town")]
pub use town::open_town;

use point_skeleton::Log;
use point_skeleton::dataset::{self, DatasetError, LogLocator, LogOpener, LogOutline};

/// Formats in error messages.
const FORMATS: &str = if cfg!(feature = "town") {
    "nuscenes, nuplan, nuplan-simgen, av2 or town"
} else {
    "nuscenes, nuplan, nuplan-simgen or av2"
};

/// Parses a log locator, `FORMAT:PATH[@VERSION][#SCENE]` or `town:OPTIONS`. No file is opened.
///
/// # Errors
/// Fails if the text has another form or the town does not support an option.
pub fn locate(text: &str) -> Result<LogLocator, DatasetError> {
    #[cfg(feature = "town")]
    if let Some(town) = town::locate(text) {
        return town;
    }
    text.parse().map_err(|error| match error {
        DatasetError::Locator { found, .. } => DatasetError::Locator { found, formats: FORMATS },
        error => error,
    })
}

/// Returns the logs that a locator refers to, in order: the locator itself unless it names a set of logs.
///
/// # Errors
/// Fails if the set is empty or its index cannot be read.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    #[cfg(feature = "town")]
    if town::is_town(locator) {
        return Ok(vec![locator.clone()]);
    }
    dataset::expand(locator)
}

/// Returns name and length of a log.
///
/// # Errors
/// Fails as [`open`].
pub fn outline(locator: &LogLocator, opener: &LogOpener) -> Result<LogOutline, DatasetError> {
    #[cfg(feature = "town")]
    if town::is_town(locator) {
        return open(locator).map(|town| LogOutline::of(town.recording()));
    }
    opener.outline(locator)
}

/// Opens the log that a locator names.
///
/// # Errors
/// Fails if the locator is invalid. Returns any error of the format's reader.
pub fn open(locator: &LogLocator) -> Result<Log, DatasetError> {
    open_by(locator, &LogOpener::new())
}

/// Opens the log that a locator names, by an opener that may have read tables of it.
///
/// # Errors
/// Fails as [`open`].
pub fn open_by(locator: &LogLocator, opener: &LogOpener) -> Result<Log, DatasetError> {
    #[cfg(feature = "town")]
    if town::is_town(locator) {
        return Ok(Log::new(Box::new(open_town(locator)?)));
    }
    opener.open(locator).map(Log::new)
}

/// Opens a log and returns it with the name of its recording: that of the log, for towns with their options, since skeletons of
/// two recordings of a town differ.
///
/// # Errors
/// Fails as [`open`].
#[cfg(feature = "network")]
pub fn open_recording(locator: &LogLocator) -> Result<(String, Log), DatasetError> {
    #[cfg(feature = "town")]
    if town::is_town(locator) {
        let town = open_town(locator)?;
        return Ok((town.recording_name(), Log::new(Box::new(town))));
    }
    let log = open(locator)?;
    Ok((log.name().to_owned(), log))
}

#[cfg(all(test, feature = "town"))]
mod tests {
    use super::*;
    use pskel_town::FORMAT;

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
