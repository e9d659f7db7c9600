use point_skeleton::dataset::DatasetError;
use point_skeleton::error::FileError;
use point_skeleton::scene::GroundTruthError;
use point_skeleton::skeleton::BuildError;
use pskel_generate::{ConditionerError, DenoiserError, GenerateError};
use pskel_network::NetworkError;
use pskel_sim::SimError;

use crate::ScoreError;

/// Error of an ablation study.
#[derive(Debug, thiserror::Error)]
pub enum AblationError {
    /// The networks are not comparable.
    #[error("expected networks of one recipe, window and number of cameras, found {found}")]
    Networks {
        /// The main network and another one.
        found: String,
    },
    /// The log is too short: replayed actors are removed after it ends.
    #[error("expected a log of {expected} plan steps, found {found}")]
    Length {
        /// Required number of planning steps.
        expected: usize,
        /// Number of planning steps in the log.
        found: usize,
    },
    /// The instance map of a camera is missing.
    #[error("expected instance maps, found none")]
    NoMasks,
    /// The log cannot be read.
    #[error("{0}")]
    Log(#[from] DatasetError),
    /// The skeleton cannot be built.
    #[error("{0}")]
    Skeleton(#[from] BuildError),
    /// The renderer cannot be created.
    #[error("{0}")]
    Render(#[from] point_skeleton::Error),
    /// The simulation failed.
    #[error("{0}")]
    Simulation(#[from] SimError),
    /// The conditions cannot be rendered.
    #[error("{0}")]
    Conditions(#[from] ConditionerError),
    /// The ground-truth images cannot be rendered or read.
    #[error("{0}")]
    GroundTruth(#[from] GroundTruthError),
    /// The network has no codec.
    #[error("{0}")]
    Network(#[from] NetworkError),
    /// An image cannot be encoded or decoded.
    #[error("{0}")]
    Codec(#[from] DenoiserError),
    /// The options of a variant are inconsistent, or its generator failed.
    #[error("{0}")]
    Generate(#[from] GenerateError),
    /// A frame cannot be scored.
    #[error("{0}")]
    Score(#[from] ScoreError),
    /// A result, the skeleton or a template cannot be read or written.
    #[error("{0}")]
    File(#[from] FileError),
}
