use std::path::PathBuf;

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
        "expected cameras of one size in an NPZ (--size or --out-size make it so), found {first} and {other}: {}",
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
