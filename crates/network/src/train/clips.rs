//! Training clips: recorded once, stored in a folder, reused later.

use std::path::{Path, PathBuf};

use point_skeleton::Log;
use point_skeleton::error::FileError;
use point_skeleton::files::{Inputs, OutputFolder, check_place};
use point_skeleton::raster::RasterizerDesc;
use point_skeleton::scene::EgoOffset;
use point_skeleton::skeleton;
use pskel_generate::TrainingClip;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Uniform};
use rand_seeder::Seeder;

use super::record::{RecordError, Source, Variant};
use crate::NetworkConfig;

/// Options for recording training clips.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Clips per log: the first at the recorded poses, the others of synthetic logs offset and rotated.
    pub variants: usize,
    /// Whether assets of the other clips are degraded.
    pub augment: bool,
    /// Rasterizer of the conditions.
    pub rasterizer: RasterizerDesc,
}

impl Default for RecordOptions {
    fn default() -> Self {
        Self { variants: 3, augment: true, rasterizer: RasterizerDesc::default() }
    }
}

/// Recorder of training clips for a network.
#[derive(Clone, Copy)]
pub struct ClipRecorder<'a> {
    /// Folder of the clips.
    pub folder: &'a Path,
    /// Everything that the command reads, and that must not contain the folder.
    pub read: &'a Inputs,
    /// Network, which determines the recipe of the conditions.
    pub config: &'a NetworkConfig,
    /// Number and kind of the clips.
    pub options: &'a RecordOptions,
}

/// Kind of the output folder.
const KIND: &str = "recordings";
/// Seed of poses and assets of variants. It is not the training's seed: trainings share clips.
const SEED: u64 = 1;
/// Maximum offset of a variant to either side, meters.
const BESIDE_M: f64 = 3.5;
/// Maximum rotation of a variant, radians.
const TURNED_RAD: f64 = 0.1;

impl ClipRecorder<'_> {
    /// Checks, before any log is read, that the folder may be written.
    ///
    /// # Errors
    /// Fails as [`check_place`].
    pub fn check(&self) -> Result<(), FileError> {
        check_place(self.folder, self.read)
    }

    /// Returns the clips of a log, in order. Missing ones are recorded to files whose names begin with
    /// `name`.
    ///
    /// # Errors
    /// Fails if the log does not have 1 to 8 cameras, if an existing clip or skeleton is of another
    /// recording, or a clip of another recipe, or if a clip cannot be rendered or written.
    pub fn clips(&self, name: &str, log: &Log) -> Result<Vec<TrainingClip>, RecordError> {
        let found = log.recording().rig.len();
        if NetworkConfig::check_cameras(found).is_err() {
            return Err(RecordError::Cameras { found, log: log.name().to_owned() });
        }
        let fingerprint = fingerprint(log)?;
        let files: Vec<PathBuf> = (0..self.options.variants).map(|number| self.file(name, number)).collect();
        if files.iter().any(|file| !file.is_file()) {
            self.record(name, (log, &fingerprint), &files)?;
        }
        files.iter().map(|file| Ok(self.open(name, (log.name(), &fingerprint), file)?)).collect()
    }

    /// Returns the path of a clip, `NAME-VARIANT[a].safetensors`.
    fn file(&self, name: &str, number: usize) -> PathBuf {
        let suffix = if self.options.augment && number > 0 { "a" } else { "" };
        self.folder.join(format!("{name}-{number}{suffix}.safetensors"))
    }

    /// Records missing clips. The skeleton is retained for later ones. Only recording locks the folder:
    /// trainings share it.
    fn record(
        &self,
        name: &str,
        (log, fingerprint): (&Log, &str),
        files: &[PathBuf],
    ) -> Result<(), RecordError> {
        let folder = OutputFolder::open(self.folder, KIND, self.read)?;
        let skeleton = skeleton::open_or_build(&folder.folder(format!("{name}.skeleton"))?, log.reader())?;
        let (recipe, rasterizer) = (&self.config.recipe, &self.options.rasterizer);
        let source = Source { log, fingerprint, skeleton: &skeleton, recipe, rasterizer };
        for (number, file) in files.iter().enumerate().filter(|(_, file)| !file.is_file()) {
            let file = file.file_name().unwrap_or_default();
            source.record(self.variant(log, number))?.save(&folder.claim(file)?)?;
        }
        Ok(folder.close()?)
    }

    fn variant(&self, log: &Log, number: usize) -> Variant {
        if number == 0 {
            return Variant::default();
        }
        let mut random: ChaCha8Rng = Seeder::from((SEED, log.name(), number as u64)).into_rng();
        let mut within =
            |most: f64| Uniform::new_inclusive(-most, most).map_or(0.0, |range| range.sample(&mut random));
        // Recorded images exist at the recorded poses alone.
        let offset = match log.reader().view_renderer() {
            Some(_) => EgoOffset {
                forward_m: 0.0,
                left_m: within(BESIDE_M),
                yaw_deg: within(TURNED_RAD).to_degrees(),
            },
            None => EgoOffset::default(),
        };
        Variant { offset, augment: self.options.augment.then_some(SEED ^ number as u64) }
    }

    /// Opens a clip, which must be of the same recording, by its name and fingerprint, and have the same
    /// recipe.
    fn open(
        &self,
        name: &str,
        (log, fingerprint): (&str, &str),
        file: &Path,
    ) -> Result<TrainingClip, FileError> {
        let clip = TrainingClip::open(file)?;
        let recipe = &self.config.recipe;
        if (clip.about.log.as_str(), &clip.about.recipe) != (log, recipe) {
            let expected = format!("a drive of {log} recorded by {recipe:?}");
            let found = format!("one of {} by {:?}", clip.about.log, clip.about.recipe);
            return Err(FileError::content(expected, found, file));
        }
        if clip.about.source != fingerprint {
            let expected = format!("a drive of this recording of {log}");
            let named = file.file_name().unwrap_or_default().display();
            let found = format!(
                "one of another recording or state of that name, or of an earlier version; remove {named} \
                    and {name}.skeleton, or use another folder of drives"
            );
            return Err(FileError::content(expected, found, file));
        }
        Ok(clip)
    }
}

/// Returns the fingerprints of a recording and of its HD map.
fn fingerprint(log: &Log) -> Result<String, RecordError> {
    let map = log.require_map()?.map_or("no map".to_owned(), |map| map.vector_map().fingerprint());
    Ok(format!("{} {map}", log.recording().fingerprint()))
}
