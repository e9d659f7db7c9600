use std::path::Path;
use std::sync::Arc;

use crate::Error;
use crate::conditions::write::meta::{FrameMeta, PromptParts};
use crate::conditions::{CameraConditions, ConditionOptions, ConditionSet, MapFormat};
use crate::error::FileError;
use crate::scene::SceneState;

/// Condition maps of a state: one set per camera.
#[derive(Clone, Debug)]
pub struct Maps {
    /// Rendered state.
    pub state: SceneState,
    /// Maps of all cameras.
    pub set: ConditionSet,
    pub(crate) options: Arc<ConditionOptions>,
    /// Share of empty pixels per camera, as [`Maps::uncovered`], if maps are distorted.
    pub(crate) distorted: Option<Vec<f64>>,
}

impl Maps {
    /// Returns the maps of all cameras, in the order of the state's cameras.
    pub fn cameras(&self) -> &[CameraConditions] {
        &self.set.cameras
    }

    /// Returns the maps of a camera by channel name.
    pub fn camera(&self, name: &str) -> Option<&CameraConditions> {
        self.set.cameras.iter().find(|camera| camera.name == *name)
    }

    /// Returns, per camera, the share of pixels that are empty because the lens shows more there than a
    /// pinhole image can ([`uncovered`](crate::conditions::distort::uncovered)). Empty unless the maps have
    /// the distortion of the lenses.
    pub fn uncovered(&self) -> &[f64] {
        self.distorted.as_deref().unwrap_or_default()
    }

    /// Writes a PNG per map and `meta.json` (cameras and poses) into a folder, which is created if it does
    /// not exist.
    ///
    /// # Errors
    /// Fails if a file cannot be written, or if a number does not fit into a PNG.
    pub fn write(&self, folder: impl AsRef<Path>) -> Result<(), Error> {
        self.write_as(folder, MapFormat::Png)
    }

    /// Writes the maps in a format, and `meta.json`, into a folder, which is created if it does not exist.
    ///
    /// # Errors
    /// Fails if a file cannot be written, or if the maps do not fit into the format.
    pub fn write_as(&self, folder: impl AsRef<Path>, format: MapFormat) -> Result<(), Error> {
        let folder = folder.as_ref();
        std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
        self.write_maps(folder, format)?;
        Ok(self.meta(&PromptParts::default(), None).write(&folder.join("meta.json"))?)
    }

    /// Writes the maps without `meta.json` into an existing folder.
    ///
    /// # Errors
    /// Fails as [`Maps::write_as`].
    pub fn write_maps(&self, folder: &Path, format: MapFormat) -> Result<(), Error> {
        Ok(format.write(folder, &self.set, self.state.t_us, &self.options)?)
    }

    /// Returns the metadata of the maps; `fps` is the frame rate of the sequence, if any.
    pub fn meta(&self, prompt: &PromptParts, fps: Option<f64>) -> FrameMeta {
        let meta = FrameMeta::new(&self.state, &self.options, prompt, fps);
        match &self.distorted {
            Some(uncovered) => meta.distorted(&self.state, uncovered),
            None => meta,
        }
    }
}
