//! The parts of the network for which the tensor library has no operation, or one that is far slower: attention along
//! three axes, GELU, a norm and a residual that are modulated per frame.
//!
//! # How it works
//! Plain loops over slices, written so that the compiler turns them into vectors under `pulp`'s dispatch. Measured on two
//! cores, the library's softmax and tanh GELU (one thread, a call of the C library per value) take longer than all matrix
//! products of a block together; these take a small share of it. Attention gathers its tokens itself, so nothing is
//! permuted in memory. A group or a row is worked out by one thread in one order: results do not depend on the number of
//! threads. All widths are multiples of [`LANES`].
#![allow(clippy::needless_range_loop)] // loops over lanes: this form becomes vectors

mod attention;
mod gate;
mod grid;
mod math;
mod norm;

pub(super) use attention::Mix;
pub(super) use gate::{gate_backward, gate_forward};
pub use grid::Attend;
pub(super) use grid::Grid;
pub(super) use norm::{norm_backward, norm_forward};

/// What all widths are multiples of.
pub(super) const LANES: usize = 16;

/// Keeps roots off zero.
const EPSILON: f32 = 1e-6;

#[cfg(test)]
mod tests;
