//! Tests of the synthetic town by its public interface, one module per subject.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers outside `#[test]`

mod town_lidar;
mod town_log;
mod town_view;
