//! Training of the [`network`](super::network) on [`Drive`](super::Drive)s.
//!
//! # How it works
//! A [`Trainer`] measures the drives (`statistics`) and fits the first guess to them (`regression`), then takes step after step: `batch` draws windows of frames, levels of
//! noise and which conditions are dropped, `objective` says how far the network's answers are off, `optimizer` moves the
//! parameters and their average. All that a step does follows from the seed, its number, the drives and the parameters
//! before, so a run that is saved (`checkpoint`) and resumed ends with the bytes of one that went through. Source of the
//! scheme: Chen et al., "Diffusion Forcing", 2024, with flow matching (Lipman et al., 2023).

mod batch;
mod checkpoint;
mod objective;
mod optimizer;
mod options;
mod regression;
mod statistics;
mod trainer;

pub use options::{DropChances, TrainOptions};
pub use statistics::measure;
pub use trainer::{StepReport, Trainer};
