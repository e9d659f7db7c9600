//! Metrics of an image, a set of images, or a rollout of generated images.
//!
//! # How it works
//! Leaf functions compare two images ([`psnr_db`], [`ssim`], [`sharpness`]) or two masks ([`Overlap`]).
//! [`RolloutScores`] takes the steps of a rollout, in memory, and
//! computes a series per metric with its [`Drift`], and the [`Motion`] of actors. [`MeanInterval`] averages
//! over rollouts. These read no files. [`evaluate`] scores the rollouts in folders, `fidelity` (feature
//! `town`) compares maps with the ground truth of the synthetic town or with recorded images. [`protocol`]
//! defines evaluation protocols; `protocol::ablation` (feature `network`) compares variants of the generator.
//! [`bench`](mod@bench) measures the speed of rendering.

pub mod bench;
mod depth;
mod drift;
mod evaluate;
#[cfg(feature = "town")]
mod fidelity;
mod images;
mod intervals;
mod networks;
pub mod plot;
pub mod protocol;
mod scores;
mod statistics;
mod table;
mod vehicles;

pub use depth::{DepthErrors, DepthSummary};
pub use drift::Drift;
pub use evaluate::{EvaluateError, EvaluateOptions, Report, SCORES, evaluate};
#[cfg(feature = "town")]
pub use fidelity::{
    CameraRow, FidelityError, FidelityFiles, FidelityFrames, FidelityReport, FidelitySource, MaskBand,
    MaskRow, Row, Rows, SweepRow, fidelity, sweep_fidelity,
};
pub use images::image_quality::{FilledError, compare_filled, psnr_db};
pub use images::motion::{MOVING_MPS, Motion, MotionSums, MovingFrame, moving_mask};
pub use images::seams::SeamSums;
pub use images::sharpness::sharpness;
pub use images::ssim::ssim;
pub use intervals::{Interval, score_interval, share_interval};
pub use networks::{Distance, MetricNetworks, NetworkError, NetworkPaths};
pub use scores::{RolloutScores, ScoreError, ScoredFrame, Scores, Series, VehicleIou};
pub use statistics::{MeanInterval, mean_interval, paired_difference};
pub use vehicles::differences::{MaskDifference, MaskDifferences, MaskPair};
pub use vehicles::masks::Overlap;
pub use vehicles::pseudo_label::{MaskRule, VEHICLE_CLASS, vehicle_mask};
