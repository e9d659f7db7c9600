//! What there is in the town and who moves how: streets, lanes, traffic, the ego's drive. No shapes.
//!
//! All in the town's frame, metres: x and y on the ground, z up; roads lie at z = 0, sidewalks [`KERB_M`] higher.

mod corner;
mod graph;
pub mod line;
mod network;
#[cfg(test)]
mod network_tests;
mod random;
mod signals;
mod streets;
mod traffic;
mod ways;

pub use network::{
    Crossing, Junction, JunctionEdge, JunctionKind, LaneKind, Network, Road, Side, Signal, TownLane,
};
pub use traffic::{Actor, Motion, Traffic};
pub use ways::Turn;

use super::TownOptions;

/// Height of sidewalks above the road, metres.
pub const KERB_M: f64 = 0.14;

/// The plan of a town and of a drive in it.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Streets and lanes.
    pub network: Network,
    /// The ego and everybody else.
    pub traffic: Traffic,
}

impl Plan {
    /// The plan that follows from a seed, with as much traffic as the frames need.
    pub fn new(options: &TownOptions) -> Self {
        let network = Network::new(options.seed);
        let traffic = Traffic::new(&network, options.seed, options.duration_s());
        Self { network, traffic }
    }
}
