//! Tests of the whole library, by subject.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers stand outside `#[test]`

mod av2;
mod av2_bad;
mod av2_log;
mod bench_cli;
mod build_resume;
mod cli_build;
mod cli_render;
mod common;
mod conditions;
mod distortion;
mod info;
mod npz;
mod nuplan;
mod nuplan_bad;
mod nuplan_made;
mod nuplan_real;
mod nuscenes;
mod nuscenes_bad;
mod nuscenes_map;
mod parity;
mod peer_lines;
mod raster;
mod rates;
mod real_frames;
mod real_log;
mod sheet;
mod skeleton_store;
mod splat_cli;
mod street;
mod templates;
mod tensor;
mod tiny_log;
mod town_log;
mod town_view;
