//! Folders of data sets in nuScenes' layout.
//!
//! # How it works
//! Most data sets have one folder of tables for all scenes beside the sensor data (`choose`). TIER IV's T4
//! has a folder for each scene, with tables in `annotation`, or in `REVISION/annotation`, where the revision
//! is a number. [`resolve`] turns a locator of either into one of the folder that has the tables.
//!
//! Tables of Lyft Level 5 name files in `images` and `lidar`; as Kaggle distributes them, tables in
//! `train_data` belong to `train_images` and `train_lidar` ([`SensorFiles`]).
//! Sources: <https://tier4.github.io/t4-devkit/schema>, <https://pypi.org/project/lyft-dataset-sdk>.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::tables::{LogRecord, Scene, Table};
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::NameError;
use crate::files::input::{DataRoot, is_taken};

/// Table that identifies a folder of tables.
pub(super) const MARK: &str = "scene.json";

/// Maximum number of entries per folder among which an error looks for them.
pub(super) const MAX_ENTRIES: usize = 1000;

/// Folder with a T4 scene's tables.
const T4_TABLES: &str = "annotation";

/// End of the names of folders with tables whose start is the start of the folders of data too.
const PREFIXED: &str = "_data";

/// Scene in a folder of T4 scenes.
struct T4Scene {
    /// Name of its folder.
    name: String,
    /// Folder of its tables, of the latest revision.
    tables: PathBuf,
}

/// Returns the locator of the folder that has the tables. Roots of sensor data have the same folders below
/// them.
///
/// # Errors
/// Fails if a folder cannot be read, or if several revisions or scenes fit.
pub(super) fn resolve(locator: &LogLocator) -> Result<Cow<'_, LogLocator>, DatasetError> {
    if has_own_tables(&locator.path, usize::MAX) {
        return Ok(Cow::Borrowed(locator));
    }
    if let Some(revision) = choose_revision(locator)? {
        return Ok(Cow::Owned(below(locator, &revision)));
    }
    let scenes = scenes(&locator.path, usize::MAX);
    match choose_scene(locator, &scenes)? {
        None => Ok(Cow::Borrowed(locator)),
        Some((name, scene)) => {
            let inner = LogLocator { scene, ..below(locator, name) };
            resolve(&inner).map(|inner| Cow::Owned(inner.into_owned()))
        }
    }
}

/// Returns whether a folder contains folders of tables. Looks at up to `most` of its entries.
pub(super) fn has_own_tables(root: &Path, most: usize) -> bool {
    let folders = folders_in(root, most).unwrap_or_default();
    folders.iter().any(|name| is_taken(&root.join(name).join(MARK)))
}

/// Returns the names of the folders in a folder, sorted. Looks at up to `most` of its entries.
pub(super) fn folders_in(root: &Path, most: usize) -> Result<Vec<String>, FileError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(root).map_err(FileError::io("read", root))?.take(most) {
        let entry = entry.map_err(FileError::io("read", root))?;
        if entry.path().is_dir() {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}

/// Returns whether a folder has revisions or scenes of T4. Looks at up to `most` of its entries.
pub(super) fn has_scenes(root: &Path, most: usize) -> bool {
    !revisions(root).is_empty() || !scenes(root, most).is_empty()
}

/// Returns the logs in a folder of T4 scenes that a locator refers to, in order of their names; `None` for
/// other folders.
///
/// # Errors
/// Fails if tables are missing or damaged, or `#SCENE` is neither a scene nor a location.
pub(super) fn expand(locator: &LogLocator) -> Result<Option<Vec<LogLocator>>, DatasetError> {
    let (Some(wanted), false) = (locator.scene.as_deref(), has_own_tables(&locator.path, usize::MAX)) else {
        return Ok(None);
    };
    let scenes = if revisions(&locator.path).is_empty() { scenes(&locator.path, usize::MAX) } else { vec![] };
    if scenes.is_empty() {
        return Ok(None);
    }
    let mut names = Vec::new();
    for scene in &scenes {
        if wanted == "*" || is_recorded_at(&scene.tables, wanted)? {
            names.push(&scene.name);
        }
    }
    if names.is_empty() {
        // A scene, or an error that lists them.
        return choose_scene(locator, &scenes).map(|_| Some(vec![locator.clone()]));
    }
    let log = |name: &String| LogLocator { scene: Some(name.clone()), ..locator.clone() };
    Ok(Some(names.into_iter().map(log).collect()))
}

/// Returns the locator of a folder below, without a version.
fn below(locator: &LogLocator, name: &str) -> LogLocator {
    let path = locator.path.join(name);
    // A version may also name the revision of a scene that is found later.
    let version = locator.version.clone().filter(|version| version != name);
    let sensor_root = locator.sensor_root.as_ref().map(|root| root.join(name));
    LogLocator { path, version, sensor_root, ..locator.clone() }
}

/// Returns the names of revisions' folders, in order.
fn revisions(root: &Path) -> Vec<String> {
    let folders = folders_in(root, usize::MAX).unwrap_or_default().into_iter();
    let mut found: Vec<(u64, String)> = folders
        .filter(|name| name.bytes().all(|byte| byte.is_ascii_digit()))
        .filter_map(|name| Some((name.parse().ok()?, name)))
        .filter(|(_, name)| has_t4_tables(&root.join(name)))
        .collect();
    found.sort();
    found.into_iter().map(|(_, name)| name).collect()
}

/// Returns the revision that a locator names, or the latest one; `None` if there are none.
fn choose_revision(locator: &LogLocator) -> Result<Option<String>, DatasetError> {
    let mut revisions = revisions(&locator.path);
    let wanted = locator.version.as_deref().filter(|version| *version != T4_TABLES);
    match wanted {
        Some(wanted) if revisions.iter().any(|name| name == wanted) => Ok(Some(wanted.to_owned())),
        Some(wanted) if !revisions.is_empty() => {
            let expected = format!("@VERSION to name one of {}", revisions.join(", "));
            Err(FileError::content(expected, wanted, &locator.path).into())
        }
        _ => Ok(revisions.pop()),
    }
}

/// Returns the scenes in a folder of T4 scenes, by name. Looks at up to `most` of its entries.
fn scenes(root: &Path, most: usize) -> Vec<T4Scene> {
    let scene = |name: String| {
        let folder = root.join(&name);
        let folder = match has_t4_tables(&folder) {
            true => folder,
            false => folder.join(revisions(&folder).pop()?),
        };
        Some(T4Scene { name, tables: folder.join(T4_TABLES) })
    };
    folders_in(root, most).unwrap_or_default().into_iter().filter_map(scene).collect()
}

fn has_t4_tables(folder: &Path) -> bool {
    is_taken(&folder.join(T4_TABLES).join(MARK))
}

/// Returns the folder of the scene that a locator names, and what is left of its `#SCENE`: a scene is named
/// by its folder, its name or its token. `None` if there are no scenes.
fn choose_scene<'a>(
    locator: &LogLocator,
    scenes: &'a [T4Scene],
) -> Result<Option<(&'a str, Option<String>)>, DatasetError> {
    let wanted = locator.scene.clone();
    let of_folder = scenes.iter().find(|scene| Some(&scene.name) == wanted.as_ref());
    match (scenes, of_folder, &wanted) {
        ([], ..) => return Ok(None),
        (_, Some(scene), _) => return Ok(Some((&scene.name, None))),
        ([only], _, None) => return Ok(Some((&only.name, None))),
        _ => {}
    }
    let mut fitting = Vec::new();
    for scene in scenes.iter().filter(|_| wanted.is_some()) {
        let table = Table::<Scene>::load(&scene.tables)?;
        let fits = |s: &Scene| Some(&s.name) == wanted.as_ref() || Some(&s.token) == wanted.as_ref();
        if table.records.iter().any(fits) {
            fitting.push(scene);
        }
    }
    match fitting.as_slice() {
        [only] => Ok(Some((&only.name, wanted))),
        _ => {
            let scenes = scenes.iter().map(|scene| scene.name.clone()).collect();
            Err(DatasetError::Scene { found: wanted, scenes, path: locator.path.clone() })
        }
    }
}

/// Returns whether a scene was recorded at a location.
fn is_recorded_at(tables: &Path, location: &str) -> Result<bool, DatasetError> {
    if !is_taken(&LogRecord::path_in(tables)) {
        return Ok(false);
    }
    Ok(Table::<LogRecord>::load(tables)?.records.iter().any(|log| log.location == location))
}

impl LogRecord {
    /// Returns the path of the log table.
    pub(super) fn path_in(tables: &Path) -> PathBuf {
        <Self as super::tables::Record>::path(tables)
    }
}

/// Folder of sweeps and images.
#[derive(Debug)]
pub(super) struct SensorFiles {
    root: DataRoot,
    /// Start of the names of its folders, if tables leave it out.
    prefix: Option<String>,
}

impl SensorFiles {
    /// Returns the files that tables in a folder name.
    pub(super) fn new(root: DataRoot, tables: &Path) -> Self {
        let name = tables.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
        let prefix = name.strip_suffix(PREFIXED).filter(|prefix| !prefix.is_empty());
        Self { prefix: prefix.map(|prefix| format!("{prefix}_")), root }
    }

    /// Resolves a name from the tables to a path. With tables in `train_data`, `images/NAME` is
    /// `train_images/NAME` unless there is a folder `images`.
    ///
    /// # Errors
    /// Fails as [`DataRoot::resolve`].
    pub(super) fn resolve(&self, name: &str) -> Result<PathBuf, NameError> {
        let prefixed = self.prefix.as_ref().map(|prefix| format!("{prefix}{name}"));
        let folder = |name: &str| self.root.path.join(name.split(['/', '\\']).next().unwrap_or_default());
        match prefixed.filter(|prefixed| !is_taken(&folder(name)) && folder(prefixed).is_dir()) {
            Some(prefixed) => self.root.resolve(&prefixed),
            None => self.root.resolve(name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_folders_are_searched_up_to_a_limit() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "b", "c"] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
        }
        assert_eq!(folders_in(folder.path(), usize::MAX).unwrap(), ["a", "b", "c"]);
        assert_eq!(folders_in(folder.path(), 2).unwrap().len(), 2);
    }
}
