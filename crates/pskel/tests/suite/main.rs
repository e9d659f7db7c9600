//! Tests that run the command, one module per subject.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers outside `#[test]`

mod cases;
mod cli;
mod simulate;
mod tiny_log;
mod town;
mod untrusted;
