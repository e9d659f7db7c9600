//! Error of creating or rendering a town.

use point_skeleton::dataset::DatasetError;
use point_skeleton::geometry::CameraError;
use point_skeleton::gpu::GpuError;

use crate::TownOptionsError;
use crate::view::MeshRenderError;

/// Error of creating or rendering a town.
#[derive(Debug, thiserror::Error)]
pub enum TownError {
    /// The options are out of range.
    #[error(transparent)]
    Options(#[from] TownOptionsError),
    /// No camera can have the image size.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Rendering failed.
    #[error(transparent)]
    TownRenderer(#[from] MeshRenderError),
    /// The device or driver failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A track is not in the town.
    #[error("expected tracks of town {town}, found {track}")]
    Track {
        /// Name of the town's log.
        town: String,
        /// The unknown track.
        track: String,
    },
}

impl From<TownError> for DatasetError {
    fn from(error: TownError) -> Self {
        Self::Synthetic(Box::new(error))
    }
}

impl From<TownOptionsError> for DatasetError {
    fn from(error: TownOptionsError) -> Self {
        Self::Synthetic(Box::new(error))
    }
}
