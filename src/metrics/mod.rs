//! Numbers that tell how good an image is.

mod image_quality;

pub use image_quality::{FilledError, compare_filled};
