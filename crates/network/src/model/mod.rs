//! The network. An encoder turns the conditions of a frame, reduced to a quarter of the size, into features,
//! once per frame. The denoiser works on latents, the mean colors of 16x16 pixels, with attention within
//! images, across cameras and over time. The decoder turns a finished latent into images; it sees the
//! conditions again, at full size. Defined in PyTorch by `pskel.models.small.network`, with the same names.
//! Sources: Ronneberger et al., "U-Net", 2015; Peebles and Xie, "Scalable Diffusion Models with
//! Transformers", 2023; Chen et al., "Diffusion Forcing", 2024 (a noise level per frame); Shi et al.,
//! "Real-Time Single Image and Video Super-Resolution", 2016 (pixels as channels).

mod decoder;
mod denoiser;
mod encoded;
mod encoder;
mod images;
mod parameters;

use decoder::Decoder;
use denoiser::Denoiser;
pub(crate) use encoded::Encoded;
use encoder::Encoder;
pub(crate) use images::Images;
pub(crate) use parameters::Arrays;
use parameters::Module;
use pskel_generate::FrameConditions;

use super::inputs::{full_inputs, work_inputs};
use super::{Levels, NetworkConfig, Statistics};

/// The network with its weights.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    config: NetworkConfig,
    statistics: Statistics,
    encoder: Encoder,
    denoiser: Denoiser,
    decoder: Decoder,
}

impl Model {
    /// Reads a model from arrays; they have the names of the PyTorch modules.
    ///
    /// # Errors
    /// Fails if an array is missing or has another shape.
    pub(crate) fn read<A: Arrays>(
        config: &NetworkConfig,
        statistics: &Statistics,
        arrays: &mut A,
    ) -> Result<Self, A::Error> {
        Ok(Self {
            config: config.clone(),
            statistics: statistics.clone(),
            encoder: Encoder::read(config, Module::new(arrays, "encoder"))?,
            denoiser: Denoiser::read(config, Module::new(arrays, "denoiser"))?,
            decoder: Decoder::read(config, Module::new(arrays, "decoder"))?,
        })
    }

    /// Encodes the conditions of a frame that fits the network.
    pub(crate) fn encode(&self, frame: &FrameConditions) -> Encoded {
        let inputs = work_inputs(&self.config, frame);
        let Statistics { means, scales, .. } = &self.statistics;
        let guess = inputs.cells.iter().enumerate();
        let guess = guess.map(|(i, color)| (color - means[i % 3]) / scales[i % 3]).collect();
        Encoded {
            views: frame.views(),
            features: self.encoder.encode(&inputs.planes),
            guess,
            rays: self.denoiser.rays(&inputs.rays),
            ego: self.denoiser.ego(&inputs.ego),
        }
    }

    /// Returns the velocity of noisy latents of a window, `[L V h w, 3]`, with noise `sigmas [L]`.
    pub(crate) fn velocity(&self, noisy: &[f32], sigmas: &[f32], frames: &[&Encoded]) -> Vec<f32> {
        let levels = Levels { sigmas, priors: &self.statistics.priors };
        let guess: Vec<f32> = frames.iter().flat_map(|frame| &frame.guess).copied().collect();
        let answer = self.denoiser.answer(&self.config, &levels.shown(noisy, &guess), sigmas, frames);
        levels.velocity(noisy, &levels.clean(noisy, &guess, &answer))
    }

    /// Returns the images of a finished latent `[V h w, 3]`: colors from 0 to 1, slightly beyond at times,
    /// `[V H W]`.
    pub(crate) fn decode(&self, latent: &[f32], frame: &FrameConditions, encoded: &Encoded) -> Vec<[f32; 3]> {
        self.decoder.decode(&full_inputs(&self.config, frame), &encoded.features, latent)
    }
}
