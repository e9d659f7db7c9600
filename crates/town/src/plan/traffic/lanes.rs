//! Lanes prepared for traffic: centerlines with lengths, paths through junctions, and their conflicts.

use point_skeleton::geometry::Polyline;
use rustc_hash::FxHashMap;

use super::clash;
use super::junction_path::JunctionPath;
use crate::plan::line::polyline;
use crate::plan::{LaneKind, Network, Turn};

/// Distance from a junction to beyond the crossing on the following road, meters.
pub(super) const BEYOND_CROSSING_M: f64 = 6.0;

/// Lanes of a network with their lengths and conflicts.
pub(super) struct Lanes<'a> {
    pub(super) network: &'a Network,
    /// Centerline of each lane.
    pub(super) paths: Vec<Polyline>,
    /// Data of each path through a junction; `None` for lanes of roads.
    pub(super) connectors: Vec<Option<JunctionPath>>,
    clear_m: [FxHashMap<(usize, usize), f64>; 2],
}

impl<'a> Lanes<'a> {
    pub(super) fn new(network: &'a Network) -> Self {
        let paths: Vec<Polyline> = network.lanes.iter().map(|lane| polyline(&lane.centerline)).collect();
        let mut connectors = vec![None; paths.len()];
        for (from, lane) in network.lanes.iter().enumerate() {
            let LaneKind::Road(road) = lane.kind else { continue };
            for connector in &lane.successors {
                connectors[*connector] = Self::connector(network, &paths, [from, *connector], road);
            }
        }
        let clear_m = clash::tables(&paths, &connectors);
        Self { network, paths, connectors, clear_m }
    }

    fn connector(
        network: &Network,
        paths: &[Polyline],
        [from, connector]: [usize; 2],
        road: usize,
    ) -> Option<JunctionPath> {
        let LaneKind::Junction(junction) = network.lanes[connector].kind else { return None };
        let to = *network.lanes[connector].successors.first()?;
        let LaneKind::Road(next) = network.lanes[to].kind else { return None };
        let kind = network.junctions[junction].kind;
        let crossing = |road: usize| {
            let [mouth, along] = network.roads[road].mouth(junction)?;
            let near = |path: [glam::DVec2; 2]| ((path[0] + path[1]) / 2.0 - mouth).dot(along).abs() < 10.0;
            network.crossings.iter().position(|c| c.road == road && near(c.path))
        };
        let turn = Turn::of(paths[connector].points());
        Some(JunctionPath {
            junction,
            kind,
            turn,
            from,
            to,
            road,
            crossings: [crossing(road), crossing(next)],
        })
    }

    /// Returns the distance along path `a` that the middle of a vehicle must have reached so that no vehicle
    /// on path `b` can touch it, meters. `None` if the two do not come near each other.
    pub(super) fn clear_m(&self, a: usize, b: usize, long: bool) -> Option<f64> {
        self.clear_m[usize::from(long)].get(&(a, b)).copied()
    }

    pub(super) fn length_m(&self, lane: usize) -> f64 {
        self.paths[lane].length_m()
    }

    /// Returns whether the route can continue for a number of junctions beyond a lane.
    pub(super) fn is_open(&self, lane: usize, junctions: usize) -> bool {
        let next = &self.network.lanes[lane].successors;
        match self.connectors[lane] {
            Some(connector) => self.is_open(connector.to, junctions),
            None if junctions == 0 => !next.is_empty(),
            None => next.iter().any(|connector| self.is_open(*connector, junctions - 1)),
        }
    }
}
