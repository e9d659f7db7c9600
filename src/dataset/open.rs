#[cfg(feature = "nuscenes")]
use std::sync::{Arc, Mutex, PoisonError};

use super::{DatasetError, LogLocator, LogOutline, LogReader};

/// Opens logs. Tables that hold many logs (nuScenes) are read once for consecutive logs of one data set.
#[derive(Debug, Default)]
pub struct LogOpener {
    #[cfg(feature = "nuscenes")]
    version: Mutex<Option<Arc<super::nuscenes::Version>>>,
}

impl LogOpener {
    /// Creates an opener that has read nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Opens the log that a locator names.
    ///
    /// # Errors
    /// Returns any error of the format's reader.
    pub fn open(&self, locator: &LogLocator) -> Result<Box<dyn LogReader>, DatasetError> {
        (locator.format.open)(locator, self)
    }

    /// Returns name and length of a log. Those of nuScenes are in two small tables; logs of other formats are opened.
    ///
    /// # Errors
    /// Fails as [`LogOpener::open`].
    pub fn outline(&self, locator: &LogLocator) -> Result<LogOutline, DatasetError> {
        (locator.format.outline)(locator, self)
    }

    /// Returns the nuScenes tables of a locator.
    #[cfg(feature = "nuscenes")]
    pub(super) fn version(
        &self,
        locator: &LogLocator,
    ) -> Result<Arc<super::nuscenes::Version>, DatasetError> {
        let mut version = self.version.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = version.as_ref().filter(|known| known.is_of(locator)) {
            return Ok(known.clone());
        }
        Ok(version.insert(Arc::new(super::nuscenes::Version::open(locator)?)).clone())
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
