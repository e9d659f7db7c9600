//! A small diffusion transformer on the CPU, and the linear codec of its latents.
//!
//! # How it works
//! [`PatchCodec`] makes a latent of every patch of an image; its channels have mean 0 and variance 1 over the images that the
//! network was trained on ([`Statistics`]). `inputs` makes rows of numbers of [`FrameConditions`](super::FrameConditions), a
//! row per patch. `model` is the transformer over all patches of all cameras and frames of a window; `kernels` and `ops` are
//! its parts that the tensor library has not, or not fast enough. `levels` says what it is asked and what its answer
//! means at a level of noise: the conditions alone give a first guess, the transformer what is missing to it.
//! [`Weights`] is all of it in one file, [`Network`] the [`Denoiser`](super::Denoiser) that runs it.

mod codec;
mod config;
mod denoiser;
mod error;
mod inputs;
mod kernels;
mod levels;
mod model;
mod ops;
mod weights;

pub use codec::{PatchCodec, Statistics};
pub use config::NetworkConfig;
pub use denoiser::Network;
pub use error::NetworkError;
pub use kernels::Attend;
pub use model::FirstGuess;
pub use weights::{About, Weights};

pub(super) use inputs::Inputs;
pub(super) use levels::Levels;
pub(super) use model::Taken;
pub(super) use model::{Model, fresh, shapes};
pub(super) use weights::{find, in_file, read, read_whole, serialized};
