//! Metrics of an image, a set of images, or a rollout of generated images.
//!
//! # How it works
//! Leaf functions compare two images ([`psnr_db`], [`ssim`], [`sharpness`]), two masks ([`Overlap`]) or two
//! sets of features ([`frechet_distance`]). [`RolloutScores`] takes the steps of a rollout, in memory, and
//! computes a series per metric with its [`Drift`], the [`Motion`] of actors, and the features of
//! [`RandomConvNet`]. [`CollectedFeatures`] computes distances between the features of many rollouts, and
//! [`MeanInterval`] averages over rollouts. These read no files. [`evaluate`] scores the rollouts in folders,
//! `fidelity` (feature `town`) compares the maps of the synthetic town with its ground truth, and `ablate`
//! (feature `network`) generates images with variants of the generator and compares their scores.
//! [`protocol`] defines evaluation protocols, and [`bench`](mod@bench) measures the speed of rendering.

#[cfg(feature = "network")]
pub mod ablate;
pub mod bench;
mod conv_net;
mod depth;
mod drift;
mod evaluate;
mod features;
#[cfg(feature = "town")]
mod fidelity;
mod frechet;
mod image_quality;
#[cfg(feature = "network")]
mod loss_plot;
mod luma;
mod masks;
mod motion;
mod patch_classifier;
pub mod plot;
pub mod protocol;
mod pseudo_label;
mod scores;
mod seams;
mod sharpness;
mod ssim;
mod statistics;
mod table;

pub use conv_net::RandomConvNet;
pub use depth::{DepthErrors, DepthSummary};
pub use drift::Drift;
pub use evaluate::{EvaluateError, EvaluateOptions, Report, SCORES, evaluate};
pub use features::{FeatureSet, WINDOW_FRAMES, window_features};
#[cfg(feature = "town")]
pub use fidelity::{FidelityError, FidelityFiles, FidelityReport, MaskRow, POSES, Row, fidelity};
pub use frechet::{FrechetError, frechet_distance};
pub use image_quality::{FilledError, compare_filled, psnr_db};
#[cfg(feature = "network")]
pub use loss_plot::loss_plot;
pub(crate) use luma::luma;
pub use masks::Overlap;
pub use motion::{MOVING_MPS, Motion, MotionSums, MovingFrame, moving_mask};
pub use patch_classifier::{PatchClassifier, PatchClassifierError, PatchOptions, PatchTrainer};
pub use pseudo_label::{VEHICLE_CLASS, vehicle_mask};
pub use scores::{
    CollectedFeatures, Distance, Distances, RolloutScores, ScoreError, ScoredFrame, Scores,
    SegmentationMasks, Series, VehicleIou,
};
pub use seams::SeamSums;
pub use sharpness::sharpness;
pub use ssim::ssim;
pub use statistics::{MeanInterval, mean_interval, paired_difference};
