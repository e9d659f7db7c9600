//! Numbers that tell how good an image is.

mod depth;
mod image_quality;
mod masks;

pub use depth::{DepthErrors, DepthSummary};
pub use image_quality::{FilledError, compare_filled};
pub use masks::Overlap;
