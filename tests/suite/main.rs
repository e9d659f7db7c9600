//! Tests of the whole library, by subject.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers stand outside `#[test]`

mod common;
mod conditions;
mod npz;
mod nuscenes;
mod parity;
mod raster;
mod sheet;
mod skeleton_store;
mod splat_cli;
