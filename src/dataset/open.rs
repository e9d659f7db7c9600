use super::{Dataset, DatasetError, LogFormat, LogLocator};

/// Opens the recorded log that a locator names.
///
/// # Errors
/// Fails if this build has no reader of the format. Returns any error of the reader.
pub fn open(locator: &LogLocator) -> Result<Box<dyn Dataset>, DatasetError> {
    match locator.format {
        #[cfg(feature = "nuscenes")]
        LogFormat::NuScenes => Ok(Box::new(super::nuscenes::NuScenes::open(locator)?)),
        #[cfg(feature = "av2")]
        LogFormat::Argoverse => Ok(Box::new(super::av2::Argoverse::open(locator)?)),
        #[cfg(feature = "nuplan")]
        LogFormat::NuPlan | LogFormat::NuPlanSimgen => Ok(Box::new(super::nuplan::NuPlan::open(locator)?)),
        other => Err(unsupported(other)),
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
        other => Err(unsupported(other)),
    }
}

fn unsupported(format: LogFormat) -> DatasetError {
    DatasetError::Unsupported { found: format.name() }
}
