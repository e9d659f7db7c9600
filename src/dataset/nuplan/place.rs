//! Locations of a log and its sensor and map folders.
//!
//! The defaults follow the downloads: `nuplan-v1.1/splits/SPLIT/LOG.db`, `nuplan-v1.1/sensor_blobs/LOG/..` and,
//! beside `nuplan-v1.1`, `maps`.

use std::path::{Path, PathBuf};

use crate::dataset::limits::check_roots;
use crate::dataset::{DatasetError, LogFormat, LogLocator};
use crate::error::FileError;
use crate::files::input::{DataRoot, is_taken};

/// The ten evaluation logs of the paper.
pub const SIMGEN: [&str; 10] = [
    "2021.05.12.22.28.35_veh-35_00620_01164",
    "2021.05.12.22.00.38_veh-35_01008_01518",
    "2021.05.12.23.36.44_veh-35_02035_02387",
    "2021.05.12.23.36.44_veh-35_01133_01535",
    "2021.05.12.23.36.44_veh-35_00152_00504",
    "2021.05.25.14.16.10_veh-35_01690_02183",
    "2021.06.09.12.39.51_veh-26_01943_02303",
    "2021.06.09.14.58.55_veh-35_01894_02311",
    "2021.06.09.17.23.18_veh-38_00773_01140",
    "2021.06.14.16.32.09_veh-35_05038_05402",
];

/// File locations of a log.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LogPaths {
    /// Database of the log.
    pub(super) database: PathBuf,
    /// Folder that the paths of sweeps and images are relative to.
    pub(super) sensors: DataRoot,
    /// Folder of maps; `None` if not given and the default folder does not exist.
    pub(super) maps: Option<PathBuf>,
    /// Whether the folder of maps was given, so that it must contain the log's map.
    pub(super) needs_map: bool,
}

impl LogPaths {
    /// Finds the folders of a log file.
    pub(super) fn new(locator: &LogLocator) -> Result<Self, DatasetError> {
        // A relative path may start below the folders searched for here.
        let absolute = std::path::absolute(&locator.path).map_err(FileError::io("find", &locator.path))?;
        let root = absolute.ancestors().nth(3).unwrap_or(Path::new("/"));
        check_roots(locator)?;
        let sensors = locator.sensor_root.clone().unwrap_or_else(|| root.join("sensor_blobs"));
        let usual_maps = root.parent().unwrap_or(root).join("maps");
        Ok(Self {
            database: locator.path.clone(),
            sensors: DataRoot { path: sensors, allow_outside: locator.allow_outside },
            maps: locator.map_root.clone().or_else(|| usual_maps.is_dir().then_some(usual_maps)),
            needs_map: locator.map_root.is_some(),
        })
    }
}

/// Returns the logs that a locator refers to: a file, all logs of a folder sorted by name, or the named set.
///
/// # Errors
/// Fails if a folder has no logs or lacks some of the set, `#LOG` is unknown, or a `@VERSION` is given.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    let path = &locator.path;
    if let Some(version) = &locator.version {
        return Err(FileError::content("a log without @VERSION", format!("@{version}"), path).into());
    }
    let is_folder = std::fs::metadata(path).map_err(FileError::io("read", path))?.is_dir();
    if !is_folder {
        if locator.format == LogFormat::NuPlanSimgen {
            return Err(FileError::content("the folder of the logs of nuplan-simgen", "a file", path).into());
        }
        return Ok(vec![locator.clone()]);
    }
    let names = if locator.format == LogFormat::NuPlanSimgen { simgen(path)? } else { logs_in(path)? };
    let log = |name: &String| LogLocator {
        format: LogFormat::NuPlan,
        path: path.join(format!("{name}.db")),
        scene: None,
        ..locator.clone()
    };
    match &locator.scene {
        None => Ok(names.iter().map(log).collect()),
        Some(name) if names.contains(name) => Ok(vec![log(name)]),
        Some(name) => Err(choose(&names, name, path)),
    }
}

/// Returns the only log that a locator refers to.
///
/// # Errors
/// Fails as [`expand`], or if there are several logs.
pub(super) fn single(locator: &LogLocator) -> Result<LogLocator, DatasetError> {
    let mut logs = expand(locator)?;
    match (logs.pop(), logs.is_empty()) {
        (Some(log), true) => Ok(log),
        (last, _) => {
            let stem =
                |log: &LogLocator| log.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let names: Vec<String> = logs.iter().chain(&last).map(stem).collect();
            Err(choose(&names, "none", &locator.path))
        }
    }
}

fn choose(names: &[String], found: &str, path: &Path) -> DatasetError {
    FileError::content(format!("#LOG to name one of {}", names.join(", ")), found, path).into()
}

/// Returns the names of a folder's `.db` files, sorted.
fn logs_in(folder: &Path) -> Result<Vec<String>, FileError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
        let path = entry.map_err(FileError::io("read", folder))?.path();
        if let (Some(stem), true) = (path.file_stem(), path.extension().is_some_and(|e| e == "db")) {
            names.push(stem.to_string_lossy().into_owned());
        }
    }
    names.sort();
    if names.is_empty() {
        return Err(FileError::content("a folder with nuPlan logs (.db)", "none", folder));
    }
    Ok(names)
}

/// Returns the names of the set after checking that the folder contains all of them.
fn simgen(folder: &Path) -> Result<Vec<String>, FileError> {
    let (there, missing): (Vec<&str>, Vec<&str>) =
        SIMGEN.iter().partition(|name| is_taken(&folder.join(format!("{name}.db"))));
    if missing.is_empty() {
        return Ok(there.into_iter().map(Into::into).collect());
    }
    let expected = "the ten logs of nuplan-simgen (.db)";
    Err(FileError::content(expected, format!("none named {}", missing.join(", ")), folder))
}
