use std::path::PathBuf;

use super::ImageSize;
use crate::error::FileError;
use crate::memory::MemoryError;
use crate::raster::RasterError;

/// Reason why condition maps could not be rendered or written.
#[derive(Debug, thiserror::Error)]
pub enum ConditionError {
    /// Error of the rasterizer.
    #[error("{0}")]
    Raster(#[from] RasterError),
    /// Error of a file.
    #[error("{0}")]
    File(#[from] FileError),
    /// More memory is needed than available.
    #[error("{0}")]
    Memory(#[from] MemoryError),
    /// A map layout was requested, but the step has no HD map.
    #[error("expected an HD map to draw map layouts from, found none in step {step}")]
    NoMap {
        /// Name of the step.
        step: String,
    },
    /// Cameras of one array differ in size.
    #[error("expected a common image size of all cameras in one array, found {first} and {other}: \
        {}", path.display())]
    Sizes {
        /// Name and size of the first camera.
        first: String,
        /// Name and size of one that differs.
        other: String,
        /// Path of the file.
        path: PathBuf,
    },
    /// A lens shows rays from too far outside the pinhole image.
    #[error(
        "expected a lens that shows no more than a pinhole image {growth} times as large as {size}, found \
            one that needs \
         {height}x{width}: camera {camera}"
    )]
    Lens {
        /// Name of the camera.
        camera: String,
        /// Size of its image.
        size: ImageSize,
        /// Required height of the pinhole image, pixels.
        height: f64,
        /// Required width of the pinhole image, pixels.
        width: f64,
        /// Maximum enlargement of a side.
        growth: u32,
    },
    /// A color filter that leaves empty pixels out was requested for distorted maps, which do not record
    /// which pixels are empty.
    #[error("expected bilinear color for distorted maps, found a filter that leaves empty pixels out")]
    DistortedArea,
    /// A number exceeds the range of the file's pixels.
    #[error("expected {map} numbers of at most {max} in a PNG (EXR and NPZ hold more), found {found}: \
        {}", path.display())]
    PngRange {
        /// Name of the map.
        map: &'static str,
        /// Largest number that fits.
        max: u32,
        /// Largest number in the map.
        found: u32,
        /// Path of the file.
        path: PathBuf,
    },
}
