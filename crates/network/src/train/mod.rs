//! Training of the [`Network`](crate::Network) on recordings
//! ([`TrainingClip`](pskel_generate::TrainingClip)).
//!
//! # How it works
//! A [`ClipRecorder`] renders conditions and ground-truth images of a log (`record`) and stores them as
//! clips. A [`Training`] takes the steps of a [`Trainer`] and writes losses, weights and checkpoints to a
//! [`TrainingFolder`].
//!
//! A [`Trainer`] computes the statistics of the recordings (`statistics`). Then it takes one step after the
//! other: `batch` samples windows of frames, cameras, noise levels and dropped conditions, and changes them
//! (`augment`); `objective` computes the loss; `optimizer` updates the parameters and their moving average. A
//! step depends only on the seed, its number, the recordings and the previous parameters. A run that was
//! saved (`checkpoint`) and resumed therefore ends with the same bytes as an uninterrupted one. Source of the
//! scheme: Chen et al., "Diffusion Forcing", 2024, with flow matching (Lipman et al., 2023).

mod augment;
mod batch;
mod checkpoint;
mod clips;
mod losses;
mod objective;
mod optimizer;
mod options;
mod record;
mod run;
mod statistics;
mod trainer;

pub use clips::{ClipRecorder, RecordOptions};
pub use losses::{RECENT_STEPS, recent_loss};
pub use options::{DropChances, TrainOptions};
pub use record::RecordError;
pub use run::{PlotLosses, RunOptions, Training, TrainingFolder, TrainingReport};
pub use statistics::measure;
pub use trainer::{StepReport, Trainer};
