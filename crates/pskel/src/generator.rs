//! Generator options of the command line: the network, its strategy, and the session created from both.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use point_skeleton::conditions::meta::PromptParts;
use point_skeleton::dataset::Log;
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use point_skeleton::geometry::ImageSize;
use point_skeleton::scene::{SceneClouds, SceneMap};
use pskel_generate::{
    AnyDenoiser, Codec, Conditioner, DroppedConditions, GenerateOptions, GroundTruthImages, Guidance,
    Prediction, ProcessDenoiser, Recipe, SamplerOptions, Session, SessionParts, Strategy,
};
use pskel_network::{Network, Provenance};
use pskel_sim::peer::{PeerAddress, PeerSpec};
use serde::Serialize;

use super::WrongUsage;
use super::numbers;

/// Options for generating images from conditions.
#[derive(Clone, Debug, Args)]
pub(super) struct GeneratorArgs {
    /// Strategy for advancing the window [default: reset_and_roll]
    #[arg(long, value_enum, value_name = "STRATEGY")]
    strategy: Option<StrategyName>,
    /// Frames in the window, L; the first L - 1 frames are ground-truth images [default: the window the network was
    /// trained with; 4 for a process]
    #[arg(long, value_name = "L")]
    window: Option<usize>,
    /// Inference steps, T; with rolling strategies a multiple of L - C [default: L - C]
    #[arg(long, value_name = "T")]
    infer_steps: Option<usize>,
    /// With rolling strategies: leading frames of the window that are always clean [default: 0]
    #[arg(long, value_name = "C")]
    clean: Option<usize>,
    /// With --strategy non_causal: forecasts in the window [default: 1]
    #[arg(long, value_name = "K")]
    ahead: Option<usize>,
    /// With --strategy causal: noise on the previous frames, in steps of 1000 [default: 0]
    #[arg(long, value_name = "N")]
    history_noise: Option<usize>,
    /// Scale of classifier-free guidance; 1 disables it, other values evaluate the network twice [default: 1]
    #[arg(long, value_name = "S", value_parser = numbers::scale, allow_negative_numbers = true)]
    guidance: Option<f32>,
    /// Conditions dropped in the second evaluation of the guidance: layout, text and action, or also color and depth
    /// [default: layout]
    #[arg(long, value_enum)]
    guide: Option<Guide>,
    /// Seed of the noise [default: 0]
    #[arg(long, value_name = "SEED")]
    noise_seed: Option<u64>,
    /// With process:.., the kind of its predictions [default: flow_match]
    #[arg(long, value_enum)]
    sampler: Option<SamplerName>,
    /// With process:.., the recipe of its conditions, as JSON; missing fields are as in the built-in network
    #[arg(long, value_name = "F.json")]
    recipe: Option<PathBuf>,
    /// With process:.., time-out for each of its answers, seconds [default: 60]
    #[arg(long, value_name = "S", value_parser = numbers::timeout_s)]
    generator_timeout: Option<f64>,
}

/// Network selected on the command line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "String")]
pub(super) enum NetworkName {
    /// Built-in network, with the weights of a file or those shipped with the program.
    Network(Option<PathBuf>),
    /// Network in another process.
    Process(PeerAddress),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum StrategyName {
    /// Rolls on to the forecasts, then discards all frames influenced by them.
    ResetAndRoll,
    /// One roll per step; frames retain the influence of old forecasts.
    Rolling,
    /// Clean previous frames, no forecasts.
    Causal,
    /// Clean previous frames, and --ahead forecasts.
    NonCausal,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Guide {
    /// Drops layout, text and action.
    Layout,
    /// Drops all conditions.
    All,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum SamplerName {
    /// Velocities of flow matching, shift 3.
    FlowMatch,
    /// Noise, with DDIM.
    DdimEpsilon,
    /// Clean frames, with DDIM.
    DdimSample,
    /// Velocities, with DDIM.
    DdimVelocity,
}

/// Opened network with its options.
pub(super) struct OpenedNetwork {
    denoiser: AnyDenoiser,
    codec: Box<dyn Codec>,
    recipe: Recipe,
    size: ImageSize,
    options: GenerateOptions,
    seed: u64,
    about: Option<Provenance>,
    fingerprint: Option<String>,
    name: NetworkName,
}

/// Generator settings in `rollout.json` and `index.json`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct GeneratorReport {
    network: NetworkName,
    /// Provenance of the weights.
    weights: Option<Provenance>,
    fingerprint: Option<String>,
    /// Size of the images.
    size: ImageSize,
    recipe: Recipe,
    #[serde(flatten)]
    options: GenerateOptions,
    noise_seed: u64,
}

/// Scene whose images are generated.
pub(super) struct GenerationScene<'a> {
    pub(super) log: &'a Log,
    pub(super) map: Option<Arc<SceneMap>>,
    pub(super) stage: &'a SceneClouds<'a>,
    pub(super) prompt: &'a PromptParts,
    pub(super) truth: GroundTruthImages<'a>,
    pub(super) ego_follows_log: bool,
    pub(super) actors_follow_log: bool,
}

/// Default window of a network process, frames.
const WINDOW: usize = 4;
/// Default time-out of a network process, seconds.
const TIMEOUT_S: f64 = 60.0;
/// Shift of flow matching. Source: the scheduler of Stable Diffusion 3.5.
const SHIFT: f64 = 3.0;

impl GeneratorArgs {
    /// Rejects options that have no effect.
    pub(super) fn check(&self, name: Option<&NetworkName>) -> Result<(), WrongUsage> {
        let Self { strategy, clean, guidance, .. } = self;
        let strategy = strategy.unwrap_or(StrategyName::ResetAndRoll);
        let rolls = matches!(strategy, StrategyName::ResetAndRoll | StrategyName::Rolling);
        let is_process = matches!(name, Some(NetworkName::Process(_)));
        let guided = guidance.is_some_and(|scale| scale != 1.0);
        let network = "--generator";
        let process = "--generator process:..";
        let options = [
            ("--strategy", self.strategy.is_some(), true, network),
            ("--window", self.window.is_some(), true, network),
            ("--infer-steps", self.infer_steps.is_some(), true, network),
            ("--guidance", guidance.is_some(), true, network),
            ("--noise-seed", self.noise_seed.is_some(), true, network),
            ("--clean", clean.is_some(), rolls, "--strategy reset_and_roll or rolling"),
            ("--ahead", self.ahead.is_some(), strategy == StrategyName::NonCausal, "--strategy non_causal"),
            (
                "--history-noise",
                self.history_noise.is_some(),
                strategy == StrategyName::Causal,
                "--strategy causal",
            ),
            ("--guide", self.guide.is_some(), guided, "--guidance other than 1"),
            ("--sampler", self.sampler.is_some(), is_process, process),
            ("--recipe", self.recipe.is_some(), is_process, process),
            ("--generator-timeout", self.generator_timeout.is_some(), is_process, process),
        ];
        let given = options.into_iter().filter(|(_, is_given, ..)| *is_given);
        let unused = given.into_iter().find(|(_, _, does, _)| name.is_none() || !does);
        let Some((option, _, _, needs)) = unused else { return Ok(()) };
        let needs = if name.is_none() { network } else { needs };
        Err(WrongUsage(format!("expected {needs} with {option}, found none")))
    }

    /// Opens or starts the network; `cameras` is the number of cameras of the log.
    pub(super) fn open(&self, name: &NetworkName, cameras: usize) -> anyhow::Result<OpenedNetwork> {
        match name {
            NetworkName::Network(path) => self.network(path.as_deref(), cameras),
            NetworkName::Process(address) => self.process(address, cameras),
        }
    }

    fn network(&self, path: Option<&Path>, cameras: usize) -> anyhow::Result<OpenedNetwork> {
        let network = Network::open_or_shipped(path)?;
        let config = network.config();
        let (trained, recipe) = (config.frames, config.recipe.clone());
        let options = self.options(self.window.unwrap_or(trained))?;
        if options.window > trained {
            let message = format!(
                "expected --window of at most {trained} with these weights, found {}",
                options.window
            );
            return Err(WrongUsage(message).into());
        }
        if config.cameras != cameras {
            let found = format!("weights for {}", config.cameras);
            let path = path.unwrap_or(Path::new("--generator network"));
            return Err(FileError::content(format!("weights for {cameras} cameras"), found, path).into());
        }
        Ok(OpenedNetwork {
            codec: Box::new(network.codec()?),
            size: recipe.size,
            about: Some(network.about().clone()),
            fingerprint: Some(network.fingerprint().to_owned()),
            denoiser: Box::new(network),
            recipe,
            options,
            seed: self.noise_seed.unwrap_or(0),
            name: NetworkName::Network(path.map(Path::to_owned)),
        })
    }

    fn process(&self, address: &PeerAddress, cameras: usize) -> anyhow::Result<OpenedNetwork> {
        let options = self.options(self.window.unwrap_or(WINDOW))?;
        let recipe = self.recipe.as_deref().map_or(Ok(Recipe::default()), read_recipe)?;
        let spec =
            PeerSpec { address: address.clone(), timeout_s: self.generator_timeout.unwrap_or(TIMEOUT_S) };
        let denoiser = ProcessDenoiser::start(&spec, &options, cameras, recipe.size)?;
        let (codec, size) = denoiser.codec()?;
        Ok(OpenedNetwork {
            codec,
            size,
            about: None,
            fingerprint: None,
            denoiser: Box::new(denoiser),
            recipe,
            options,
            seed: self.noise_seed.unwrap_or(0),
            name: NetworkName::Process(address.clone()),
        })
    }

    fn options(&self, window: usize) -> Result<GenerateOptions, WrongUsage> {
        let dropped = match self.guide {
            None | Some(Guide::Layout) => DroppedConditions::GUIDED,
            Some(Guide::All) => DroppedConditions::ALL,
        };
        let clean = self.clean.unwrap_or(0);
        let ddim = |prediction| SamplerOptions::Ddim { prediction };
        let options = GenerateOptions {
            window,
            steps: self.infer_steps.unwrap_or(window.saturating_sub(clean)),
            clean,
            strategy: match self.strategy.unwrap_or(StrategyName::ResetAndRoll) {
                StrategyName::ResetAndRoll => Strategy::ResetAndRoll,
                StrategyName::Rolling => Strategy::Rolling,
                StrategyName::Causal => Strategy::Causal { history_noise: self.history_noise.unwrap_or(0) },
                StrategyName::NonCausal => Strategy::NonCausal { forecasts: self.ahead.unwrap_or(1) },
            },
            sampler: match self.sampler.unwrap_or(SamplerName::FlowMatch) {
                SamplerName::FlowMatch => SamplerOptions::FlowMatch { shift: SHIFT },
                SamplerName::DdimEpsilon => ddim(Prediction::Epsilon),
                SamplerName::DdimSample => ddim(Prediction::Sample),
                SamplerName::DdimVelocity => ddim(Prediction::Velocity),
            },
            guidance: Guidance { scale: self.guidance.unwrap_or(1.0), dropped },
        };
        options.check().map_err(|error| WrongUsage(error.to_string()))?;
        Ok(options)
    }
}

impl GeneratorReport {
    /// Formats a summary for the HTML page.
    pub(super) fn fact(&self) -> String {
        let GenerateOptions { window, steps, strategy, .. } = self.options;
        format!("images of {} by {} ({}, L {window}, T {steps})", self.size, self.network, strategy.name())
    }
}

impl OpenedNetwork {
    /// Returns the number of frames in the window.
    pub(super) fn window(&self) -> usize {
        self.options.window
    }

    pub(super) fn report(&self) -> GeneratorReport {
        GeneratorReport {
            network: self.name.clone(),
            weights: self.about.clone(),
            fingerprint: self.fingerprint.clone(),
            size: self.size,
            recipe: self.recipe.clone(),
            options: self.options,
            noise_seed: self.seed,
        }
    }

    /// Creates the session of a simulation.
    pub(super) fn session<'a>(self, subject: &GenerationScene<'a>) -> anyhow::Result<Session<'a>> {
        let GenerationScene { log, map, stage, prompt, truth, ego_follows_log, actors_follow_log } = subject;
        let prompt = prompt.prompt().unwrap_or_default();
        let conditioner = Conditioner::new(log, map.clone(), stage, &self.recipe, &prompt);
        let parts = SessionParts {
            conditioner,
            truth: *truth,
            ego_follows_log: *ego_follows_log,
            actors_follow_log: *actors_follow_log,
            codec: self.codec,
            size: self.size,
            options: self.options,
            seed: self.seed,
        };
        Ok(Session::new(parts, self.denoiser)?)
    }
}

impl FromStr for NetworkName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "network" => Ok(Self::Network(None)),
            Some(("network", path)) if !path.is_empty() => Ok(Self::Network(Some(path.into()))),
            Some(("process", address)) => address
                .parse()
                .map(Self::Process)
                .map_err(|error: pskel_sim::peer::PeerError| error.to_string()),
            _ => Err("expected network, network:FILE, process:COMMAND, process:unix:PATH or \
                      process:tcp:HOST:PORT"
                .to_owned()),
        }
    }
}

impl From<NetworkName> for String {
    fn from(name: NetworkName) -> Self {
        name.to_string()
    }
}

impl fmt::Display for NetworkName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Network(None) => f.write_str("network"),
            Self::Network(Some(path)) => write!(f, "network:{}", path.display()),
            Self::Process(address) => write!(f, "process:{address}"),
        }
    }
}

fn read_recipe(path: &Path) -> Result<Recipe, FileError> {
    let text = read_table(path)?;
    let recipe: Recipe = serde_json::from_slice(&text)
        .map_err(|error| FileError::content("a recipe of conditions", error.to_string(), path))?;
    recipe.check().map_err(|error| FileError::content(error.expected, error.found, path))?;
    Ok(recipe)
}
