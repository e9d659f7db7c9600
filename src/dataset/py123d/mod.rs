//! Logs in the 123D layout.

#![allow(dead_code, reason = "the reader of tables is not part of it yet")]

mod codec;

pub use codec::count_points;
