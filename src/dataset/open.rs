use super::{Dataset, DatasetError, LogFormat, LogLocator};

/// Opens the recorded log that a locator names.
///
/// # Errors
/// Fails if the log is synthetic or if this build lacks the reader of its format. Returns any error of the reader.
pub fn open(locator: &LogLocator) -> Result<Box<dyn Dataset>, DatasetError> {
    match locator.format {
        #[cfg(feature = "nuscenes")]
        LogFormat::NuScenes => Ok(Box::new(super::nuscenes::NuScenes::open(locator)?)),
        #[cfg(feature = "av2")]
        LogFormat::Argoverse => Ok(Box::new(super::av2::Argoverse::open(locator)?)),
        #[cfg(feature = "nuplan")]
        LogFormat::NuPlan | LogFormat::NuPlanSimgen => Ok(Box::new(super::nuplan::NuPlan::open(locator)?)),
        #[allow(unreachable_patterns)] // depends on the features
        other => Err(DatasetError::Unsupported { found: other.name() }),
    }
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
        #[allow(unreachable_patterns)] // depends on the features
        other => Err(DatasetError::Unsupported { found: other.name() }),
    }
}
