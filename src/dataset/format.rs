//! Formats of logs: one row per reader, also of readers in other crates.
//!
//! # How it works
//! A row says how logs of a format are recognized, listed and opened. The rows of this crate are in [`BUILT_IN`]; a crate
//! with another format, like that of the synthetic town, adds its row with [`register`] when the program starts.

use std::fmt;
use std::path::Path;
use std::sync::{PoisonError, RwLock};

use super::{DatasetError, LogLocator, LogOpener, LogOutline, LogReader};

/// Opens the reader of a log.
pub type OpenReader = fn(&LogLocator, &LogOpener) -> Result<Box<dyn LogReader>, DatasetError>;

/// Format of logs. Formats of one name are equal.
pub struct LogFormat {
    /// Name in the text form of a locator, `NAME:PATH`.
    pub name: &'static str,
    /// Whether the path of a locator names a file or folder. Otherwise it is a text that only the format understands.
    pub has_path: bool,
    /// Simulation and planning steps per second that suit its logs.
    pub rates_hz: [f64; 2],
    /// Returns whether a file or folder has logs of the format, by the names of files alone.
    pub detect: fn(&Path) -> bool,
    /// Checks a locator without opening a file.
    pub check: fn(&LogLocator) -> Result<(), DatasetError>,
    /// Returns the logs that a locator refers to, in order: the locator itself unless it names a set of logs.
    pub expand: fn(&LogLocator) -> Result<Vec<LogLocator>, DatasetError>,
    /// Returns name and length of a log.
    pub outline: fn(&LogLocator, &LogOpener) -> Result<LogOutline, DatasetError>,
    /// Opens a log. The opener may have read tables of it.
    pub open: OpenReader,
}

/// Formats of this crate's readers.
const BUILT_IN: &[&LogFormat] = &[
    #[cfg(feature = "nuscenes")]
    &super::nuscenes::FORMAT,
    #[cfg(feature = "nuplan")]
    &super::nuplan::FORMAT,
    #[cfg(feature = "av2")]
    &super::av2::FORMAT,
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

/// Returns all formats: those of this crate, then the registered ones.
pub fn formats() -> Vec<&'static LogFormat> {
    let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
    BUILT_IN.iter().chain(registered.iter()).copied().collect()
}

/// Returns the names of all formats for messages, like `nuscenes, nuplan or av2`.
pub(super) fn format_names() -> String {
    let names: Vec<&str> = formats().iter().map(|format| format.name).collect();
    match names.as_slice() {
        [] => "none".to_owned(),
        [only] => (*only).to_owned(),
        [others @ .., last] => format!("{} or {last}", others.join(", ")),
    }
}

impl LogFormat {
    /// Value of [`LogFormat::check`] for formats whose locators need none.
    ///
    /// # Errors
    /// Never fails.
    pub fn unchecked(_: &LogLocator) -> Result<(), DatasetError> {
        Ok(())
    }

    /// Value of [`LogFormat::outline`] for formats whose logs are opened for it.
    ///
    /// # Errors
    /// Fails as [`LogFormat::open`].
    pub fn outline_by_opening(locator: &LogLocator, opener: &LogOpener) -> Result<LogOutline, DatasetError> {
        Ok(LogOutline::of((locator.format.open)(locator, opener)?.recording()))
    }
}

impl PartialEq for LogFormat {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for LogFormat {}

impl fmt::Debug for LogFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}
