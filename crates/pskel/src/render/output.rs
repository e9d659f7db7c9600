use point_skeleton::conditions::birdseye::{self, BirdseyeOptions};
use point_skeleton::conditions::meta::{Index, PromptParts};
use point_skeleton::conditions::{DepthBins, MapFormat, sheet};
use point_skeleton::error::FileError;
use point_skeleton::files::OutputFolder;
use point_skeleton::{Error, Maps};

use super::args::RenderOptions;

/// Output folder of maps.
pub(super) struct Output<'a> {
    pub(super) folder: OutputFolder,
    pub(super) format: MapFormat,
    pub(super) bins: &'a DepthBins,
    pub(super) prompt: &'a PromptParts,
    pub(super) fps: Option<f64>,
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
    pub(super) fn write(&self, maps: &Maps) -> Result<(), Error> {
        let state = &maps.state;
        self.folder.write_folder(&state.name, |folder| {
            maps.write_maps(folder, self.format)?;
            let caption = format!("{}  {}", self.log, state.name);
            sheet::write(&folder.join("sheet.png"), &maps.set, self.bins, &caption)?;
            if self.birdseye {
                birdseye::write(&folder.join("birdseye.png"), state, &BirdseyeOptions::default())?;
            }
            Ok(maps.meta(self.prompt, self.fps).write(&folder.join(META))?)
        })
    }

    /// Writes the index, as the last file.
    pub(super) fn end(self, index: &Index<&RenderOptions>) -> Result<(), FileError> {
        index.write(&self.folder.claim(INDEX)?)?;
        self.folder.close()
    }
}
