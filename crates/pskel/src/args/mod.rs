//! Arguments that several commands share, each defined once, and parsers of their values.

pub(crate) mod actors;
pub(crate) mod frames;
#[cfg(feature = "network")]
pub(crate) mod generator;
#[cfg(feature = "network")]
pub(crate) mod images;
pub(crate) mod lidar;
pub(crate) mod log;
pub(crate) mod maps;
#[cfg(feature = "network")]
pub(crate) mod metrics;
pub(crate) mod names;
pub(crate) mod numbers;
pub(crate) mod outputs;
pub(crate) mod prompt;
pub(crate) mod rasterizer;
pub(crate) mod rollout;
pub(crate) mod size;
pub(crate) mod source;
pub(crate) mod substitutes;
pub(crate) mod threads;
