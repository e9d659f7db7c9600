//! The generator: turns conditions step by step into camera images, by a denoiser that is called frame by frame.
//!
//! # How it works
//! A [`Generator`] keeps a window of latents. At each step of the simulation it takes the committed conditions of the step
//! and forecasts of the next ones, calls its [`Denoiser`] as its [`Strategy`] has it, and gives the finished latent of the
//! step, which a [`Codec`] turns into images. `schedule` and `sampler` say how noisy a frame is after how many steps and
//! how a prediction takes noise off it, `window` which frame of the window is where in its schedule, `guidance` what becomes
//! of two predictions. Networks are exchangeable: [`network`] is a small transformer that [`train`] makes of [`Drive`]s,
//! [`toy`] a linear one for tests, `process` asks one in another process.

pub mod network;
pub mod toy;
pub mod train;

mod conditioner;
mod denoiser;
mod drive;
mod drive_file;
mod frame_conditions;
mod generator;
mod guidance;
mod latent;
mod noise;
mod pixel_codec;
mod process;
mod recipe;
mod rolling;
mod sampler;
mod saved;
mod schedule;
mod session;
mod strategy;
mod true_images;
mod window;

pub use conditioner::{Conditioner, ConditionerError, Drawn};
pub use denoiser::{Codec, Condition, Denoiser, DenoiserError, Frame};
pub use drive::{Drive, DriveFrame, DriveInfo};
pub use frame_conditions::{CAMERA_NUMBERS, FrameConditions};
pub use generator::{Cache, GenerateError, GenerateOptions, Generator};
pub use guidance::{Dropped, Guidance};
pub use latent::{Latent, LatentShape};
pub use noise::{GaussianNoise, NoiseSource};
pub use pixel_codec::PixelCodec;
pub use process::ProcessDenoiser;
pub use recipe::{Recipe, RecipeError};
pub use sampler::{Level, Sampler, SamplerOptions};
pub use saved::CacheError;
pub use schedule::{Ddim, FlowMatch, Prediction};
pub use session::{AnyDenoiser, Made, Session, SessionError, SessionParts, SessionTimes};
pub use strategy::Strategy;
pub use true_images::{TrueImages, TrueImagesError};
pub use window::{Progress, Roll};
