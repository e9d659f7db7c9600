use std::path::Path;

use candle_core::{Device, Tensor};

use super::codec::{latent_of_rows, rows_of_latent};
use super::{About, Inputs, Model, NetworkConfig, NetworkError, PatchCodec, Statistics, Taken, Weights};
use crate::generate::{Denoiser, DenoiserError, Frame, FrameConditions, Latent, LatentShape, Recipe};

/// The network, ready to be asked. It tells the velocity of flow matching.
#[derive(Clone)]
pub struct Network {
    config: NetworkConfig,
    statistics: Statistics,
    about: About,
    fingerprint: String,
    model: Model,
    /// Conditions of the last windows, the latest last, and what was made of them.
    remembered: Vec<(Vec<FrameConditions>, Taken)>,
}

/// Windows that are remembered: a roll asks several times for one, with guidance for two.
const REMEMBERED: usize = 2;

impl Network {
    /// With weights.
    ///
    /// # Errors
    /// Weights that do not go together.
    pub fn new(weights: Weights) -> Result<Self, NetworkError> {
        let fingerprint = weights.fingerprint()?;
        let Weights { config, statistics, about, parameters } = weights;
        let parameters = parameters.into_iter().map(|(name, tensor)| (name, tensor.detach())).collect();
        let model = Model::new(&config, &statistics, parameters)?;
        Ok(Self { config, statistics, about, fingerprint, model, remembered: Vec::new() })
    }

    /// With the weights of a file.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn open(path: &Path) -> Result<Self, NetworkError> {
        Self::new(Weights::open(path)?)
    }

    /// With the weights that come with the program.
    ///
    /// # Errors
    /// As [`Weights::shipped`].
    pub fn shipped() -> Result<Self, NetworkError> {
        Self::new(Weights::shipped()?)
    }

    /// With the weights of a file; else with those that come with the program.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn open_or_shipped(path: Option<&Path>) -> Result<Self, NetworkError> {
        path.map_or_else(Self::shipped, Self::open)
    }

    /// Its size and shape.
    pub fn config(&self) -> &NetworkConfig {
        &self.config
    }

    /// How its conditions are made.
    pub fn recipe(&self) -> &Recipe {
        &self.config.recipe
    }

    /// Where its weights come from.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// As [`Weights::fingerprint`].
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }

    /// The codec of its latents.
    ///
    /// # Errors
    /// None that a network can be made with.
    pub fn codec(&self) -> Result<PatchCodec, NetworkError> {
        PatchCodec::new(&self.config, &self.statistics)
    }

    /// Takes up the conditions of a window, or remembers it.
    fn take(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<Taken, NetworkError> {
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
