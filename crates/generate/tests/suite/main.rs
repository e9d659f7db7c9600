//! Tests of the generator by its public interface, one module per subject.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

mod beyond_log;
mod images;
mod process;
mod references;
mod rolls;
