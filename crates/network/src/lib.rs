//! A small diffusion network on the CPU. `python -m pskel.train` trains it.
//!
//! # How it works
//! `inputs` turns [`FrameConditions`](pskel_generate::FrameConditions) into images of numbers, with the holes
//! of color and depth filled (`fill`). `model` encodes them once per frame, denoises the latents of a frame
//! window, and decodes a finished latent into images, seeing the conditions again. Latents are mean colors of
//! 16x16 pixels (`latents`), with mean 0 and variance 1 over the training images ([`Statistics`]). `kernels`
//! are its operations. `levels` defines the denoiser's input and output at a noise level: the filled color is
//! a first guess, and the denoiser predicts the remainder. [`Weights`] holds all of it in one file, and
//! [`Network`] is the [`Denoiser`](pskel_generate::Denoiser) and the [`Codec`](pskel_generate::Codec) that
//! run it. [`GeneratorSettings`] open a network by its name.

mod error;
mod fill;
mod generator;
mod inputs;
mod kernels;
mod latents;
mod levels;
mod model;
mod network;
mod opened;
#[cfg(test)]
mod parity;
mod statistics;
mod weights;

pub use error::NetworkError;
pub use fill::fill_holes;
pub use fill::filled::FilledColor;
pub use generator::{
    DEFAULT_WINDOW, GeneratorReport, GeneratorSettings, NetworkName, OpenNetworkError, OpenedNetwork,
};
pub use kernels::Attend;
pub use network::Network;
pub use opened::{GeneratorName, OpenedGenerator};
pub use statistics::Statistics;
pub use weights::config::NetworkConfig;
pub use weights::{Provenance, Weights};

pub(crate) use levels::Levels;
