use std::collections::BTreeMap;
use std::path::Path;

use point_skeleton::conditions::write::{exr, png};
use point_skeleton::conditions::{CameraConditions, ConditionError, ConditionSet, DepthBins};
use point_skeleton::dataset::nuscenes::LogWriter;
use point_skeleton::dataset::{DatasetError, LogReader};
use point_skeleton::error::FileError;
use point_skeleton::files::{FileName, write_json};

use super::truth::reserve_meshes;
use super::{Town, TownError};
use crate::view::GroundTruthView;

/// Name of the table folder.
const VERSION: &str = "v1.0-town";
/// File of the options.
const OPTIONS: &str = "town.json";
const TRUTH: &str = "truth";

/// Error of writing a town.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The log cannot be written.
    #[error(transparent)]
    Log(#[from] DatasetError),
    /// Ground truth cannot be rendered.
    #[error(transparent)]
    Town(#[from] TownError),
    /// Ground truth cannot be written.
    #[error(transparent)]
    Maps(#[from] ConditionError),
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
}

impl Town {
    /// Writes the log as a data set in nuScenes layout into an existing folder, and the options to
    /// `town.json`. Calls `frame_done` with the index of each written frame.
    ///
    /// # Errors
    /// Fails if memory is insufficient, or if an image cannot be rendered or a file cannot be written.
    pub fn write(&self, folder: &Path, frame_done: &dyn Fn(usize)) -> Result<(), WriteError> {
        drop(reserve_meshes()?); // before the sweeps, which need the meshes too
        let layers = self.map_layers();
        LogWriter { version: VERSION, map: Some(&layers), frame_done }.write(folder, self)?;
        let options = BTreeMap::from([("town", self.options.to_string())]);
        Ok(write_json(&folder.join(OPTIONS), &options)?)
    }

    /// Writes the ground truth of every image into an existing folder: `truth/FRAME/CAM/depth.exr` (meters),
    /// `class.png` and `instance.png`, with the numbers of that frame's maps. Calls `frame_done` with the
    /// index of each written frame.
    ///
    /// # Errors
    /// Fails if an image cannot be rendered or a file cannot be written.
    pub fn write_truth(&self, folder: &Path, frame_done: &mut dyn FnMut(usize)) -> Result<(), WriteError> {
        let log = self.recording();
        for (index, frame) in log.frames.iter().enumerate() {
            let cameras = frame.images.iter().map(|image| log.cameras[image.channel].clone());
            let (depth, masks) =
                cameras.zip(self.truth_of_frame(index)?).map(|(name, view)| maps(name, view)).unzip();
            let folder = folder.join(TRUTH).join(format!("{index:06}"));
            std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
            exr::write(&folder, &ConditionSet { cameras: depth })?;
            png::write(&folder, &ConditionSet { cameras: masks }, &DepthBins::default())?;
            frame_done(index);
        }
        Ok(())
    }
}

/// Splits a view into depth, and class with instance, as the writers require.
fn maps(name: FileName, view: GroundTruthView) -> (CameraConditions, CameraConditions) {
    let (width, height) = view.image.dimensions();
    let bare = CameraConditions { name, width, height, ..CameraConditions::default() };
    let depth = CameraConditions { depth_m: Some(view.depth_m), ..bare.clone() };
    (depth, CameraConditions { class: Some(view.class), instance: Some(view.instance), ..bare })
}
