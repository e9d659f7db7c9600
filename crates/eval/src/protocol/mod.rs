//! Evaluation protocols: which clips are generated from which logs, and how they are compared.
//!
//! # How it works
//! A [`Protocol`] has names of logs and parts. A [`Part`] is a policy of the ego, a rate and a
//! length; [`Part::clips`] places its clips in a log. Whoever runs a protocol generates one rollout per clip.
//! [`ProtocolReport`] scores the rollouts of all parts and has the table. [`MethodTable`] joins the results
//! of several methods. [`ScenarioReport`] has driving scores over many rollouts. `ablation` compares variants
//! of the generator on the same frames.

#[cfg(feature = "network")]
pub mod ablation;
mod clips;
mod definition;
mod methods;
mod nuscenes_val;
mod published;
mod report;
mod scenarios;
mod settings;
mod simgen;

pub use clips::{Clip, ClipClock, OtherRate, ShortLog};
pub use definition::{Length, Part, PartRates, Protocol, Starts};
pub use methods::{MethodTable, TableFormat};
pub use report::{Method, PartRollouts, ProtocolReport, ScoreOptions};
pub use scenarios::{ScenarioReport, ScenarioRollout, scenario_clips};
pub use settings::check_settings;
pub use simgen::{SIMGEN, SIMGEN_FORMAT};
