//! Tests of the core by its public interface, one module per subject. Shared logs and comparators are in
//! `crates/testing`.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers outside `#[test]`

mod build_resume;
mod conditions;
mod dataset;
mod distortion;
mod examples;
mod lenses;
mod peer_lines;
mod raster;
mod rates;
mod real_frames;
mod scenario;
mod sheet;
mod skeleton_store;
mod templates;
mod tensor;
