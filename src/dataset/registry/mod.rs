//! The log formats of this program: one row per reader, also of readers in other crates.
//!
//! # How it works
//! The rows of this crate are in [`BUILT_IN`]; a crate with another format, such as the synthetic town, adds
//! its row with [`register`] when the program starts. Names of logs are parsed here, since a path alone is
//! recognized by the formats.

pub(super) mod format;

use std::path::Path;
use std::str::FromStr;
use std::sync::{PoisonError, RwLock};

use self::format::{LogFormat, LogLocator, LogOpener};
use super::{DatasetError, LogReader};

/// Formats of this crate's readers.
const BUILT_IN: &[&LogFormat] = &[
    #[cfg(feature = "nuscenes")]
    &super::nuscenes::FORMAT,
    #[cfg(feature = "nuplan")]
    &super::nuplan::FORMAT,
    #[cfg(feature = "av2")]
    &super::av2::FORMAT,
    #[cfg(feature = "123d")]
    &super::py123d::FORMAT,
];

/// Formats of other crates' readers.
static REGISTERED: RwLock<Vec<&'static LogFormat>> = RwLock::new(Vec::new());

/// Adds a format. A second one of the same name is ignored.
pub fn register(format: &'static LogFormat) {
    let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    if BUILT_IN.iter().chain(registered.iter()).all(|known| *known != format) {
        registered.push(format);
    }
}

/// Returns all formats: this crate's rows, then the registered ones.
pub fn formats() -> Vec<&'static LogFormat> {
    let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
    BUILT_IN.iter().chain(registered.iter()).copied().collect()
}

/// Returns the names of all formats for messages, like `nuscenes, nuplan or av2`.
fn format_names() -> String {
    let names: Vec<&str> = formats().iter().map(|format| format.name).collect();
    match names.as_slice() {
        [] => "none".to_owned(),
        [only] => (*only).to_owned(),
        [others @ .., last] => format!("{} or {last}", others.join(", ")),
    }
}

impl FromStr for LogLocator {
    type Err = DatasetError;

    /// Parses `FORMAT:PATH[@VERSION][#SCENE]`, or a path without a format, which is recognized by its files.
    fn from_str(text: &str) -> Result<Self, DatasetError> {
        let wrong = || DatasetError::Locator { found: text.to_owned(), formats: format_names() };
        let named = text.split_once(':').and_then(|(name, rest)| {
            let format = formats().into_iter().find(|format| format.name == name)?;
            Some((format, rest))
        });
        let locator = match named {
            Some((format, rest)) if format.has_path => parse_path(format, rest).ok_or_else(wrong)?,
            Some((format, rest)) => Self::new(format, rest),
            None => detect(text)?.ok_or_else(wrong)?,
        };
        (locator.format.check)(&locator)?;
        Ok(locator)
    }
}

/// Parses `PATH[@VERSION][#SCENE]`.
fn parse_path(format: &'static LogFormat, text: &str) -> Option<LogLocator> {
    let (rest, scene) = split_tail(text, '#');
    let (path, version) = split_tail(rest, '@');
    if path.is_empty() || version == Some("") || scene == Some("") {
        return None;
    }
    let (version, scene) = (version.map(Into::into), scene.map(Into::into));
    Some(LogLocator { version, scene, ..LogLocator::new(format, path) })
}

/// Recognizes the format of `PATH[@VERSION][#SCENE]` by the files there; `None` if there are no files of a
/// format.
///
/// # Errors
/// Fails if there are files of several formats.
fn detect(text: &str) -> Result<Option<LogLocator>, DatasetError> {
    let without_scene = split_tail(text, '#').0;
    // Paths may have the marks too.
    let paths = [text, without_scene, split_tail(without_scene, '@').0];
    let Some(path) = paths.into_iter().find(|path| Path::new(path).exists()) else { return Ok(None) };
    let mut found = formats();
    found.retain(|format| format.has_path && (format.detect)(Path::new(path)));
    match found.as_slice() {
        [] => Ok(None),
        [format] if path == text => Ok(Some(LogLocator::new(format, path))),
        [format] => Ok(parse_path(format, text)),
        several => {
            let names: Vec<&str> = several.iter().map(|format| format.name).collect();
            Err(DatasetError::SeveralFormats { names: names.join(", "), path: path.into() })
        }
    }
}

/// Splits at the last `mark`. A mark before the last folder separator belongs to the path.
fn split_tail(text: &str, mark: char) -> (&str, Option<&str>) {
    match text.rsplit_once(mark) {
        Some((head, tail)) if !tail.contains('/') => (head, Some(tail)),
        _ => (text, None),
    }
}

/// Opens the log that a locator names.
///
/// # Errors
/// Fails as [`LogOpener::open`].
pub fn open(locator: &LogLocator) -> Result<Box<dyn LogReader>, DatasetError> {
    LogOpener::new().open(locator)
}

/// Returns the logs that a locator refers to, in order: the locator itself unless it names a set of logs.
///
/// # Errors
/// Fails as [`open`], and if the set is empty or its index cannot be read.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    (locator.format.expand)(locator)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    #[test]
    fn all_parts_are_parsed() {
        let locator: LogLocator = "nuscenes:/data/a@b/nuscenes@v1.0-mini#scene-0061".parse().unwrap();
        assert_eq!(locator.to_string(), "nuscenes:/data/a@b/nuscenes@v1.0-mini#scene-0061");
        assert_eq!(locator.path, PathBuf::from("/data/a@b/nuscenes"));
        assert_eq!(locator.version.as_deref(), Some("v1.0-mini"));
        assert_eq!(locator.scene.as_deref(), Some("scene-0061"));
        let bare: LogLocator = "nuscenes:data".parse().unwrap();
        assert_eq!((bare.version, bare.scene), (None, None));
    }

    static MADE: LogFormat = LogFormat {
        name: "made",
        has_path: false,
        rates_hz: [10.0, 5.0],
        detect: |_| false,
        check: |locator| match locator.path.to_str() {
            Some("bad") => Err(DatasetError::Locator { found: "bad".to_owned(), formats: format_names() }),
            _ => Ok(()),
        },
        expand: |locator| Ok(vec![locator.clone()]),
        outline: LogFormat::outline_by_opening,
        open: |locator, _| {
            let found = locator.path.display().to_string();
            Err(DatasetError::Locator { found, formats: "opened".to_owned() })
        },
    };

    /// The path of a format without files is any text. Its reader is called by every door.
    #[test]
    fn formats_of_other_crates_are_registered_once() {
        register(&MADE);
        register(&MADE);
        assert_eq!(formats().iter().filter(|format| **format == &MADE).count(), 1);
        let locator: LogLocator = "made:seed=7@1#2".parse().unwrap();
        assert_eq!((locator.path.to_str(), locator.scene.as_deref()), (Some("seed=7@1#2"), None));
        assert_eq!(locator.to_string(), "made:seed=7@1#2");
        assert!("made:bad".parse::<LogLocator>().is_err());
        let opened = crate::Log::open("made:seed=7").err().unwrap().to_string();
        assert!(opened.contains("opened") && opened.contains("seed=7"), "{opened}");
        assert!(LogOpener::new().outline(&locator).is_err());
        assert_eq!(expand(&locator).unwrap(), [locator]);
    }

    #[test]
    fn rejects_other_forms() {
        for text in ["", "nuscenes", "nuscenes:", "kitti:/data", "nuscenes:/data@", "nuscenes:/data#"] {
            let message = text.parse::<LogLocator>().unwrap_err().to_string();
            assert!(formats().iter().all(|format| message.contains(format.name)), "{message}");
        }
    }
}
