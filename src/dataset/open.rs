#[cfg(feature = "nuscenes")]
use std::sync::{Arc, Mutex, PoisonError};

use super::{DatasetError, LogFormat, LogLocator, LogOutline, LogReader};

/// Opens recorded logs. Tables that hold many logs (nuScenes) are read once for consecutive logs of one data set.
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

    /// Opens the recorded log that a locator names.
    ///
    /// # Errors
    /// Fails if this build has no reader of the format. Returns any error of the reader.
    pub fn open(&self, locator: &LogLocator) -> Result<Box<dyn LogReader>, DatasetError> {
        match locator.format {
            #[cfg(feature = "nuscenes")]
            LogFormat::NuScenes => {
                Ok(Box::new(super::nuscenes::NuScenes::of(&*self.version(locator)?, locator)?))
            }
            #[cfg(feature = "av2")]
            LogFormat::Argoverse => Ok(Box::new(super::av2::Argoverse::open(locator)?)),
            #[cfg(feature = "nuplan")]
            LogFormat::NuPlan | LogFormat::NuPlanSimgen => {
                Ok(Box::new(super::nuplan::NuPlan::open(locator)?))
            }
            other => Err(unsupported(other)),
        }
    }

    /// Returns name and length of a recorded log. Those of nuScenes are in two small tables; logs of other formats are
    /// opened.
    ///
    /// # Errors
    /// Fails as [`LogOpener::open`].
    pub fn outline(&self, locator: &LogLocator) -> Result<LogOutline, DatasetError> {
        #[cfg(feature = "nuscenes")]
        if locator.format == LogFormat::NuScenes {
            return self.version(locator)?.outline(locator);
        }
        Ok(LogOutline::of(self.open(locator)?.recording()))
    }

    /// Returns the tables of a locator.
    #[cfg(feature = "nuscenes")]
    fn version(&self, locator: &LogLocator) -> Result<Arc<super::nuscenes::Version>, DatasetError> {
        let mut version = self.version.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = version.as_ref().filter(|known| known.is_of(locator)) {
            return Ok(known.clone());
        }
        Ok(version.insert(Arc::new(super::nuscenes::Version::open(locator)?)).clone())
    }
}

/// Opens the recorded log that a locator names.
///
/// # Errors
/// Fails as [`LogOpener::open`].
pub fn open(locator: &LogLocator) -> Result<Box<dyn LogReader>, DatasetError> {
    LogOpener::new().open(locator)
}

/// Returns the recorded logs that a locator refers to, in order: the locator itself unless it names a set of logs.
///
/// # Errors
/// Fails as [`open`], and if the set is empty or its index cannot be read.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    match locator.format {
        #[cfg(feature = "nuscenes")]
        LogFormat::NuScenes => super::nuscenes::expand(locator),
        #[cfg(feature = "av2")]
        LogFormat::Argoverse => super::av2::expand(locator),
        #[cfg(feature = "nuplan")]
        LogFormat::NuPlan | LogFormat::NuPlanSimgen => super::nuplan::expand(locator),
        other => Err(unsupported(other)),
    }
}

fn unsupported(format: LogFormat) -> DatasetError {
    DatasetError::Unsupported { found: format.name() }
}
