//! Generator options of the command line: the network and its strategy.

use std::path::{Path, PathBuf};

use clap::Args;
use point_skeleton::conditions::{Captions, FrameCaptions};
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::files::json;
use point_skeleton::files::text::printable;
use pskel_generate::{DenoiserRig, Guidance, GuidedConditions, Preset, Recipe, SamplerOptions, Strategy};
use pskel_network::{GeneratorSettings, NetworkName, OpenedNetwork};
use pskel_sim::peer::MAX_TIMEOUT_S;

use super::names::names;
use super::numbers::finite;
use crate::WrongUsage;

/// Options for generating images from conditions.
#[derive(Clone, Debug, Args)]
pub(crate) struct GeneratorArgs {
    /// Strategy for advancing the window [default: reset_and_roll]
    #[arg(long, value_name = "STRATEGY", value_parser = names::<Strategy>())]
    strategy: Option<Strategy>,
    /// Frames in the window, L; the first L - 1 frames are ground-truth images [default: the window the
    /// network was trained with; 4 for a process]
    #[arg(long, value_name = "L")]
    window: Option<usize>,
    /// Inference steps, T; with rolling strategies a multiple of L - C [default: L - C]
    #[arg(long, value_name = "T")]
    infer_steps: Option<usize>,
    /// With reset_and_roll: leading frames of the window that are always clean [default: 0]
    #[arg(long, value_name = "C")]
    clean: Option<usize>,
    /// With --strategy non_causal: forecasts in the window [default: 1]
    #[arg(long, value_name = "K")]
    ahead: Option<usize>,
    /// With --strategy causal: noise on the previous frames, in steps of 1000 [default: 0]
    #[arg(long, value_name = "N")]
    history_noise: Option<usize>,
    /// Scale of classifier-free guidance; 1 disables it, other values evaluate the network twice [default: 1]
    #[arg(long, value_name = "S", value_parser = scale, allow_negative_numbers = true)]
    guidance: Option<f32>,
    /// Conditions dropped in the second evaluation of the guidance: layout, text and action, or also color
    /// and depth [default: layout]
    #[arg(long, value_parser = names::<GuidedConditions>())]
    guide: Option<GuidedConditions>,
    /// Seed of the noise [default: 0]
    #[arg(long, value_name = "SEED")]
    noise_seed: Option<u64>,
    /// With process:.., the kind of its predictions [default: flow_match]
    #[arg(long, value_parser = names::<SamplerOptions>())]
    sampler: Option<SamplerOptions>,
    /// With process:.. and fill, the recipe of the conditions as JSON, in which missing fields have their
    /// defaults; or pas-nuscenes or pas-nuplan, that of a network of the paper with the defaults of its
    /// window, steps and guidance
    #[arg(long, value_name = "RECIPE")]
    recipe: Option<PathBuf>,
    /// Captions, in place of the prompt of --annotations, by name of a recording or token of an image:
    /// {"scene-0061": "Parked truck, turn left"}. A frame without one has that of the frame before
    #[arg(long, value_name = "F.json")]
    captions: Option<PathBuf>,
    /// With process:.., time-out for each of its answers, seconds [default: 60]
    #[arg(long, value_name = "S", value_parser = timeout_s)]
    generator_timeout: Option<f64>,
}

impl GeneratorArgs {
    /// Rejects options that have no effect.
    pub(crate) fn check(&self, name: Option<&NetworkName>) -> Result<(), WrongUsage> {
        let Self { strategy, clean, guidance, .. } = self;
        let strategy = strategy.unwrap_or_default();
        let rolls = matches!(strategy, Strategy::ResetAndRoll | Strategy::Rolling);
        let is_process = matches!(name, Some(NetworkName::Process(_)));
        let takes_recipe = is_process || matches!(name, Some(NetworkName::Fill));
        let preset = self.preset().map(|preset| preset.guidance);
        let guided = guidance.or(preset).is_some_and(|scale| scale != 1.0);
        let network = "--generator";
        let process = "--generator process:..";
        let options = [
            ("--strategy", self.strategy.is_some(), true, network),
            ("--window", self.window.is_some(), true, network),
            ("--infer-steps", self.infer_steps.is_some(), true, network),
            ("--guidance", guidance.is_some(), true, network),
            ("--noise-seed", self.noise_seed.is_some(), true, network),
            ("--captions", self.captions.is_some(), true, network),
            ("--clean", clean.is_some(), rolls, "--strategy reset_and_roll or rolling"),
            (
                "--ahead",
                self.ahead.is_some(),
                matches!(strategy, Strategy::NonCausal { .. }),
                "--strategy non_causal",
            ),
            (
                "--history-noise",
                self.history_noise.is_some(),
                matches!(strategy, Strategy::Causal { .. }),
                "--strategy causal",
            ),
            ("--guide", self.guide.is_some(), guided, "--guidance other than 1"),
            ("--sampler", self.sampler.is_some(), is_process, process),
            ("--recipe", self.recipe.is_some(), takes_recipe, "--generator process:.. or fill"),
            ("--generator-timeout", self.generator_timeout.is_some(), is_process, process),
        ];
        let given = options.into_iter().filter(|(_, is_given, ..)| *is_given);
        let unused = given.into_iter().find(|(_, _, does, _)| name.is_none() || !does);
        let Some((option, _, _, needs)) = unused else { return Ok(()) };
        let needs = if name.is_none() { network } else { needs };
        Err(WrongUsage(format!("expected {needs} with {option}, found none")))
    }

    /// Opens or starts the network for the cameras of a log.
    pub(crate) fn open(&self, name: &NetworkName, rig: &DenoiserRig) -> anyhow::Result<OpenedNetwork> {
        let opened = self.settings()?.open(name, rig);
        opened.map_err(|error| match error.is_usage() {
            true => WrongUsage(error.to_string()).into(),
            false => error.into(),
        })
    }

    /// Reads the captions of a log.
    pub(crate) fn captions(&self, log: &Recording) -> Result<Option<FrameCaptions>, FileError> {
        let (Some(path), Some(captions)) = (&self.captions, self.all_captions()?) else { return Ok(None) };
        captions.of_frames(log).map(Some).ok_or_else(|| {
            let expected = format!("captions of log {} or of its images", printable(&log.name));
            FileError::content(expected, "captions of others", path)
        })
    }

    /// Returns the files that are read: captions and recipe.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        let recipe = self.recipe.as_deref().filter(|_| self.preset().is_none());
        self.captions.as_deref().into_iter().chain(recipe)
    }

    /// Reads the captions of all logs.
    pub(crate) fn all_captions(&self) -> Result<Option<Captions>, FileError> {
        self.captions.as_deref().map(Captions::read).transpose()
    }

    fn preset(&self) -> Option<Preset> {
        self.recipe.as_deref().and_then(Path::to_str).and_then(Preset::named)
    }

    fn settings(&self) -> Result<GeneratorSettings, FileError> {
        let defaults = GeneratorSettings::default();
        let preset = self.preset();
        let default_guidance = preset.as_ref().map_or(1.0, |preset| preset.guidance);
        let recipe = match (&preset, &self.recipe) {
            (Some(preset), _) => preset.recipe.clone(),
            (None, Some(path)) => read_recipe(path)?,
            (None, None) => defaults.recipe,
        };
        let dropped = self.guide.unwrap_or_default().into();
        Ok(GeneratorSettings {
            window: self.window.or(preset.as_ref().map(|preset| preset.window)),
            steps: self.infer_steps.or(preset.as_ref().map(|preset| preset.steps)),
            clean: self.clean.unwrap_or(defaults.clean),
            strategy: self.strategy.unwrap_or_default().with(self.history_noise, self.ahead),
            sampler: self.sampler.unwrap_or_default(),
            guidance: Guidance { scale: self.guidance.unwrap_or(default_guidance), dropped },
            noise_seed: self.noise_seed.unwrap_or(defaults.noise_seed),
            recipe,
            timeout_s: self.generator_timeout.unwrap_or(defaults.timeout_s),
        })
    }
}

fn read_recipe(path: &Path) -> Result<Recipe, FileError> {
    let recipe: Recipe = json::read(path, "a recipe of conditions")?;
    recipe.check().map_err(|error| FileError::content(error.expected, error.found, path))?;
    Ok(recipe)
}

/// Parses a factor from 0 to 100.
fn scale(text: &str) -> Result<f32, String> {
    let scale = finite(text).filter(|v| (0.0..=100.0).contains(v)).map(|v| v as f32);
    scale.ok_or_else(|| "expected a factor from 0 to 100".into())
}

/// Parses a time-out in seconds.
fn timeout_s(text: &str) -> Result<f64, String> {
    let seconds = finite(text).filter(|v| *v > 0.0 && *v <= MAX_TIMEOUT_S);
    seconds.ok_or_else(|| format!("expected seconds, more than 0 and at most {MAX_TIMEOUT_S}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_and_time_outs_have_ranges() {
        assert_eq!((scale("1.5"), scale("0")), (Ok(1.5), Ok(0.0)));
        assert!(scale("-1").is_err() && scale("nan").is_err() && scale("101").is_err());
        assert_eq!(timeout_s("0.5"), Ok(0.5));
        assert!(timeout_s("0").is_err() && timeout_s("inf").is_err());
    }
}
