//! Tests of the small network by its public interface.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

mod network;
