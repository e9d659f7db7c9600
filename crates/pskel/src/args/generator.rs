//! Generator options of the command line: the network and its strategy.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use point_skeleton::Log;
use point_skeleton::conditions::{Captions, FrameCaptions};
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::files::text::printable;
use point_skeleton::named::{Named, UnknownName};
use pskel_generate::{
    ConditionKind, DenoiserRig, Guidance, GuidedConditions, Preset, Recipe, SamplerOptions, Strategy,
};
use pskel_network::{DEFAULT_WINDOW, GeneratorName, GeneratorSettings, NetworkName, OpenedGenerator};
use pskel_sim::peer::MAX_TIMEOUT_S;

use super::names::names;
use super::numbers::finite;
use crate::WrongUsage;

/// Options for generating images from conditions.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Generator")]
pub(crate) struct GeneratorArgs {
    /// Generate the cameras' images with a network: network (shipped with the program), network:FILE with
    /// weights of `python -m pskel.train`, fill (no network: holes filled), process:PEER, a denoiser
    /// (docs/src/reference/denoiser.md), or images:PEER, which makes whole images
    /// (docs/src/reference/images.md); PEER is a COMMAND, unix:PATH or tcp:HOST:PORT. Each planning step gets
    /// steps/STEP/generated, and truth if ground truth is known. Map options apply to the written maps; the
    /// network's conditions are rendered as in its training
    #[arg(long, value_name = "GENERATOR")]
    pub(crate) generator: Option<GeneratorName>,
    /// Strategy for advancing the window, and its number: reset_and_roll or rolling, `clean` (leading frames
    /// of the window that are always clean, 0 without); causal, `history_noise` (noise on the previous frames
    /// in steps of 1000, 0 without); non_causal, `forecasts` (in the window, 1 without). Like
    /// rolling,clean=2 [default: reset_and_roll]
    #[arg(long, value_name = "STRATEGY[,KEY=N]")]
    strategy: Option<StrategyArg>,
    /// Frames in the window, L; the first L - 1 frames are ground-truth images [default: the window the
    /// network was trained with; 4 for a process]
    #[arg(long, value_name = "L")]
    window: Option<usize>,
    /// Inference steps, T; with rolling strategies a multiple of L - C, where C are the clean frames of
    /// --strategy [default: L - C]
    #[arg(long, value_name = "T")]
    infer_steps: Option<usize>,
    /// Scale of classifier-free guidance; 1 disables it, other values evaluate the network twice [default: 1]
    #[arg(long, value_name = "S", value_parser = scale, allow_negative_numbers = true)]
    guidance: Option<f32>,
    /// Conditions dropped in the second evaluation of the guidance: layout, text and action, or also color
    /// and depth [default: layout]
    #[arg(long, value_parser = names::<GuidedConditions>())]
    guide: Option<GuidedConditions>,
    /// Drop these conditions in all frames, for networks that were trained without them
    #[arg(long, value_name = "CONDITION,..", value_delimiter = ',', value_parser = names::<ConditionKind>())]
    without: Vec<ConditionKind>,
    /// Seed of the noise [default: 0]
    #[arg(long, value_name = "SEED")]
    noise_seed: Option<u64>,
    /// With process:.., the kind of its predictions [default: the recipe's, else flow_match]
    #[arg(long, value_parser = names::<SamplerOptions>())]
    sampler: Option<SamplerOptions>,
    /// With process:.., images:.. and fill, the recipe of the conditions as JSON, in which missing fields
    /// have their defaults; or pas-nuscenes, pas-nuplan, pas-image-nuscenes or pas-image-nuplan, for a
    /// network of the paper with the defaults of its window, steps, sampler and guidance [default for fill:
    /// as for the shipped network; for images: maps of 256x448]
    #[arg(long, value_name = "RECIPE")]
    recipe: Option<PathBuf>,
    /// Captions, in place of the prompt of --annotations, by name of a recording or image token:
    /// {"scene-0061": "Parked truck, turn left"}, or per camera and time as OpenDWM's. A frame without one
    /// has the previous frame's
    #[arg(long, value_name = "F.json")]
    captions: Option<PathBuf>,
    /// With process:.. and images:.., time-out for each of its answers, seconds [default: 60]
    #[arg(long, value_name = "S", value_parser = timeout_s)]
    generator_timeout: Option<f64>,
}

impl GeneratorArgs {
    /// Returns the name of the network.
    pub(crate) fn name(&self) -> Option<String> {
        self.generator.as_ref().map(ToString::to_string)
    }

    /// Returns the options as arguments of a command line.
    pub(crate) fn arguments(&self) -> Vec<String> {
        let path = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
        let without: Vec<&str> = self.without.iter().map(|kind| kind.name()).collect();
        let options = [
            ("generator", self.name()),
            ("strategy", self.strategy.map(|strategy| strategy.to_string())),
            ("window", self.window.map(|frames| frames.to_string())),
            ("infer-steps", self.infer_steps.map(|steps| steps.to_string())),
            ("guidance", self.guidance.map(|scale| scale.to_string())),
            ("guide", self.guide.map(|guide| guide.name().to_owned())),
            ("without", (!without.is_empty()).then(|| without.join(","))),
            ("noise-seed", self.noise_seed.map(|seed| seed.to_string())),
            ("sampler", self.sampler.map(|sampler| sampler.name().to_owned())),
            ("recipe", path(&self.recipe)),
            ("captions", path(&self.captions)),
            ("generator-timeout", self.generator_timeout.map(|seconds| seconds.to_string())),
        ];
        let given = options.into_iter().filter_map(|(name, value)| Some([format!("--{name}"), value?]));
        given.flatten().collect()
    }

    /// Returns whether images are generated.
    pub(crate) fn generates(&self) -> bool {
        self.generator.is_some()
    }

    /// Rejects options that have no effect.
    pub(crate) fn check(&self) -> Result<(), WrongUsage> {
        let (process, fill) = match &self.generator {
            Some(GeneratorName::Network(NetworkName::Process(_))) => (true, false),
            Some(GeneratorName::Network(NetworkName::Fill)) => (false, true),
            _ => (false, false),
        };
        let images = matches!(self.generator, Some(GeneratorName::Images(_)));
        let preset = self.preset().map(|preset| preset.guidance);
        let guided = self.guidance.or(preset).is_some_and(|scale| scale != 1.0);
        let any = "--generator";
        let network = "--generator network, fill or process:..";
        let options = [
            ("--strategy", self.strategy.is_some(), !images, network),
            ("--window", self.window.is_some(), !images, network),
            ("--infer-steps", self.infer_steps.is_some(), !images, network),
            ("--guidance", self.guidance.is_some(), !images, network),
            ("--without", !self.without.is_empty(), !images, network),
            ("--noise-seed", self.noise_seed.is_some(), true, any),
            ("--captions", self.captions.is_some(), true, any),
            ("--guide", self.guide.is_some(), guided, "--guidance other than 1"),
            ("--sampler", self.sampler.is_some(), process, "--generator process:.."),
            (
                "--recipe",
                self.recipe.is_some(),
                process || images || fill,
                "--generator process:.., images:.. or fill",
            ),
            (
                "--generator-timeout",
                self.generator_timeout.is_some(),
                process || images,
                "--generator process:.. or images:..",
            ),
        ];
        let given = options.into_iter().filter(|(_, is_given, ..)| *is_given);
        let unused = given.into_iter().find(|(_, _, does, _)| self.generator.is_none() || !does);
        let Some((option, _, _, needs)) = unused else { return Ok(()) };
        let Some(generator) = &self.generator else {
            return Err(WrongUsage(format!("expected {any} with {option}, found none")));
        };
        let found = if needs.starts_with(any) { generator.to_string() } else { "none".to_owned() };
        Err(WrongUsage(format!("expected {needs} with {option}, found {found}")))
    }

    /// Returns the number of frames in the window of images of another program.
    pub(crate) fn images_window(&self) -> Result<usize, WrongUsage> {
        let window = self.window.unwrap_or(DEFAULT_WINDOW);
        if window == 0 {
            return Err(WrongUsage("expected --window of 1 or more, found 0".to_owned()));
        }
        Ok(window)
    }

    /// Opens or starts the generator for a log, `fps` frames per second; `None` without `--generator`.
    pub(crate) fn open(&self, log: &Log, fps: f64) -> anyhow::Result<Option<OpenedGenerator>> {
        let Some(name) = &self.generator else { return Ok(None) };
        let rig = DenoiserRig::of(log.recording(), fps);
        let opened = self.settings()?.open_generator(name, rig, log.name(), log.map().is_some());
        opened.map(Some).map_err(|error| match error.is_usage() {
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

    /// Returns the files that are read: weights, captions and recipe.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        let weights = match &self.generator {
            Some(GeneratorName::Network(NetworkName::Network(weights))) => weights.as_deref(),
            _ => None,
        };
        let recipe = self.recipe.as_deref().filter(|_| self.preset().is_none());
        weights.into_iter().chain(self.captions.as_deref()).chain(recipe)
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
            (Some(preset), _) => Some(preset.recipe.clone()),
            (None, Some(path)) => Some(Recipe::read(path)?),
            (None, None) => None,
        };
        let dropped = self.guide.unwrap_or_default().into();
        let StrategyArg { strategy, clean } = self.strategy.unwrap_or_default();
        Ok(GeneratorSettings {
            window: self.window.or(preset.as_ref().map(|preset| preset.window)),
            steps: self.infer_steps.or(preset.as_ref().map(|preset| preset.steps)),
            clean,
            strategy,
            sampler: self.sampler.or(preset.as_ref().map(|preset| preset.sampler)).unwrap_or_default(),
            guidance: Guidance { scale: self.guidance.unwrap_or(default_guidance), dropped },
            without: self.without.iter().copied().collect(),
            noise_seed: self.noise_seed.unwrap_or(defaults.noise_seed),
            recipe,
            timeout_s: self.generator_timeout.unwrap_or(defaults.timeout_s),
        })
    }
}

/// A strategy with its number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct StrategyArg {
    strategy: Strategy,
    /// Leading frames of the window that are always clean, C.
    clean: usize,
}

impl fmt::Display for StrategyArg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.strategy.name())?;
        match (self.strategy, self.clean) {
            (Strategy::ResetAndRoll | Strategy::Rolling, 0) => Ok(()),
            (Strategy::ResetAndRoll | Strategy::Rolling, clean) => write!(f, ",clean={clean}"),
            (Strategy::Causal { history_noise }, _) => write!(f, ",history_noise={history_noise}"),
            (Strategy::NonCausal { forecasts }, _) => write!(f, ",forecasts={forecasts}"),
        }
    }
}

impl FromStr for StrategyArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, option) = text.split_once(',').map_or((text, None), |(name, option)| (name, Some(option)));
        let strategy: Strategy = name.parse().map_err(|error: UnknownName| error.to_string())?;
        let Some(option) = option else { return Ok(Self { strategy, clean: 0 }) };
        let key = match strategy {
            Strategy::ResetAndRoll | Strategy::Rolling => "clean",
            Strategy::Causal { .. } => "history_noise",
            Strategy::NonCausal { .. } => "forecasts",
        };
        let value = option.split_once('=').filter(|(found, _)| *found == key);
        let number = value.and_then(|(_, number)| number.parse().ok());
        let number = number.ok_or_else(|| format!("expected {key}=N with {name}, found {option:?}"))?;
        Ok(match strategy {
            Strategy::Causal { .. } => {
                Self { strategy: Strategy::Causal { history_noise: number }, clean: 0 }
            }
            Strategy::NonCausal { .. } => {
                Self { strategy: Strategy::NonCausal { forecasts: number }, clean: 0 }
            }
            strategy => Self { strategy, clean: number },
        })
    }
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
    fn strategies_have_a_number_of_their_own() {
        let parse = |text: &str| text.parse::<StrategyArg>();
        for strategy in Strategy::ALL {
            assert_eq!(parse(strategy.name()), Ok(StrategyArg { strategy, clean: 0 }));
        }
        let clean = StrategyArg { strategy: Strategy::Rolling, clean: 2 };
        assert_eq!(parse("rolling,clean=2"), Ok(clean));
        let causal = Strategy::Causal { history_noise: 50 };
        assert_eq!(parse("causal,history_noise=50"), Ok(StrategyArg { strategy: causal, clean: 0 }));
        let non_causal = Strategy::NonCausal { forecasts: 3 };
        assert_eq!(parse("non_causal,forecasts=3"), Ok(StrategyArg { strategy: non_causal, clean: 0 }));
        for text in ["rolling,clean=2", "reset_and_roll", "causal,history_noise=50", "non_causal,forecasts=3"]
        {
            assert_eq!(parse(text).unwrap().to_string(), text);
        }
        for (text, expected) in [
            ("causal,clean=1", "history_noise=N with causal"),
            ("rolling,clean=-1", "clean=N with rolling"),
            ("reset", "reset_and_roll, rolling"),
        ] {
            assert!(parse(text).unwrap_err().contains(expected), "{text}");
        }
    }

    #[test]
    fn factors_and_time_outs_have_ranges() {
        assert_eq!((scale("1.5"), scale("0")), (Ok(1.5), Ok(0.0)));
        assert!(scale("-1").is_err() && scale("nan").is_err() && scale("101").is_err());
        assert_eq!(timeout_s("0.5"), Ok(0.5));
        assert!(timeout_s("0").is_err() && timeout_s("inf").is_err());
    }
}
