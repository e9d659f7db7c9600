use std::path::Path;

use candle_core::{Device, Tensor};
use pskel_generate::{Denoiser, DenoiserError, Frame, FrameConditions, Latent, LatentShape, Recipe};

use super::codec::{latent_of_rows, rows_of_latent};
use super::{
    EmbeddedConditions, Inputs, Model, NetworkConfig, NetworkError, PatchCodec, Provenance, Statistics,
    Weights,
};

/// The network as a denoiser; it predicts the velocity of flow matching.
#[derive(Clone)]
pub struct Network {
    config: NetworkConfig,
    statistics: Statistics,
    about: Provenance,
    fingerprint: String,
    model: Model,
    /// Cache of the last windows' conditions, latest last, with their embeddings.
    remembered: Vec<(Vec<FrameConditions>, EmbeddedConditions)>,
}

/// Number of cached windows: a roll calls the network several times for one window, with guidance for two.
const REMEMBERED: usize = 2;

impl Network {
    /// Creates a network from weights.
    ///
    /// # Errors
    /// Returns an error if the weights are inconsistent.
    pub fn new(weights: Weights) -> Result<Self, NetworkError> {
        let fingerprint = weights.fingerprint()?;
        let Weights { config, statistics, about, parameters } = weights;
        let parameters = parameters.into_iter().map(|(name, tensor)| (name, tensor.detach())).collect();
        let model = Model::new(&config, &statistics, parameters)?;
        Ok(Self { config, statistics, about, fingerprint, model, remembered: Vec::new() })
    }

    /// Reads a network from a file of weights.
    ///
    /// # Errors
    /// Returns the errors of [`Weights::open`].
    pub fn open(path: &Path) -> Result<Self, NetworkError> {
        Self::new(Weights::open(path)?)
    }

    /// Creates the network that is included in the program.
    ///
    /// # Errors
    /// Returns the errors of [`Weights::shipped`].
    pub fn shipped() -> Result<Self, NetworkError> {
        Self::new(Weights::shipped()?)
    }

    /// Reads a network from a file of weights, or else creates the one that is included in the program.
    ///
    /// # Errors
    /// Returns the errors of [`Weights::open`].
    pub fn open_or_shipped(path: Option<&Path>) -> Result<Self, NetworkError> {
        path.map_or_else(Self::shipped, Self::open)
    }

    /// Dimensions of the network.
    pub fn config(&self) -> &NetworkConfig {
        &self.config
    }

    /// How its conditions are rendered.
    pub fn recipe(&self) -> &Recipe {
        &self.config.recipe
    }

    /// Provenance of its weights.
    pub fn about(&self) -> &Provenance {
        &self.about
    }

    /// Hash of its weights, see [`Weights::fingerprint`].
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }

    /// Returns the codec of its latents.
    ///
    /// # Errors
    /// Never fails: a network has a valid configuration and statistics.
    pub fn codec(&self) -> Result<PatchCodec, NetworkError> {
        PatchCodec::new(&self.config, &self.statistics)
    }

    /// Embeds the conditions of a window, or takes the embedding from the cache.
    fn take(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<EmbeddedConditions, NetworkError> {
        let is_same = |known: &[FrameConditions]| {
            known.len() == window.len()
                && known.iter().zip(window).all(|(known, frame)| known == frame.condition)
        };
        if let Some((_, taken)) = self.remembered.iter().rev().find(|(known, _)| is_same(known)) {
            return Ok(taken.clone());
        }
        let inputs = Inputs::new(&self.config, window.iter().map(|frame| frame.condition))?;
        let taken = self.model.take(&inputs, 1, window.len())?;
        if self.remembered.len() == REMEMBERED {
            self.remembered.remove(0);
        }
        let conditions = window.iter().map(|frame| frame.condition.clone()).collect();
        self.remembered.push((conditions, taken.clone()));
        Ok(taken)
    }

    fn check(&self, window: &[Frame<'_, FrameConditions>]) -> Result<(), NetworkError> {
        let (frames, shape) = (self.config.frames, self.config.shape());
        if !(1..=frames).contains(&window.len()) {
            return Err(NetworkError::input(
                format!("a window of 1 to {frames} frames"),
                window.len().to_string(),
            ));
        }
        for frame in window {
            if frame.latent.shape() != shape {
                return Err(NetworkError::input(
                    format!("latents of {shape}"),
                    frame.latent.shape().to_string(),
                ));
            }
            if !(0.0..=1.0).contains(&frame.level.sigma) {
                return Err(NetworkError::input("a share of noise of 0 to 1", frame.level.sigma.to_string()));
            }
        }
        Ok(())
    }
}

impl Denoiser for Network {
    type Condition = FrameConditions;

    fn shape(&self) -> LatentShape {
        self.config.shape()
    }

    fn predict(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<Latent>, DenoiserError> {
        self.check(window)?;
        let taken = self.take(window)?;
        let shape = self.config.shape();
        let sigmas: Vec<f32> = window.iter().map(|frame| frame.level.sigma).collect();
        let rows: Vec<f32> = window.iter().flat_map(|frame| rows_of_latent(frame.latent)).collect();
        let count = rows.len() / shape.channels;
        let velocity = || {
            let noisy = Tensor::from_vec(rows, (count, shape.channels), &Device::Cpu)?;
            self.model.velocity(&noisy, &sigmas, &taken)?.flatten_all()?.to_vec1::<f32>()
        };
        let velocity = velocity().map_err(NetworkError::from)?;
        Ok(velocity.chunks(shape.len()).map(|rows| latent_of_rows(shape, rows)).collect())
    }
}
