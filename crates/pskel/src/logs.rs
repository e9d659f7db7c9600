//! Logs of every format of this program: recorded logs, logs of evaluation protocols, and the synthetic town.

use point_skeleton::Log;
use point_skeleton::dataset::{DatasetError, LogLocator, LogOpener, register};
use pskel_eval::protocol::SIMGEN_FORMAT;

/// Adds the formats of other crates to those that `LogLocator` and `Log::open` know.
pub fn register_formats() {
    register(&SIMGEN_FORMAT);
    #[cfg(feature = "town")]
    register(&pskel_town::FORMAT);
}

/// Parses a log locator: `FORMAT:PATH[@VERSION][#SCENE]`, the path alone, or `town:OPTIONS`.
///
/// # Errors
/// Fails if the text has another form, if a path without a format has files of none or of several formats, or
/// if the town does not support an option.
pub fn locate(text: &str) -> Result<LogLocator, DatasetError> {
    register_formats();
    text.parse()
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
    opener.open(locator).map(Log::new)
}

/// Opens a log and returns it with the name of its recording: the log's, for towns with their options, since
/// skeletons of two recordings of a town differ.
///
/// # Errors
/// Fails as [`open`].
#[cfg(feature = "network")]
pub fn open_recording(locator: &LogLocator) -> Result<(String, Log), DatasetError> {
    #[cfg(feature = "town")]
    if *locator.format == pskel_town::FORMAT {
        let town = pskel_town::Town::open(locator)?;
        return Ok((town.recording_name(), Log::new(Box::new(town))));
    }
    let log = open(locator)?;
    Ok((log.name().to_owned(), log))
}

#[cfg(all(test, feature = "town"))]
mod tests {
    use super::*;
    use pskel_town::{FORMAT, Town};

    #[test]
    fn town_locators_reject_unknown_options() {
        assert_eq!(*locate("town:seed=3").unwrap().format, FORMAT);
        let message = locate("town:seed=3,color=red").unwrap_err().to_string();
        assert!(message.contains("expected the options") && message.contains("color"), "{message}");
        assert!(locate("nuscenes:a").is_ok() && locate("village:a").is_err());
        assert!(Town::open(&locate("nuscenes:a").unwrap()).is_err());
        let rooted = LogLocator { map_root: Some("maps".into()), ..locate("town:").unwrap() };
        assert!(open(&rooted).err().unwrap().to_string().ends_with(": maps"));
    }
}
