//! Lanes as traffic sees them: how far along, who meets at their end, which ways cross.

use rustc_hash::FxHashMap;

use super::clash;
use crate::town::plan::line::Path;
use crate::town::plan::{JunctionKind, LaneKind, Network, Turn};

/// Metres from the end of a road's lane back to where vehicles stop: before the crossing, or before a bend.
pub(super) const STOP_M: f64 = 7.0;
const STOP_FREE_M: f64 = 0.5;
/// Metres from a junction to beyond the crossing on the road after it.
pub(super) const BEYOND_CROSSING_M: f64 = 6.0;

/// The lanes of a network, measured.
pub(super) struct Lanes<'a> {
    pub(super) network: &'a Network,
    /// The centerline of each lane.
    pub(super) paths: Vec<Path>,
    /// What each way through a junction is; `None` for lanes of roads.
    pub(super) ways: Vec<Option<Way>>,
    clear_m: [FxHashMap<(usize, usize), f64>; 2],
}

/// A way through a junction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    pub(super) junction: usize,
    pub(super) kind: JunctionKind,
    pub(super) turn: Turn,
    /// The lane before and the lane after.
    pub(super) from: usize,
    pub(super) to: usize,
    /// The road that it comes from.
    pub(super) road: usize,
    /// Indices of the crossings before and after it.
    pub(super) crossings: [Option<usize>; 2],
}

impl Way {
    /// Metres from the end of the lane before it back to where vehicles wait.
    pub(super) fn stop_m(&self) -> f64 {
        if self.kind == JunctionKind::Free { STOP_FREE_M } else { STOP_M }
    }
}

impl<'a> Lanes<'a> {
    pub(super) fn new(network: &'a Network) -> Self {
        let paths: Vec<Path> = network.lanes.iter().map(|lane| Path::new(&lane.centerline)).collect();
        let mut ways = vec![None; paths.len()];
        for (from, lane) in network.lanes.iter().enumerate() {
            let LaneKind::Road(road) = lane.kind else { continue };
            for way in &lane.successors {
                ways[*way] = Self::way(network, &paths, [from, *way], road);
            }
        }
        let clear_m = clash::tables(&paths, &ways);
        Self { network, paths, ways, clear_m }
    }

    fn way(network: &Network, paths: &[Path], [from, way]: [usize; 2], road: usize) -> Option<Way> {
        let LaneKind::Junction(junction) = network.lanes[way].kind else { return None };
        let to = *network.lanes[way].successors.first()?;
        let LaneKind::Road(next) = network.lanes[to].kind else { return None };
        let kind = network.junctions[junction].kind;
        let crossing = |road: usize| {
            let [mouth, along] = network.roads[road].mouth(junction)?;
            let near = |path: [glam::DVec2; 2]| ((path[0] + path[1]) / 2.0 - mouth).dot(along).abs() < 10.0;
            network.crossings.iter().position(|c| c.road == road && near(c.path))
        };
        let turn = Turn::of(paths[way].points());
        Some(Way { junction, kind, turn, from, to, road, crossings: [crossing(road), crossing(next)] })
    }

    /// How far the middle of a vehicle on way `a` must be along it so that nobody on way `b` can touch it, metres. `None`: the
    /// two do not come near each other.
    pub(super) fn clear_m(&self, a: usize, b: usize, long: bool) -> Option<f64> {
        self.clear_m[usize::from(long)].get(&(a, b)).copied()
    }

    pub(super) fn length_m(&self, lane: usize) -> f64 {
        self.paths[lane].length_m()
    }

    /// Whether streets go on for some junctions beyond a lane.
    pub(super) fn is_open(&self, lane: usize, junctions: usize) -> bool {
        let next = &self.network.lanes[lane].successors;
        match self.ways[lane] {
            Some(way) => self.is_open(way.to, junctions),
            None if junctions == 0 => !next.is_empty(),
            None => next.iter().any(|way| self.is_open(*way, junctions - 1)),
        }
    }
}
