//! Operations of the network: convolutions of 3x3 pixels, linear layers, halving and doubling, attention
//! along three axes, GELU, and a norm and a residual that are modulated per frame.
//!
//! # How it works
//! Plain loops over slices, written so that the compiler vectorizes them under `pulp`'s dispatch. Attention
//! gathers its tokens itself, so nothing is permuted in memory. One thread computes a group or a row in a
//! fixed order, so results do not depend on the number of threads. All widths are multiples of [`LANES`].
#![allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes

mod attention;
mod convolution;
mod gate;
mod grid;
mod linear;
mod math;
mod norm;
mod resize;

pub(super) use attention::AttentionMlp;
pub(super) use convolution::Convolution;
pub(super) use gate::gated_add;
pub use grid::Attend;
pub(super) use grid::Grid;
pub(super) use linear::Linear;
pub(super) use math::silu;
pub(super) use norm::norm_modulate;
pub(super) use resize::{Resize, neighbors};

/// Divisor of all widths.
pub(super) const LANES: usize = 16;

/// Prevents division by 0 in norms.
const EPSILON: f32 = 1e-6;

#[cfg(test)]
mod tests;
