//! Selection of version and scene.

use std::path::{Path, PathBuf};

use super::folders::{self, MARK, MAX_ENTRIES, folders_in, has_own_tables};
use super::tables::{LogRecord, Scene, Table};
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::input::is_taken;

/// Prefix of nuScenes' own version names.
const USUAL: &str = "v1.0-";

/// Maximum number of folders that an error lists.
const MAX_LISTED: usize = 20;

/// Returns the folder of the tables: `root/version`, or the only folder in `root` with tables, whatever its
/// name.
pub(super) fn version_folder(root: &Path, version: Option<&str>) -> Result<PathBuf, DatasetError> {
    let folders = folders_in(root, usize::MAX)?;
    let known: Vec<&String> = folders.iter().filter(|name| is_taken(&root.join(name).join(MARK))).collect();
    let usual: Vec<&String> = folders.iter().filter(|name| name.starts_with(USUAL)).collect();
    // A version without its table of scenes is reported as such.
    let candidates = if known.is_empty() { usual } else { known };
    if let Some(wanted) = version
        && folders.iter().any(|name| name == wanted)
    {
        return Ok(root.join(wanted));
    }
    if let ([only], None) = (candidates.as_slice(), version) {
        return Ok(root.join(only));
    }
    let (expected, found) = match candidates.as_slice() {
        [] => (format!("a folder of tables (with {MARK})"), nearby(root, version)),
        names => {
            let names: Vec<&str> = names.iter().map(|name| name.as_str()).collect();
            (format!("@VERSION to name one of {}", names.join(", ")), version.unwrap_or("none").to_owned())
        }
    };
    Err(FileError::content(expected, found, root).into())
}

/// Returns whether a folder contains tables of scenes, or folders of such scenes.
pub(super) fn has_tables(root: &Path) -> bool {
    has_own_tables(root, MAX_ENTRIES) || folders::has_scenes(root, MAX_ENTRIES)
}

/// Returns the folder of a locator's tables.
///
/// # Errors
/// Fails if there are none, or if several versions, revisions or scenes exist and none is selected.
pub(super) fn table_folder(locator: &LogLocator) -> Result<PathBuf, DatasetError> {
    let locator = folders::resolve(locator)?;
    version_folder(&locator.path, locator.version.as_deref())
}

/// Describes tables above or below a folder that has none, for a path that is one folder off.
fn nearby(root: &Path, version: Option<&str>) -> String {
    if is_taken(&root.join(MARK)) {
        return format!("{MARK} in the folder itself: name the folder above, and this one as @VERSION");
    }
    let below = |name: &String| {
        let folder = root.join(name);
        let inner = folders_in(&folder, MAX_ENTRIES).unwrap_or_default().into_iter();
        let tables = inner.filter(move |inner| is_taken(&folder.join(inner).join(MARK)));
        tables.map(|inner| format!("{name}/{inner}")).collect::<Vec<_>>()
    };
    let found = folders_in(root, MAX_ENTRIES).unwrap_or_default();
    let mut found: Vec<String> = found.iter().flat_map(below).take(MAX_LISTED + 1).collect();
    if found.is_empty() {
        return version.unwrap_or("none").to_owned();
    }
    if found.len() > MAX_LISTED {
        found[MAX_LISTED] = "..".to_owned();
    }
    format!("tables one folder further down, in {}", found.join(", "))
}

/// Returns the scene with a name or token, or the only one.
pub(super) fn choose_scene<'a>(
    scenes: &'a Table<Scene>,
    wanted: Option<&str>,
) -> Result<&'a Scene, DatasetError> {
    if scenes.records.is_empty() {
        return Err(FileError::content("at least one scene", "none", &scenes.path).into());
    }
    let fits = |scene: &&Scene| wanted.is_none_or(|w| scene.name == w || scene.token == w);
    let mut fitting = scenes.records.iter().filter(fits);
    if let (Some(scene), None) = (fitting.next(), fitting.next()) {
        return Ok(scene);
    }
    // A name that several scenes have does not select one; a token does.
    let name = |scene: &Scene| match scenes.records.iter().filter(|other| other.name == scene.name).count() {
        1 => scene.name.clone(),
        _ => format!("{} (named {})", scene.token, scene.name),
    };
    let mut names: Vec<String> = scenes.records.iter().map(name).collect();
    names.sort();
    Err(DatasetError::Scene { found: wanted.map(Into::into), scenes: names, path: scenes.path.clone() })
}

/// Table of logs, if a scene of the version names one: those of TruckScenes do not.
pub(super) struct Logs(Option<Table<LogRecord>>);

impl Logs {
    /// Reads the table that scenes refer to.
    ///
    /// # Errors
    /// Fails if it is missing or damaged, unless no scene names a log.
    pub(super) fn of(tables: &Path, scenes: &[Scene]) -> Result<Self, FileError> {
        let is_named = scenes.iter().any(|scene| !scene.log_token.is_empty());
        Ok(Self(if is_named { Some(Table::load(tables)?) } else { None }))
    }

    /// Returns where a scene was recorded; `None` if it names no log.
    ///
    /// # Errors
    /// Fails if the table does not hold the log.
    pub(super) fn location(&self, scene: &Scene) -> Result<Option<&str>, DatasetError> {
        let Some(logs) = self.0.as_ref().filter(|_| !scene.log_token.is_empty()) else { return Ok(None) };
        let log = logs.get(&scene.log_token, || format!("scene {}", scene.token))?;
        Ok(Some(&log.location))
    }
}

/// Returns the scenes that a locator refers to, sorted by name. `#*` selects all scenes of the version,
/// `#LOCATION` those recorded there; otherwise the locator itself is returned. Scene names take precedence
/// over locations.
///
/// # Errors
/// Fails if tables are missing or damaged, or `#SCENE` is neither a scene nor a location.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    let Some(wanted) = locator.scene.as_deref() else { return Ok(vec![locator.clone()]) };
    if let Some(logs) = folders::expand(locator)? {
        return Ok(logs);
    }
    let tables = table_folder(locator)?;
    let scenes = Table::<Scene>::load(&tables)?;
    if scenes.records.iter().any(|scene| scene.name == wanted || scene.token == wanted) {
        return Ok(vec![locator.clone()]);
    }
    let logs = Logs::of(&tables, &scenes.records)?;
    let mut names = Vec::new();
    for scene in &scenes.records {
        let location = logs.location(scene)?;
        if wanted == "*" || location == Some(wanted) {
            names.push(scene.name.clone());
        }
    }
    if names.is_empty() {
        return choose_scene(&scenes, Some(wanted)).map(|_| Vec::new());
    }
    names.sort();
    Ok(names.into_iter().map(|name| LogLocator { scene: Some(name), ..locator.clone() }).collect())
}
