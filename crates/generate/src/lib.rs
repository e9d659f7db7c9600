//! The generator: a denoising loop that turns the conditions of a simulation into camera images, frame by
//! frame.
//!
//! # How it works
//! A [`Generator`] holds a window of latents. At each simulation step it takes the committed conditions of
//! the step and forecasts of the next steps, calls its [`Denoiser`] according to its [`Strategy`], and
//! returns the finished latent of the step. A [`Codec`] decodes that latent into images. `schedule` and
//! `sampler` define the noise levels and the denoising update. `window` computes the position of every frame
//! of the window in its schedule, and `guidance` combines two predictions. Networks are exchangeable: the
//! crate `pskel-network` has a small transformer, which is trained on [`TrainingClip`]s, [`toy`] is a linear
//! network for tests, and [`ProcessDenoiser`] calls a network in another process.

pub mod toy;

mod cache;
mod condition;
mod conditioner;
mod dataset_copy;
mod denoiser;
mod denoiser_error;
mod drive;
mod drive_file;
mod error;
mod frame_conditions;
mod generator;
mod guidance;
mod latent;
mod noise;
mod options;
mod pixel_codec;
mod preset;
mod process;
mod recipe;
mod rolling;
mod sampler;
mod schedule;
mod session;
mod strategy;
mod window;

pub use cache::{Cache, CacheError};
pub use condition::{Condition, DroppedConditions};
pub use conditioner::{Conditioner, ConditionerError, RenderedConditions};
pub use dataset_copy::{CopiedLog, DatasetCopy, ImageCounts};
pub use denoiser::{Codec, Denoiser, Frame, GuidedPrediction};
pub use denoiser_error::DenoiserError;
pub use drive::{DriveFrame, DriveInfo, TrainingClip};
pub use error::GenerateError;
pub use frame_conditions::{CAMERA_NUMBERS, FrameConditions, NO_ACTION, NO_COLOR};
pub use generator::Generator;
pub use guidance::Guidance;
pub use latent::{Latent, LatentShape};
pub use noise::{GaussianNoise, NoiseSource};
pub use options::GenerateOptions;
pub use pixel_codec::PixelCodec;
pub use preset::Preset;
pub use process::{DenoiserRig, ProcessDenoiser};
pub use recipe::{Recipe, RecipeError};
pub use sampler::{Level, Sampler, SamplerOptions};
pub use schedule::{Ddim, FlowMatch, Prediction};
pub use session::{AnyDenoiser, Session, SessionError, SessionParts};
pub use strategy::Strategy;
pub use window::{Progress, Roll};
