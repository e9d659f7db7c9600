use std::path::PathBuf;

use super::ImageSize;
use crate::error::FileError;
use crate::raster::RasterError;

/// Why condition maps were not made or not written.
#[derive(Debug, thiserror::Error)]
pub enum ConditionError {
    /// The rasterizer.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A file.
    #[error(transparent)]
    File(#[from] FileError),
    /// A layout of a map that is not there.
    #[error("expected an HD map to draw map layouts from, found none in step {step}")]
    NoMap {
        /// The step.
        step: String,
    },
    /// Arrays of all cameras need one size.
    #[error(
        "expected cameras of one size in one array (--size or --out-size make it so), found {first} and {other}: {}",
        path.display()
    )]
    Sizes {
        /// Name and size of the first camera.
        first: String,
        /// Name and size of one that differs.
        other: String,
        /// The file.
        path: PathBuf,
    },
    /// A lens that bends rays from too far beside the image.
    #[error(
        "expected a lens that shows no more than a pinhole image {growth} times as large as {size}, found one that needs \
         {height}x{width}: camera {camera}"
    )]
    Lens {
        /// The camera.
        camera: String,
        /// Of its image.
        size: ImageSize,
        /// What it would take, pixels.
        height: f64,
        /// What it would take, pixels.
        width: f64,
        /// How many times larger a side may be.
        growth: u32,
    },
    /// Distorted maps are reduced without knowing which pixels are empty.
    #[error("expected bilinear color for distorted maps, found valid-area")]
    DistortedArea,
    /// A number that the file's pixels cannot hold.
    #[error("expected {map} numbers of at most {max} in a PNG (EXR and NPZ hold more), found {found}: {}", path.display())]
    PngRange {
        /// The map.
        map: &'static str,
        /// Largest number that fits.
        max: u32,
        /// Largest number in the map.
        found: u32,
        /// The file.
        path: PathBuf,
    },
}
