//! The subcommands of `pskel`, one module each.

pub(super) mod bench;
pub(super) mod build;
pub(super) mod convert;
#[cfg(feature = "drive")]
pub(super) mod drive;
pub(super) mod evaluate;
pub(super) mod export;
#[cfg(feature = "town")]
pub(super) mod fidelity;
#[cfg(feature = "network")]
pub(super) mod generate;
pub(super) mod info;
#[cfg(feature = "network")]
pub(super) mod protocol;
pub(super) mod render;
pub(super) mod scenario;
pub(super) mod simulate;
pub(super) mod splat;
pub(super) mod templates;
#[cfg(feature = "town")]
pub(super) mod town;
