//! Tests that run the command, one module per subject, and tests of crates that have no folder of their own.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)] // helpers outside `#[test]`

mod cases;
mod cli;
mod generate;
mod readers;
mod sim;
mod simulate;
mod tiny_log;
mod town;
mod untrusted;
