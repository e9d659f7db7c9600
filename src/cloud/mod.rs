//! Point clouds in memory and on disk.

mod point;

pub use point::{Bounds, Point};
