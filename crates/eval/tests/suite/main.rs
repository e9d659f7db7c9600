//! Tests of metrics by their public interface, one module per subject.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

mod metrics;
#[cfg(feature = "town")]
mod sweeps;
mod town_masks;
