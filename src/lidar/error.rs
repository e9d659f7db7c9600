use crate::geometry::CameraError;
use crate::raster::{RasterError, ScheduleError};

/// Reason why a sweep could not be rendered.
#[derive(Debug, thiserror::Error)]
pub enum LidarError {
    /// A value of the spec is out of range.
    #[error("expected {expected}, found {found}")]
    Spec {
        /// Accepted values.
        expected: String,
        /// The value.
        found: String,
    },
    /// Error of the rasterizer.
    #[error("{0}")]
    Raster(#[from] RasterError),
    /// The device's angles do not fit into an image.
    #[error("LiDAR sector: {0}")]
    Camera(#[from] CameraError),
    /// The device's range is beyond the rasterizer's.
    #[error("LiDAR range: {0}")]
    Range(#[from] ScheduleError),
}
