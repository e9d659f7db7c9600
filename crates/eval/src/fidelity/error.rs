use point_skeleton::dataset::DatasetError;
use pskel_town::TownError;

/// Error of comparing maps with ground truth.
#[derive(Debug, thiserror::Error)]
pub enum FidelityError {
    /// The log has no such frame.
    #[error("expected frame {frame} in log {log}, found none")]
    NoFrame {
        /// Number of the frame.
        frame: usize,
        /// Name of the log.
        log: String,
    },
    /// The HD map or an image cannot be read.
    #[error("{0}")]
    Dataset(#[from] DatasetError),
    /// The ground truth cannot be rendered.
    #[error("{0}")]
    Town(#[from] TownError),
    /// The maps cannot be rendered.
    #[error("{0}")]
    Maps(#[from] point_skeleton::Error),
}
