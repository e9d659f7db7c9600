//! Tests of the core by its public interface, one module per subject. Tests that run the command are in
//! `crates/pskel/tests`, shared logs and comparators in `crates/testing`.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers outside `#[test]`

mod conditions;
mod dataset;
mod raster;
mod real_frames;
mod sheet;
mod skeleton_store;
