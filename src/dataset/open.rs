use super::{Dataset, DatasetError, LogFormat, LogLocator, LogOutline};

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

/// Returns the outlines of recorded logs, in order. Scenes of nuScenes are read from two tables; logs of other formats are
/// opened.
pub fn outlines(locators: &[LogLocator]) -> Vec<Result<LogOutline, DatasetError>> {
    #[cfg(feature = "nuscenes")]
    let mut index: Option<super::nuscenes::SceneIndex> = None;
    let outline = |locator: &LogLocator| {
        #[cfg(feature = "nuscenes")]
        if locator.format == LogFormat::NuScenes {
            let index = match index.take().filter(|index| index.is_of(locator)) {
                Some(known) => index.insert(known),
                None => index.insert(super::nuscenes::SceneIndex::open(locator)?),
            };
            return index.outline(locator);
        }
        Ok(LogOutline::of(open(locator)?.log()))
    };
    locators.iter().map(outline).collect()
}

fn unsupported(format: LogFormat) -> DatasetError {
    DatasetError::Unsupported { found: format.name() }
}
