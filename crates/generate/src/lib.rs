//! The generator: a denoising loop that turns the conditions of a simulation into camera images, frame by
//! frame.
//!
//! # How it works
//! A [`Generator`] holds a window of latents. At each simulation step it takes the committed conditions of
//! the step and forecasts of the next steps, calls its [`Denoiser`] according to its [`Strategy`], and
//! returns the finished latent of the step. A [`Codec`] decodes that latent into images. `schedule` and
//! `sampler` define the noise levels and the denoising update. `window` computes the position of every frame
//! of the window in its schedule, and `guidance` combines two predictions. Networks are exchangeable: the
//! crate `pskel-network` has a small one, [`toy`] is a linear network for tests, and [`ProcessDenoiser`]
//! calls a network in another process. An [`ImageSession`] asks another process for the images
//! themselves, an [`ImportSession`] takes those of a folder.

mod conditions;
mod denoiser;
mod error;
mod generator;
mod images;
mod imported;
mod options;
mod process;
mod recordings;

pub use conditions::condition::{Condition, ConditionKind, DroppedConditions, GuidedConditions};
pub use conditions::conditioner::{Conditioner, ConditionerError, RenderedConditions};
pub use conditions::frame_conditions::{CAMERA_NUMBERS, FrameConditions, NO_ACTION, NO_COLOR};
pub use conditions::preset::Preset;
pub use conditions::recipe::{Recipe, RecipeError};
pub use denoiser::error::DenoiserError;
pub use denoiser::guidance::Guidance;
pub use denoiser::latent::{Latent, LatentShape};
pub use denoiser::noise::{GaussianNoise, NoiseSource};
pub use denoiser::pixel_codec::PixelCodec;
pub use denoiser::sampler::{Level, Sampler, SamplerOptions};
pub use denoiser::schedule::{Ddim, FlowMatch, Prediction};
pub use denoiser::toy;
pub use denoiser::{Codec, Denoiser, Frame, GuidedPrediction};
pub use error::GenerateError;
pub use generator::Generator;
pub use generator::cache::{Cache, CacheError};
pub use generator::scene::GenerationScene;
pub use generator::session::{AnyDenoiser, Session, SessionError, SessionParts};
pub use generator::strategy::Strategy;
pub use generator::window::{Progress, Roll};
pub use images::session::ImageSession;
pub use images::{ImageProcess, ImageProcessError, ImageRig};
pub use imported::counts::{Counted, ImportCounts};
pub use imported::export::RolloutImages;
pub use imported::folder::{ImageFolder, ImageLayout, ImportOptions};
pub use imported::matching::{ClipFrames, ClipImages};
pub use imported::session::ImportSession;
pub use options::GenerateOptions;
pub use process::{DenoiserRig, ProcessDenoiser};
pub use recordings::dataset_copy::{CopiedLog, DatasetCopy, GENERATED_LIST, ImageCounts, SampleCounts};
