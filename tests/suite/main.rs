//! Tests of the whole library, by subject.

mod common;
mod nuscenes;
