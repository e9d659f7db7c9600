//! Point clouds in memory and on disk.
//!
//! # How it works
//! [`Point`] is the only point layout, in host and device memory. Files of other tools ([`npy`], [`ply`]) are
//! read row by row into a [`PointFile`]. It preserves the row order, subtracts an origin near most points
//! before the coordinates become `f32` ([`origin_of`]), finds the range of the colors ([`ColorRange`]), and
//! counts rows that cannot be rendered or lost precision. [`cameras`] reads the views for rendering a bare
//! cloud. A [`Cloud`] to render is in memory, or in a file that is read page by page ([`paged`]).

pub mod cameras;
mod colors;
mod format;
mod morton;
mod not_finite;
pub mod npy;
mod npy_header;
mod origin;
pub mod paged;
pub mod ply;
mod point;
mod rows;
mod source;

pub use colors::{ColorRange, ColorScale, ColorValues};
pub use format::{PointFormat, PointOutput};
pub(crate) use morton::morton_order;
pub use morton::sort_in_space;
pub(crate) use not_finite::not_finite;
pub use origin::{PRECISE_WITHIN_M, Precision, local_position, origin_of};
pub use point::{Bounds, Point};
pub use rows::PointFile;
pub use source::Cloud;

use std::path::Path;

use crate::error::FileError;

/// Reads a point cloud from `P.npy` or `P.ply`, depending on the file extension.
///
/// # Errors
/// Fails if the extension is another one, the file is missing, or its content violates the format.
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
