//! Tests of the whole library, by subject.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers stand outside `#[test]`

mod bench_cli;
mod cli_build;
mod cli_render;
mod common;
mod conditions;
mod info;
mod npz;
mod nuscenes;
mod nuscenes_bad;
mod parity;
mod raster;
mod real_frames;
mod real_log;
mod sheet;
mod skeleton_store;
mod splat_cli;
mod street;
mod templates;
mod tiny_log;
