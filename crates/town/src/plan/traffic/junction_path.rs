//! Path of a lane through a junction: turn, right of way, stop position.

use crate::plan::{JunctionKind, Turn};

/// Distance from the end of a road's lane back to the stop position, meters: before a crossing, and before a
/// bend.
pub(super) const STOP_M: f64 = 7.0;
const STOP_FREE_M: f64 = 0.5;

/// Path through a junction.
#[derive(Clone, Copy, Debug)]
pub(super) struct JunctionPath {
    pub(super) junction: usize,
    pub(super) kind: JunctionKind,
    pub(super) turn: Turn,
    /// Lanes before and after it.
    pub(super) from: usize,
    pub(super) to: usize,
    /// Road that it comes from.
    pub(super) road: usize,
    /// Indices of the crossings before and after it.
    pub(super) crossings: [Option<usize>; 2],
}

impl JunctionPath {
    /// Returns the distance from the end of the lane before it back to the stop position, meters.
    pub(super) fn stop_m(&self) -> f64 {
        if self.kind == JunctionKind::Free { STOP_FREE_M } else { STOP_M }
    }
}
