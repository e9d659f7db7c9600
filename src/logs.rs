//! Logs by their names, whatever their format: recorded ones and the town that is built in.

use crate::dataset::{Dataset, DatasetError, LogFormat, LogLocator, av2, nuplan, nuscenes};
use crate::error::FileError;
use crate::town::{Town, TownOptions};

/// The log that a text names, `FORMAT:PATH[@VERSION][#SCENE]` or `town:OPTIONS`. Nothing is opened.
///
/// # Errors
/// A text of another form; options that the town does not have.
pub fn locate(text: &str) -> Result<LogLocator, DatasetError> {
    let locator: LogLocator = text.parse()?;
    if locator.format == LogFormat::Town {
        town_options(&locator)?;
    }
    Ok(locator)
}

/// The logs that a name stands for, in order: itself, unless it names a set of them.
///
/// # Errors
/// A set that holds none, or whose index cannot be read.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    match locator.format {
        LogFormat::NuScenes => nuscenes::expand(locator),
        LogFormat::Argoverse => av2::expand(locator),
        LogFormat::NuPlan | LogFormat::NuPlanSimgen => nuplan::expand(locator),
        LogFormat::Town => Ok(vec![locator.clone()]),
    }
}

/// Opens a log by its name.
///
/// # Errors
/// A name of another form, or what the format's reader finds wrong.
pub fn open(locator: &LogLocator) -> Result<Box<dyn Dataset>, DatasetError> {
    match locator.format {
        LogFormat::NuScenes => Ok(Box::new(nuscenes::NuScenes::open(locator)?)),
        LogFormat::Argoverse => Ok(Box::new(av2::Argoverse::open(locator)?)),
        LogFormat::NuPlan | LogFormat::NuPlanSimgen => Ok(Box::new(nuplan::NuPlan::open(locator)?)),
        LogFormat::Town => Ok(Box::new(open_town(locator)?)),
    }
}

/// Opens the built-in town, which can do more than a recorded log: it knows what is true.
///
/// # Errors
/// A log of another format, options that it does not have.
pub fn open_town(locator: &LogLocator) -> Result<Town, DatasetError> {
    Ok(Town::new(&town_options(locator)?)?)
}

fn town_options(locator: &LogLocator) -> Result<TownOptions, DatasetError> {
    if locator.format != LogFormat::Town {
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
        assert_eq!(locate("town:seed=3").unwrap().format, LogFormat::Town);
        let message = locate("town:seed=3,color=red").unwrap_err().to_string();
        assert!(message.contains("expected the options") && message.contains("color"), "{message}");
        assert!(locate("nuscenes:a").is_ok() && locate("village:a").is_err());
        assert!(open_town(&locate("nuscenes:a").unwrap()).is_err());
        let rooted = LogLocator { map_root: Some("maps".into()), ..locate("town:").unwrap() };
        assert!(open(&rooted).err().unwrap().to_string().ends_with(": maps"));
    }
}
