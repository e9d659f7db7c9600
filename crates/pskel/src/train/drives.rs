//! Training clips: recorded once, stored in a folder, reused later.

use std::path::{Path, PathBuf};

use anyhow::Context;
use point_skeleton::dataset::{Dataset, LogLocator};
use point_skeleton::error::FileError;
use point_skeleton::files::OutputFolder;
use point_skeleton::scene::EgoOffset;
use point_skeleton::skeleton;
use pskel_generate::{Recipe, TrainingClip};
use pskel_town::Town;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Uniform};
use rand_seeder::Seeder;

use super::record::{Source, Variant};
use crate::logs;
use crate::progress::Progress;
use crate::rasterizer::RasterizerArgs;

/// Recording of training clips.
pub(super) struct Recording<'a> {
    /// Folder of the clips.
    pub(super) folder: &'a Path,
    pub(super) recipe: &'a Recipe,
    /// Number of cameras of the network.
    pub(super) cameras: usize,
    /// Clips per log: the first at the recorded poses, the others offset.
    pub(super) variants: usize,
    /// `true` if the assets of the other clips are degraded.
    pub(super) augment: bool,
    pub(super) rasterizer: &'a RasterizerArgs,
}

/// Kind of the output folder.
const KIND: &str = "recordings";
/// Seed of poses and assets of variants. It is not the training's seed: trainings share clips.
const SEED: u64 = 1;
/// Maximum offset of a variant to either side, meters.
const BESIDE_M: f64 = 3.5;
/// Maximum rotation of a variant, radians.
const TURNED_RAD: f64 = 0.1;

impl Recording<'_> {
    /// Returns the clips of all logs, in order; missing ones are recorded.
    pub(super) fn drives(&self, locators: &[LogLocator]) -> anyhow::Result<Vec<TrainingClip>> {
        let mut progress = Progress::new(locators.len());
        let mut drives = Vec::new();
        for locator in locators {
            let town = logs::open_town(locator)?;
            self.check(&town).with_context(|| format!("log {locator}"))?;
            drives.extend(self.of_town(&town).with_context(|| format!("log {locator}"))?);
            progress.step(&town.log().name);
        }
        Ok(drives)
    }

    /// Checks the number of cameras before anything is recorded.
    fn check(&self, town: &Town) -> anyhow::Result<()> {
        let found = town.log().rig.len();
        anyhow::ensure!(
            found == self.cameras,
            "expected {} cameras, as the network has, found {found}",
            self.cameras
        );
        Ok(())
    }

    fn of_town(&self, town: &Town) -> anyhow::Result<Vec<TrainingClip>> {
        let files: Vec<PathBuf> = (0..self.variants).map(|number| self.file(town, number)).collect();
        if files.iter().any(|file| !file.is_file()) {
            self.record(town, &files)?;
        }
        files.iter().map(|file| Ok(self.open(town, file)?)).collect()
    }

    /// Returns the path of a clip, `LOG-VARIANT[a].safetensors`.
    fn file(&self, town: &Town, number: usize) -> PathBuf {
        let worse = if self.augment && number > 0 { "a" } else { "" };
        self.folder.join(format!("{}-{number}{worse}.safetensors", town.recording()))
    }

    /// Records missing clips. The skeleton is retained for later ones. Only recording locks the folder: trainings
    /// share it.
    fn record(&self, town: &Town, files: &[PathBuf]) -> anyhow::Result<()> {
        let folder = OutputFolder::open(self.folder, KIND, &[])?;
        let path = self.folder.join(format!("{}.skeleton", town.recording()));
        let skeleton = skeleton::open_or_build(&path, town)?;
        let source = Source { town, skeleton: &skeleton, recipe: self.recipe, rasterizer: self.rasterizer };
        for (number, file) in files.iter().enumerate().filter(|(_, file)| !file.is_file()) {
            let name = file.file_name().unwrap_or_default();
            source.record(self.variant(&town.log().name, number))?.save(&folder.claim(name)?)?;
        }
        Ok(folder.close()?)
    }

    fn variant(&self, log: &str, number: usize) -> Variant {
        if number == 0 {
            return Variant::default();
        }
        let mut random: ChaCha8Rng = Seeder::from((SEED, log, number as u64)).into_rng();
        let mut within =
            |most: f64| Uniform::new_inclusive(-most, most).map_or(0.0, |range| range.sample(&mut random));
        let offset = EgoOffset { x_m: 0.0, y_m: within(BESIDE_M), yaw_rad: within(TURNED_RAD) };
        Variant { offset, augment: self.augment.then_some(SEED ^ number as u64) }
    }

    /// Opens a clip, which must have the same log and recipe.
    fn open(&self, town: &Town, file: &Path) -> Result<TrainingClip, FileError> {
        let drive = TrainingClip::open(file)?;
        let (log, recipe) = (&town.log().name, self.recipe);
        if (&drive.about.log, &drive.about.recipe) != (log, recipe) {
            let expected = format!("a drive of {log} recorded by {recipe:?}");
            let found = format!("one of {} by {:?}", drive.about.log, drive.about.recipe);
            return Err(FileError::content(expected, found, file));
        }
        Ok(drive)
    }
}
