use point_skeleton::conditions::birdseye::{self, BirdseyeOptions};
use point_skeleton::conditions::meta::{FrameMeta, Index, PromptParts};
use point_skeleton::conditions::{ConditionError, ConditionOptions, ConditionSet, sheet};
use point_skeleton::error::FileError;
use point_skeleton::files::OutputFolder;
use point_skeleton::scene::SceneState;

use super::args::RenderOptions;
use crate::map_args::MapFormat;

/// Rendered step with its maps.
pub(super) struct Rendered {
    pub(super) state: SceneState,
    pub(super) set: ConditionSet,
}

/// Output folder of maps.
pub(super) struct Output<'a> {
    pub(super) folder: OutputFolder,
    pub(super) format: MapFormat,
    pub(super) options: &'a ConditionOptions,
    pub(super) prompt: &'a PromptParts,
    pub(super) fps: Option<f64>,
    /// `true` if maps are distorted.
    pub(super) distort: bool,
    /// `true` if a bird's-eye view is written.
    pub(super) birdseye: bool,
    /// Name of the log.
    pub(super) log: &'a str,
}

const INDEX: &str = "index.json";
const META: &str = "meta.json";

impl Output<'_> {
    /// Checks that steps of these names may be written, and removes the index of an earlier run: a folder with an
    /// index is complete.
    pub(super) fn begin(&self, steps: impl Iterator<Item = String>) -> Result<(), FileError> {
        self.folder.check(steps)?;
        self.folder.remove([INDEX])
    }

    /// Writes the folder of a step.
    pub(super) fn write(&self, step: &Rendered) -> Result<(), ConditionError> {
        let (state, set) = (&step.state, &step.set);
        let bins = &self.options.depth_bins;
        self.folder.write_folder(&state.name, |folder| {
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

    /// Writes the index, as the last file.
    pub(super) fn end(self, index: &Index<&RenderOptions>) -> Result<(), FileError> {
        index.write(&self.folder.claim(INDEX)?)?;
        self.folder.close()
    }
}
