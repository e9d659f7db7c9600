//! Point clouds in memory and on disk.
//!
//! # How it works
//! [`Point`] is the one layout of a point, on the device as in memory. Files of others ([`npy`], [`ply`]) are read
//! row by row into a [`PointFile`], which keeps the rows' order, takes a large origin off before the coordinates
//! become `f32`, and counts rows that cannot be drawn. [`cameras`] reads the views that a bare cloud is drawn into.

pub mod cameras;
mod morton;
pub mod npy;
pub mod ply;
mod point;
mod rows;

pub use morton::morton_order;
pub use point::{Bounds, Point};
pub use rows::PointFile;

use std::path::Path;

use crate::error::FileError;

/// Reads `P.npy` or `P.ply`, told apart by the name's ending.
///
/// # Errors
/// Another ending, a file that is missing or not as its format says.
pub fn read(path: &Path) -> Result<PointFile, FileError> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("npy") => npy::read(path),
        Some("ply") => ply::read(path),
        other => {
            let found = other.map_or("no ending".to_owned(), |e| format!(".{e}"));
            Err(FileError::content("points in a file ending in .npy or .ply", found, path))
        }
    }
}
