//! Groups of options that several subcommands share.

pub(super) mod choices;
#[cfg(feature = "network")]
pub(super) mod generator;
pub(super) mod log;
pub(super) mod maps;
pub(super) mod numbers;
pub(super) mod outputs;
pub(super) mod rasterizer;
pub(super) mod skeletons;
pub(super) mod substitutes;
pub(super) mod threads;
