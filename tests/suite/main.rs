//! Tests of the whole library, by subject.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;
mod conditions;
mod npz;
mod parity;
mod sheet;
mod splat_cli;
