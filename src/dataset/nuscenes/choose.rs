//! Selection of version and scene.

use std::path::{Path, PathBuf};

use super::tables::{LogRecord, Scene, Table};
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;

/// Returns the folder of the tables: `root/version`, or the only `root/v1.0-*`.
pub(super) fn version_folder(root: &Path, version: Option<&str>) -> Result<PathBuf, DatasetError> {
    let mut known = Vec::new();
    for entry in std::fs::read_dir(root).map_err(FileError::io("read", root))? {
        let entry = entry.map_err(FileError::io("read", root))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let wanted = version.map_or(name.starts_with("v1.0-"), |v| v == name);
        if entry.path().is_dir() && (wanted || name.starts_with("v1.0-")) {
            known.push((name, wanted));
        }
    }
    known.sort();
    let mut wanted = known.iter().filter(|(_, wanted)| *wanted);
    if let (Some((name, _)), None) = (wanted.next(), wanted.next()) {
        return Ok(root.join(name));
    }
    let names: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
    let (expected, found) = match (names.as_slice(), version) {
        ([], found) => ("a folder of tables (v1.0-*)".to_owned(), found.unwrap_or("none")),
        (names, found) => (format!("@VERSION to name one of {}", names.join(", ")), found.unwrap_or("none")),
    };
    Err(FileError::content(expected, found, root).into())
}

/// Returns the scene with a name or token, or the only one.
pub(super) fn choose_scene<'a>(
    scenes: &'a Table<Scene>,
    wanted: Option<&str>,
) -> Result<&'a Scene, DatasetError> {
    let fits = |scene: &&Scene| wanted.is_none_or(|w| scene.name == w || scene.token == w);
    let mut fitting = scenes.records.iter().filter(fits);
    if let (Some(scene), None) = (fitting.next(), fitting.next()) {
        return Ok(scene);
    }
    let mut names: Vec<String> = scenes.records.iter().map(|s| s.name.clone()).collect();
    names.sort();
    Err(DatasetError::Scene { found: wanted.map(Into::into), scenes: names, path: scenes.path.clone() })
}

/// Returns the scenes that a locator refers to, sorted by name. `#*` selects all scenes of the version, `#LOCATION`
/// those recorded there; otherwise the locator itself is returned. Scene names take precedence over locations.
///
/// # Errors
/// Fails if tables are missing or damaged, or `#SCENE` is neither a scene nor a location.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    let Some(wanted) = locator.scene.as_deref() else { return Ok(vec![locator.clone()]) };
    let tables = version_folder(&locator.path, locator.version.as_deref())?;
    let scenes = Table::<Scene>::load(&tables)?;
    if scenes.records.iter().any(|scene| scene.name == wanted || scene.token == wanted) {
        return Ok(vec![locator.clone()]);
    }
    let logs = Table::<LogRecord>::load(&tables)?;
    let mut names = Vec::new();
    for scene in &scenes.records {
        let log = logs.get(&scene.log_token, || format!("scene {}", scene.token))?;
        if wanted == "*" || log.location == wanted {
            names.push(scene.name.clone());
        }
    }
    if names.is_empty() {
        return choose_scene(&scenes, Some(wanted)).map(|_| Vec::new());
    }
    names.sort();
    Ok(names.into_iter().map(|name| LogLocator { scene: Some(name), ..locator.clone() }).collect())
}
