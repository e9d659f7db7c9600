//! Tests of the live page by its public interface, as a client sees it.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

mod client;
mod commands;
mod connections;
mod driving;
mod edits;
mod generation;
