//! Sweep files: what the readers of all layouts have in common.
//!
//! # How it works
//! `format` recognizes files by their header. `layout` recognizes rows without a header by the values that
//! `sample` reads. `pcd` reads files with a header. `rows` collects the points and decides what a value that
//! is not a number means. `devices` judges whether the numbers of a column are beams or merged LiDARs, and
//! `decision` decides for a log.

mod decision;
mod devices;
mod format;
mod layout;
mod lzf;
mod multiples;
pub(super) mod pcd;
mod pcd_header;
mod rows;
mod sample;

pub(super) use decision::RingDecision;
pub(super) use format::is_pcd;
pub(super) use format::named_format;
pub(super) use layout::columns;
pub(super) use rows::{SweepRow, SweepRows};
pub(super) use sample::ReadAt;
