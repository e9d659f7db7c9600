//! Ablation study of the generator: variants are compared in scenes whose ground truth is known.
//!
//! # How it works
//! `rows` defines the variants and `scene` renders their inputs: in each log the ego changes lanes in a
//! closed loop, and all variants generate the same steps. `run` generates and scores one variant in a scene,
//! `report` compares the results over all scenes. An [`Ablation`] writes them to a folder, and reuses results
//! that are in it.

mod error;
mod options;
mod report;
mod rows;
mod run;
mod scene;
mod study;
mod variant;

pub use error::AblationError;
pub use options::{AblationOptions, Networks, Origin};
pub use report::Report;
pub use rows::Table;
pub use run::RunResult;
pub use study::Ablation;
pub use variant::Variant;
