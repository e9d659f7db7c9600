//! Tests of exports by their public interface, one module per layout.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

#[cfg(feature = "parquet")]
mod alpasim;
mod clips;
mod made_log;
mod mcap;
