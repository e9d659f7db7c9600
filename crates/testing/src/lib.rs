//! What the tests of several crates share: synthetic logs, locations of recordings, and comparators.
//!
//! Only its comparators have tests of their own, and it is never a dependency outside of tests.
//! Whatever needs a layer above the core has a feature, so that the core's tests compile no layer.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

#[cfg(feature = "av2")]
pub mod av2_log;
pub mod devices;
#[cfg(feature = "generate")]
pub mod generator_inputs;
pub mod npz;
#[cfg(feature = "nuplan")]
pub mod nuplan_log;
pub mod parity;
#[cfg(feature = "123d")]
pub mod py123d_log;
pub mod shared;
pub mod six_cameras;
#[cfg(feature = "network")]
pub mod small_network;
pub mod stubborn_peer;
#[cfg(feature = "town")]
pub mod synthetic_town;
pub mod table_sets;
pub mod tiny_log;
pub mod warped_log;
#[cfg(feature = "sim")]
pub mod winding_road;
