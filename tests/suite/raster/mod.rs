//! The rasterizers: exact cases, comparisons with each other, and results of other implementations.
//!
//! All tests run under the validation layer with synchronization validation, and fail on any message. They
//! need a Vulkan device; without one they fail with instructions to install a driver.

mod culling;
mod device;
mod exact;
mod fixture;
mod forked;
mod frames;
mod quotient;
mod random;
mod streaming;
