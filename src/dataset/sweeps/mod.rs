//! Sweep files: what the readers of all layouts have in common.
//!
//! # How it works
//! `format` recognizes files by their header. `layout` recognizes rows without a header by the values that
//! `sample` reads. `pcd` reads files with a header. `rows` collects the points and decides what a value that
//! is not a number means. `devices` judges whether the numbers of a column are beams or merged LiDARs, and
//! `decision` decides for a log.

#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
mod decision;
mod devices;
mod format;
#[cfg(feature = "nuscenes")]
mod layout;
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
mod lzf;
#[cfg(feature = "nuscenes")]
mod multiples;
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
pub(super) mod pcd;
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
mod pcd_header;
mod rows;
#[cfg(feature = "nuscenes")]
mod sample;

#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
pub(super) use decision::RingDecision;
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
pub(super) use format::is_pcd;
pub(super) use format::named_format;
#[cfg(feature = "nuscenes")]
pub(super) use layout::columns;
pub(super) use rows::{SweepRow, SweepRows};
#[cfg(feature = "nuscenes")]
pub(super) use sample::ReadAt;
