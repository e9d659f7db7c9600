//! A small diffusion network on the CPU, and its training.
//!
//! # How it works
//! `inputs` turns [`FrameConditions`](pskel_generate::FrameConditions) into images of numbers, with the holes
//! of color and depth filled (`fill`). `model` encodes them once per frame, denoises the latents of a frame
//! window, and decodes a finished latent into images, seeing the conditions again. Latents are mean colors
//! of 4x4 pixels (`latents`), with mean 0 and variance 1 over the training images ([`Statistics`]). `kernels`
//! and `ops` implement operations that the tensor library lacks or runs too slowly. `levels` defines the
//! denoiser's input and output at a noise level: the filled color is a first guess, and the denoiser predicts
//! the remainder. [`Weights`] holds all of it in one file, and [`Network`] is the
//! [`Denoiser`](pskel_generate::Denoiser) and the [`Codec`](pskel_generate::Codec) that run it.
//! [`GeneratorSettings`] open a network by its name.

mod denoiser;
mod error;
mod fill;
mod generator;
mod inputs;
mod kernels;
mod latents;
mod levels;
mod model;
mod ops;
mod statistics;
mod threads;
pub mod train;
mod weights;

pub use denoiser::Network;
pub use error::NetworkError;
pub use fill::fill_holes;
pub use fill::filled::FilledColor;
pub use generator::{
    GenerationScene, GeneratorReport, GeneratorSettings, NetworkName, OpenNetworkError, OpenedNetwork,
};
pub use kernels::Attend;
pub use statistics::Statistics;
pub use weights::config::NetworkConfig;
pub use weights::{Provenance, Weights};

pub(crate) use inputs::Inputs;
pub(crate) use latents::latent_rows;
pub(crate) use levels::Levels;
pub(crate) use model::{EncodedConditions, Model, WindowConditions};
pub(crate) use weights::parameters::{fresh, shapes};
pub(crate) use weights::{find, in_file, read, read_whole, serialized};
