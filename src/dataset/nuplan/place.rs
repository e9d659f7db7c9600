//! Locations of a log and its sensor and map folders.
//!
//! The defaults follow the downloads: `nuplan-v1.1/splits/SPLIT/LOG.db`, `nuplan-v1.1/sensor_blobs/LOG/..`
//! and, beside `nuplan-v1.1`, `maps`.

use std::path::{Path, PathBuf};

use crate::dataset::limits::check_roots;
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::input::{DataRoot, is_taken};

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

/// Returns the logs that a locator refers to: a file, or all logs of a folder sorted by name.
///
/// # Errors
/// Fails if a folder has no logs, `#LOG` is unknown, or a `@VERSION` is given.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    check_version(locator)?;
    let path = &locator.path;
    match std::fs::metadata(path).map_err(FileError::io("read", path))?.is_dir() {
        true => chosen(locator, &logs_in(path)?),
        false => Ok(vec![locator.clone()]),
    }
}

/// Returns the logs of a named set, `set`, in a folder.
///
/// # Errors
/// Fails as [`expand`], or if the folder lacks some of them.
pub fn expand_set(locator: &LogLocator, set: &str, names: &[&str]) -> Result<Vec<LogLocator>, DatasetError> {
    check_version(locator)?;
    let path = &locator.path;
    if !std::fs::metadata(path).map_err(FileError::io("read", path))?.is_dir() {
        return Err(FileError::content(format!("the folder of the logs of {set}"), "a file", path).into());
    }
    let missing: Vec<&str> =
        names.iter().filter(|name| !is_taken(&path.join(format!("{name}.db")))).copied().collect();
    if !missing.is_empty() {
        let expected = format!("the {} logs of {set} (.db)", names.len());
        return Err(FileError::content(expected, format!("none named {}", missing.join(", ")), path).into());
    }
    chosen(locator, &names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
}

fn check_version(locator: &LogLocator) -> Result<(), FileError> {
    let wrong = |version| FileError::content("a log without @VERSION", format!("@{version}"), &locator.path);
    locator.version.as_ref().map_or(Ok(()), |version| Err(wrong(version)))
}

/// Returns the logs of a folder by name: all of them, or `#LOG`.
fn chosen(locator: &LogLocator, names: &[String]) -> Result<Vec<LogLocator>, DatasetError> {
    let path = &locator.path;
    let log = |name: &String| LogLocator {
        format: &super::FORMAT,
        path: path.join(format!("{name}.db")),
        scene: None,
        ..locator.clone()
    };
    match &locator.scene {
        None => Ok(names.iter().map(log).collect()),
        Some(name) if names.contains(name) => Ok(vec![log(name)]),
        Some(name) => Err(choose(names, name, path)),
    }
}

/// Returns whether a path is a log by its ending, or a folder with one.
pub(super) fn has_logs(path: &Path) -> bool {
    match path.is_dir() {
        true => logs_in(path).is_ok(),
        false => path.extension().is_some_and(|extension| extension == "db"),
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
