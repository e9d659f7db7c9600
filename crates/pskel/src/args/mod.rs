//! Groups of options that several subcommands share.

#[cfg(feature = "network")]
pub(super) mod generator;
pub(super) mod log;
pub(super) mod maps;
pub(super) mod names;
pub(super) mod numbers;
pub(super) mod outputs;
pub(super) mod rasterizer;
pub(super) mod skeletons;
pub(super) mod substitutes;
pub(super) mod threads;
