//! Selection of logs: a folder may be a log, or hold logs of one or more splits.

use std::path::{Path, PathBuf};

use super::metadata::{self, LogMetadata};
use crate::dataset::limits::only_log;
use crate::dataset::tables::ArrowFile;
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::input::is_taken;

/// File that each log has.
pub(super) const SYNC: &str = "sync.arrow";
/// Folder of the splits in the folder of all data.
const LOGS: &str = "logs";
/// Folder of maps beside it.
const MAPS: &str = "maps";

/// Log below a folder.
struct Candidate {
    split: String,
    name: String,
    path: PathBuf,
}

/// Returns the logs that a locator refers to, sorted by split and name: the folder itself, or the logs of all
/// splits in it, or those of `@SPLIT`; of these, all (`#*`), the one named `#LOG`, or those of the location
/// `#LOCATION`.
///
/// # Errors
/// Fails if the folder cannot be read or has no logs, or none of the given name, and where locations are
/// compared, if the table of a log is damaged.
pub(super) fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    let path = &locator.path;
    let mut candidates = candidates(path)?;
    if candidates.is_empty() {
        let expected =
            format!("a log (a folder with {SYNC}) or a folder of logs (ROOT, ROOT/{LOGS} or a split in it)");
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let has_tables =
            entries.map(|entry| entry.path()).any(|file| file.extension().is_some_and(|end| end == "arrow"));
        let found = if has_tables { format!("tables without {SYNC}") } else { "neither".to_owned() };
        return Err(FileError::content(expected, found, path).into());
    }
    if let Some(split) = &locator.version {
        let splits: Vec<String> = candidates.iter().map(|log| log.split.clone()).collect();
        candidates.retain(|log| log.split == *split);
        if candidates.is_empty() {
            return Err(no_split(split, splits, path).into());
        }
    }
    let wanted = locator.scene.as_deref().filter(|scene| *scene != "*");
    let Some(wanted) = wanted else {
        return Ok(candidates.into_iter().map(|log| log.locator(locator)).collect());
    };
    let names: Vec<String> = candidates.iter().map(|log| log.name.clone()).collect();
    let is_name = names.iter().any(|name| name == wanted);
    let mut found = Vec::new();
    for log in candidates {
        let is_wanted =
            if is_name { log.name == wanted } else { location(&log.path)?.as_deref() == Some(wanted) };
        found.extend(is_wanted.then(|| log.locator(locator)));
    }
    if found.is_empty() {
        return Err(DatasetError::Scene { found: locator.scene.clone(), scenes: names, path: path.clone() });
    }
    Ok(found)
}

/// Returns the only log that a locator refers to.
///
/// # Errors
/// Fails as [`expand`], or if there are several logs.
pub(super) fn single(locator: &LogLocator) -> Result<LogLocator, DatasetError> {
    only_log(expand(locator)?, locator, shown)
}

/// Returns whether a folder is a log or contains one.
pub(super) fn has_logs(path: &Path) -> bool {
    candidates(path).is_ok_and(|logs| !logs.is_empty())
}

/// Returns the folder of maps beside the folder of logs; `None` if the log does not lie in `ROOT/logs/SPLIT`.
pub(super) fn maps_beside(log: &Path) -> Option<PathBuf> {
    let log = std::path::absolute(log).ok()?;
    let logs = log.parent()?.parent()?;
    (logs.file_name()? == LOGS).then(|| logs.with_file_name(MAPS))
}

impl Candidate {
    fn locator(self, locator: &LogLocator) -> LogLocator {
        LogLocator { path: self.path, version: None, scene: None, ..locator.clone() }
    }
}

fn no_split(found: &str, mut splits: Vec<String>, path: &Path) -> FileError {
    splits.sort();
    splits.dedup();
    FileError::content(format!("@SPLIT to name one of {}", splits.join(", ")), format!("@{found}"), path)
}

/// Returns the last two parts of a log's path, `SPLIT/LOG`, for messages.
fn shown(path: &Path) -> String {
    let [split, name] = [path.parent(), Some(path)].map(|path| path.map_or_else(String::new, file_name));
    if split.is_empty() { name } else { format!("{split}/{name}") }
}

fn location(log: &Path) -> Result<Option<String>, FileError> {
    let file = ArrowFile::open(&log.join(SYNC))?;
    Ok(metadata::read::<LogMetadata>(&file)?.location)
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Lists the logs of a folder, at most two folders below it or below its folder `logs`.
fn candidates(path: &Path) -> Result<Vec<Candidate>, FileError> {
    let candidate = |path: PathBuf| {
        let resolved = std::path::absolute(&path).unwrap_or_else(|_| path.clone());
        let split = resolved.parent().map_or_else(String::new, file_name);
        Candidate { split, name: file_name(&resolved), path }
    };
    if is_log(path) {
        return Ok(vec![candidate(path.to_owned())]);
    }
    let top = path.join(LOGS);
    let top = if top.is_dir() { top } else { path.to_owned() };
    let mut found = Vec::new();
    for folder in folders(&top)? {
        if is_log(&folder) {
            found.push(folder);
        } else {
            found.extend(folders(&folder)?.into_iter().filter(|folder| is_log(folder)));
        }
    }
    let mut found: Vec<Candidate> = found.into_iter().map(candidate).collect();
    found.sort_by(|a, b| (&a.split, &a.name).cmp(&(&b.split, &b.name)));
    Ok(found)
}

fn is_log(path: &Path) -> bool {
    is_taken(&path.join(SYNC))
}

fn folders(path: &Path) -> Result<Vec<PathBuf>, FileError> {
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(path).map_err(FileError::io("read", path))? {
        let path = entry.map_err(FileError::io("read", path))?.path();
        if path.is_dir() {
            folders.push(path);
        }
    }
    Ok(folders)
}
