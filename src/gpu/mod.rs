//! Vulkan.
#![allow(unsafe_code)]
/// Error.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// x
    #[error("x")]
    X,
}
