use std::path::Path;

use super::args::RenderOptions;
use crate::cli::map_args::MapFormat;
use crate::conditions::birdseye::{self, BirdseyeOptions};
use crate::conditions::meta::{FrameMeta, Index, PromptParts};
use crate::conditions::{ConditionError, ConditionOptions, ConditionSet, sheet};
use crate::error::{FileError, write_whole_folder};
use crate::report::ROLLOUT;
use crate::scene::SceneState;

/// A step with its maps.
pub(super) struct Rendered {
    pub(super) state: SceneState,
    pub(super) set: ConditionSet,
}

/// The folder of maps.
pub(super) struct Output<'a> {
    pub(super) folder: &'a Path,
    pub(super) format: MapFormat,
    pub(super) options: &'a ConditionOptions,
    pub(super) prompt: &'a PromptParts,
    pub(super) fps: Option<f64>,
    /// Whether maps are distorted.
    pub(super) distort: bool,
    /// Whether a picture from above is written.
    pub(super) birdseye: bool,
    /// Name of the log.
    pub(super) log: &'a str,
}

const INDEX: &str = "index.json";
const META: &str = "meta.json";

impl Output<'_> {
    /// An index of an earlier run goes first: while there is one, the folder is complete. That of a rollout stays.
    pub(super) fn begin(&self) -> Result<(), FileError> {
        if self.folder.join(ROLLOUT).exists() {
            let expected = "a folder for maps of render";
            return Err(FileError::content(expected, format!("a rollout with {ROLLOUT}"), self.folder));
        }
        let index = self.folder.join(INDEX);
        match std::fs::remove_file(&index) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(FileError::io("replace", &index)(error))
            }
            _ => Ok(()),
        }
    }

    /// Writes the folder of a step.
    pub(super) fn write(&self, step: &Rendered) -> Result<(), ConditionError> {
        let (state, set) = (&step.state, &step.set);
        let bins = &self.options.depth_bins;
        write_whole_folder(&self.folder.join(&state.name), META, |folder| {
            self.format.write(folder, set, state.t_us, self.options)?;
            let caption = format!("{}  {}", self.log, state.name);
            sheet::write(&folder.join("sheet.png"), set, bins, &caption)?;
            if self.birdseye {
                birdseye::write(&folder.join("birdseye.png"), state, &BirdseyeOptions::default())?;
            }
            let meta = FrameMeta::new(state, self.options, self.prompt, self.fps);
            let meta = if self.distort { meta.distorted(state) } else { meta };
            Ok(meta.write(&folder.join(META))?)
        })
    }

    /// Writes the index, last of all.
    pub(super) fn end(&self, index: &Index<&RenderOptions>) -> Result<(), FileError> {
        index.write(&self.folder.join(INDEX))
    }
}
