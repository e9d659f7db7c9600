use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use point_skeleton::geometry::ImageSize;
use point_skeleton::memory::{MemoryError, Need, reserve};
use pskel_generate::{
    AnyDenoiser, Codec, Conditioner, DenoiserError, DenoiserRig, DroppedConditions, GenerateError,
    GenerateOptions, GenerationScene, Guidance, ImageProcessError, ProcessDenoiser, Recipe, SamplerOptions,
    Session, SessionError, SessionParts, Strategy,
};
use pskel_sim::peer::{PeerAddress, PeerError, PeerSpec};
use serde::Serialize;

use super::inputs::PLANES;
use super::{FilledColor, Network, NetworkConfig, NetworkError, Provenance, Weights};

/// Memory of weights and of the kernels' buffers, whatever the size of the images.
const NETWORK_BYTES: u64 = 64 << 20;

/// Bytes per pixel of all maps: color, depth bin, boxes, HD map.
const MAP_BYTES: usize = 3 + 2 + 3 + 3;

/// Default window of `fill` and of a network process, frames.
pub const DEFAULT_WINDOW: usize = 4;

/// Name of a network: `network`, `network:FILE`, `fill`, or `process:` with a command or an address.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "String")]
pub enum NetworkName {
    /// Network of this crate, with the weights of a file or the shipped ones.
    Network(Option<PathBuf>),
    /// No network: color maps with their holes filled.
    Fill,
    /// Network in another process.
    Process(PeerAddress),
}

/// Options of a generator whose defaults depend on its network.
#[derive(Clone, Debug)]
pub struct GeneratorSettings {
    /// Frames in the window, L; `None` for the window the network was trained with, or 4 for a process.
    pub window: Option<usize>,
    /// Inference steps, T; `None` for one per frame that is not clean.
    pub steps: Option<usize>,
    /// Leading frames of the window that are always clean, C.
    pub clean: usize,
    /// Strategy that moves the window.
    pub strategy: Strategy,
    /// Noise schedule and denoising update.
    pub sampler: SamplerOptions,
    /// Classifier-free guidance.
    pub guidance: Guidance,
    /// Conditions that the network does not get.
    pub without: DroppedConditions,
    /// Seed of the noise.
    pub noise_seed: u64,
    /// Conditions of a network process and of `fill`; other networks have their own. `None` for the default
    /// recipe: of processes, or with `fill` of the shipped network.
    pub recipe: Option<Recipe>,
    /// Time-out for each answer of a network process, seconds.
    pub timeout_s: f64,
}

impl Default for GeneratorSettings {
    fn default() -> Self {
        Self {
            window: None,
            steps: None,
            clean: 0,
            strategy: Strategy::ResetAndRoll,
            sampler: SamplerOptions::default(),
            guidance: Guidance::default(),
            without: DroppedConditions::default(),
            noise_seed: 0,
            recipe: None,
            timeout_s: 60.0,
        }
    }
}

/// A network that is ready to generate.
pub struct OpenedNetwork {
    denoiser: AnyDenoiser,
    codec: Box<dyn Codec + Send>,
    recipe: Recipe,
    size: ImageSize,
    options: GenerateOptions,
    without: DroppedConditions,
    seed: u64,
    about: Option<Provenance>,
    fingerprint: Option<String>,
    name: NetworkName,
    /// Values of the network's activations per pixel of the conditions.
    activations: usize,
}

/// Network and options of a rollout's generator.
#[derive(Clone, Debug, Serialize)]
pub struct GeneratorReport {
    network: NetworkName,
    /// Provenance of the weights.
    weights: Option<Provenance>,
    fingerprint: Option<String>,
    /// Size of the images.
    size: ImageSize,
    recipe: Recipe,
    #[serde(flatten)]
    options: GenerateOptions,
    #[serde(skip_serializing_if = "is_default")]
    without: DroppedConditions,
    noise_seed: u64,
}

/// Error of opening a network.
#[derive(Debug, thiserror::Error)]
pub enum OpenNetworkError {
    /// The options are inconsistent.
    #[error(transparent)]
    Options(#[from] GenerateError),
    /// The window is larger than the one the network was trained with.
    #[error("expected a window of at most {trained} with these weights, found {found}")]
    Window {
        /// Window of the training, frames.
        trained: usize,
        /// Given window, frames.
        found: usize,
    },
    /// More memory is needed than available.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The weights cannot be read.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The process does not answer, or its answer is invalid.
    #[error(transparent)]
    Process(#[from] DenoiserError),
    /// The same of a process that makes whole images.
    #[error(transparent)]
    Images(#[from] ImageProcessError),
}

impl OpenNetworkError {
    /// Returns whether the options are invalid, as opposed to the weights or the process.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Options(_) | Self::Window { .. })
    }
}

impl GeneratorSettings {
    /// Opens the weights or starts the process, for the cameras of a log.
    ///
    /// # Errors
    /// Fails if the options are inconsistent, if the weights are damaged, if there are more than 8 cameras,
    /// or if the process does not answer.
    pub fn open(&self, name: &NetworkName, rig: &DenoiserRig) -> Result<OpenedNetwork, OpenNetworkError> {
        let cameras = rig.cameras.len();
        let opened = match name {
            NetworkName::Network(path) => self.open_weights(path.as_deref(), cameras),
            NetworkName::Fill => self.fill(cameras),
            NetworkName::Process(address) => self.start(address, rig),
        }?;
        opened.check_memory(cameras)?;
        Ok(opened)
    }

    fn open_weights(&self, path: Option<&Path>, cameras: usize) -> Result<OpenedNetwork, OpenNetworkError> {
        let network = Network::open_or_shipped(path, cameras)?;
        let config = network.config();
        let (trained, recipe, activations) = (config.frames, config.recipe.clone(), activations(config));
        let options = self.options(trained)?;
        if options.window > trained {
            return Err(OpenNetworkError::Window { trained, found: options.window });
        }
        Ok(OpenedNetwork {
            codec: Box::new(network.clone()),
            size: recipe.size,
            about: Some(network.about().clone()),
            fingerprint: Some(network.fingerprint().to_owned()),
            denoiser: Box::new(network),
            recipe,
            options,
            without: self.without,
            seed: self.noise_seed,
            name: NetworkName::Network(path.map(Path::to_owned)),
            activations,
        })
    }

    fn fill(&self, cameras: usize) -> Result<OpenedNetwork, OpenNetworkError> {
        let options = self.options(DEFAULT_WINDOW)?;
        let recipe = self.recipe.clone().map_or_else(Weights::shipped_recipe, Ok)?;
        let filled = FilledColor::new(&recipe, cameras);
        Ok(OpenedNetwork {
            codec: Box::new(filled.clone()),
            size: recipe.size,
            about: None,
            fingerprint: None,
            denoiser: Box::new(filled),
            recipe,
            options,
            without: self.without,
            seed: self.noise_seed,
            name: NetworkName::Fill,
            activations: 0,
        })
    }

    fn start(&self, address: &PeerAddress, rig: &DenoiserRig) -> Result<OpenedNetwork, OpenNetworkError> {
        let (options, recipe) = (self.options(DEFAULT_WINDOW)?, self.recipe.clone().unwrap_or_default());
        let spec = PeerSpec { address: address.clone(), timeout_s: self.timeout_s };
        let denoiser = ProcessDenoiser::start(&spec, &options, rig, recipe.size)?;
        let (codec, size) = denoiser.codec()?;
        Ok(OpenedNetwork {
            codec,
            size,
            about: None,
            fingerprint: None,
            denoiser: Box::new(denoiser),
            recipe,
            options,
            without: self.without,
            seed: self.noise_seed,
            name: NetworkName::Process(address.clone()),
            activations: 0,
        })
    }

    /// Returns the options for a network whose default window is `window`.
    fn options(&self, window: usize) -> Result<GenerateOptions, GenerateError> {
        let window = self.window.unwrap_or(window);
        let options = GenerateOptions {
            window,
            steps: self.steps.unwrap_or(window.saturating_sub(self.clean)),
            clean: self.clean,
            strategy: self.strategy,
            sampler: self.sampler,
            guidance: self.guidance,
        };
        options.check()?;
        Ok(options)
    }
}

impl OpenedNetwork {
    /// Returns the number of frames in the window.
    pub fn window(&self) -> usize {
        self.options.window
    }

    /// Returns how many of the next planning steps it takes as forecasts, at most.
    pub fn forecasts(&self) -> usize {
        self.options.forecasts()
    }

    /// Returns the size of the images.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Returns network and options.
    pub fn report(&self) -> GeneratorReport {
        GeneratorReport {
            network: self.name.clone(),
            weights: self.about.clone(),
            fingerprint: self.fingerprint.clone(),
            size: self.size,
            recipe: self.recipe.clone(),
            options: self.options,
            without: self.without,
            noise_seed: self.seed,
        }
    }

    /// Checks that the conditions, latents and images of a window fit into the memory that is available.
    fn check_memory(&self, cameras: usize) -> Result<(), MemoryError> {
        let Self { recipe, size, options, activations, denoiser, name, .. } = self;
        let pixels = |size: ImageSize| (cameras * size.pixels()) as u64;
        // Maps of the window as bytes and bins; a process is sent all frames of the window as numbers.
        let tensors =
            if matches!(name, NetworkName::Process(_)) { 4 * (POINT_CHANNELS + LAYOUT_CHANNELS) } else { 0 };
        let maps = options.window * (MAP_BYTES + tensors) + 4 * activations;
        // Latents, their noise, and both predictions of guidance.
        let latents = 4 * 4 * (options.window * denoiser.shape().len()) as u64;
        // Generated and ground-truth images.
        let images = 2 * 3 * pixels(*size);
        let bytes = NETWORK_BYTES + maps as u64 * pixels(recipe.size) + latents + images;
        let what =
            || format!("a window of {} frames of {cameras} views of {} pixels", options.window, recipe.size);
        let advice = "a recipe of smaller images or a smaller --window needs less";
        reserve(bytes, || Need { what: what(), bytes, advice }).map(drop)
    }

    /// Creates the session of a rollout.
    ///
    /// # Errors
    /// Fails if codec and network differ in latent shape.
    pub fn session<'a>(self, scene: &GenerationScene<'a>) -> Result<Session<'a>, SessionError> {
        let conditioner = Conditioner::new(&self.recipe, scene.has_map, &scene.prompt)
            .with_captions(scene.captions.clone())
            .without(self.without);
        let parts = SessionParts {
            conditioner,
            truth: scene.truth,
            ego_follows_log: scene.ego_follows_log,
            actors_follow_log: scene.actors_follow_log,
            codec: self.codec,
            size: self.size,
            options: self.options,
            seed: self.seed,
        };
        Session::new(parts, self.denoiser)
    }
}

/// Returns the number of values per pixel that a network holds while it decodes: its input, the features at
/// half the size twice, and a padded row of them.
fn activations(config: &NetworkConfig) -> usize {
    let [half, quarter, ..] = config.decoder;
    PLANES + (4 * half + 2 * quarter) / 4 + 3
}

/// Returns whether no conditions are dropped.
fn is_default(dropped: &DroppedConditions) -> bool {
    *dropped == DroppedConditions::default()
}

impl GeneratorReport {
    /// Formats a summary for the HTML page.
    pub fn fact(&self) -> String {
        let GenerateOptions { window, steps, strategy, .. } = self.options;
        format!("images of {} by {} ({}, L {window}, T {steps})", self.size, self.network, strategy.name())
    }
}

impl FromStr for NetworkName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "network" => Ok(Self::Network(None)),
            None if text == "fill" => Ok(Self::Fill),
            Some(("network", path)) if !path.is_empty() => Ok(Self::Network(Some(path.into()))),
            Some(("process", address)) => {
                address.parse().map(Self::Process).map_err(|error: PeerError| error.to_string())
            }
            _ => Err("expected network, network:FILE, fill, process:COMMAND, process:unix:PATH or \
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
            Self::Fill => f.write_str("fill"),
            Self::Network(Some(path)) => write!(f, "network:{}", path.display()),
            Self::Process(address) => write!(f, "process:{address}"),
        }
    }
}
