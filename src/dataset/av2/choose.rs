//! Selection of logs: a folder may be a log or contain many.

use std::path::{Path, PathBuf};

use crate::dataset::limits::only_log;
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::input::is_taken;

/// Returns the logs that a locator refers to, sorted by name: the folder itself, or the logs in it.
///
/// # Errors
/// Fails if the folder cannot be read or has no logs, `#LOG_ID` is unknown, or an `@VERSION` is given, since
/// logs have none.
pub(super) fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    let path = &locator.path;
    if let Some(version) = &locator.version {
        let found = format!("@{version}");
        return Err(FileError::content("an Argoverse 2 log without @VERSION", found, path).into());
    }
    let itself = is_log(path);
    let names = if itself { vec![log_name(path)] } else { logs_in(path)? };
    if names.is_empty() {
        let expected =
            "a log (a folder with annotations.feather and city_SE3_egovehicle.feather) or a folder of logs";
        return Err(FileError::content(expected, "neither", path).into());
    }
    let wanted = locator.scene.as_deref().filter(|scene| *scene != "*");
    let chosen = names.iter().filter(|name| wanted.is_none_or(|w| w == *name));
    let chosen: Vec<LogLocator> = chosen
        .map(|name| {
            let path = if itself { path.clone() } else { path.join(name) };
            LogLocator { path, scene: None, ..locator.clone() }
        })
        .collect();
    if chosen.is_empty() {
        return Err(DatasetError::Scene { found: locator.scene.clone(), scenes: names, path: path.clone() });
    }
    Ok(chosen)
}

/// Returns the only log that a locator refers to.
///
/// # Errors
/// Fails as [`expand`], or if there are several logs.
pub(super) fn choose(locator: &LogLocator) -> Result<LogLocator, DatasetError> {
    only_log(expand(locator)?, locator, log_name)
}

/// Returns the folder's name, which is the log's id.
pub(super) fn log_name(path: &Path) -> String {
    let resolved = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    resolved.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Returns the folder that holds a part of the log (`sensors`, `map`). It is below the log by default. With a
/// given `ROOT`, it is `ROOT/LOG_ID/PART` if that exists, else `ROOT`.
pub(super) fn part(log: &Path, root: Option<&Path>, part: &str) -> PathBuf {
    let Some(root) = root else { return log.join(part) };
    let own = root.join(log_name(log)).join(part);
    if own.is_dir() { own } else { root.to_owned() }
}

/// Returns whether a folder has either file of a log. Only one is required, so that the other is reported as
/// missing.
fn is_log(path: &Path) -> bool {
    ["annotations.feather", "city_SE3_egovehicle.feather"].iter().any(|file| is_taken(&path.join(file)))
}

/// Returns whether a folder is a log or contains one.
pub(super) fn has_logs(path: &Path) -> bool {
    is_log(path) || logs_in(path).is_ok_and(|logs| !logs.is_empty())
}

fn logs_in(path: &Path) -> Result<Vec<String>, FileError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(path).map_err(FileError::io("read", path))? {
        let entry = entry.map_err(FileError::io("read", path))?;
        if is_log(&entry.path()) {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}
