//! Plan of the town: streets, lanes, traffic and the ego's route, without shapes.
//!
//! All coordinates are in the town's frame, meters: x and y on the ground, z up. Roads lie at z = 0,
//! sidewalks [`KERB_M`] higher.

mod corner;
mod graph;
mod lanes;
pub mod line;
mod network;
#[cfg(test)]
mod network_tests;
mod random;
mod signals;
mod streets;
mod traffic;

pub use lanes::Turn;
pub use network::{
    Crossing, Junction, JunctionEdge, JunctionKind, LaneKind, Network, Road, Side, Signal, TownLane,
};
pub use traffic::{Actor, Motion, Traffic};

use super::TownOptions;

/// Height of sidewalks above the road, meters.
pub const KERB_M: f64 = 0.14;

/// Plan of a town and of a recording in it.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Streets and lanes.
    pub network: Network,
    /// Motion of the ego and of all actors.
    pub traffic: Traffic,
}

impl Plan {
    /// Generates the plan from the options' seed, with traffic for their duration.
    pub fn new(options: &TownOptions) -> Self {
        let network = Network::new(options.seed);
        let traffic = Traffic::new(&network, options.seed, options.duration_s());
        Self { network, traffic }
    }
}
