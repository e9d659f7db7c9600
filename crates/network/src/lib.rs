//! A small diffusion transformer on the CPU, and the linear codec of its latents.
//!
//! # How it works
//! [`PatchCodec`] encodes every patch of an image into a latent, whose channels have mean 0 and variance 1 over the
//! training images ([`Statistics`]). `inputs` turns [`FrameConditions`](pskel_generate::FrameConditions) into rows of
//! numbers, one per patch. `model` is the transformer over all patches of all cameras and frames of a window.
//! `kernels` and `ops` implement operations that the tensor library lacks or runs too slowly. `levels` defines the
//! network's input and output at a noise level: the conditions alone give a first guess, and the transformer
//! predicts the remainder. [`Weights`] holds all of it in one file, and [`Network`] is the
//! [`Denoiser`](pskel_generate::Denoiser) that runs it. [`GeneratorSettings`] open a network by its name.

mod codec;
mod config;
mod denoiser;
mod error;
mod generator;
mod inputs;
mod kernels;
mod levels;
mod model;
mod ops;
mod statistics;
pub mod train;
mod weights;

pub use codec::PatchCodec;
pub use config::NetworkConfig;
pub use denoiser::Network;
pub use error::NetworkError;
pub use generator::{
    GenerationScene, GeneratorReport, GeneratorSettings, NetworkName, OpenNetworkError, OpenedNetwork,
};
pub use kernels::Attend;
pub use model::FirstGuess;
pub use statistics::Statistics;
pub use weights::{Provenance, Weights};

pub(crate) use inputs::Inputs;
pub(crate) use levels::Levels;
pub(crate) use model::EmbeddedConditions;
pub(crate) use model::{Model, fresh, shapes};
pub(crate) use weights::{find, in_file, read, read_whole, serialized};
