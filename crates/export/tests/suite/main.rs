//! Tests of exports by their public interface, one module per layout.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

mod clips;
mod made_log;
mod mcap;
