//! Names and lengths of scenes, from two of the tables.

use std::path::PathBuf;

use super::chain::Chain;
use super::choose::{choose_scene, version_folder};
use super::tables::{Sample, Scene, Table};
use crate::dataset::notes::Notes;
use crate::dataset::{DatasetError, LogLocator, LogOutline};

/// Scenes and samples of a version.
pub(in crate::dataset) struct SceneIndex {
    tables: PathBuf,
    scenes: Table<Scene>,
    samples: Table<Sample>,
}

impl SceneIndex {
    /// Reads the tables of a locator.
    ///
    /// # Errors
    /// Fails if they are missing or damaged.
    pub(in crate::dataset) fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        let tables = version_folder(&locator.path, locator.version.as_deref())?;
        Ok(Self { scenes: Table::load_all(&tables)?, samples: Table::load_all(&tables)?, tables })
    }

    /// Returns whether the tables are those of a locator.
    pub(in crate::dataset) fn is_of(&self, locator: &LogLocator) -> bool {
        let tables = version_folder(&locator.path, locator.version.as_deref());
        tables.is_ok_and(|tables| tables == self.tables)
    }

    /// Returns the outline of a scene.
    ///
    /// # Errors
    /// Fails if the scene is unknown or its chain of samples is damaged.
    pub(in crate::dataset) fn outline(&self, locator: &LogLocator) -> Result<LogOutline, DatasetError> {
        let scene = choose_scene(&self.scenes, locator.scene.as_deref())?;
        let chain = Chain::of(&self.samples, scene, &mut Notes::new())?;
        Ok(LogOutline { name: scene.name.clone(), frames: chain.times_us.len() })
    }
}
