//! The rasterizers: exact cases, twins against each other, and other implementations' results.
//!
//! All tests run under the validation layer with synchronization validation, and fail on any message. They need a
//! Vulkan device; where there is none they fail and say how to install one.

mod device;
mod exact;
mod fixture;
mod frames;
mod random;
pub(crate) mod twins;
