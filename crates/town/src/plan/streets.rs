//! Roads, junctions and crossings built from a street graph.

use glam::DVec2;

use super::corner::{self, Mouth};
use super::graph::{self, Graph, Link};
use super::line::{bezier, curvature, polyline};
use super::random::Random;
use super::{Crossing, Junction, JunctionEdge, JunctionKind, Network, Road, lanes};

/// Maximum number of random graphs that are tried before the streets fall back to a plain grid.
const TRIES: u64 = 40;
/// Roads are straight for this distance from a junction with crossings, and from a junction without, meters.
const STRAIGHT_M: f64 = 9.0;
const STRAIGHT_FREE_M: f64 = 3.0;
/// Distances from the mouth of a road to both edges of its crossing, and to its stop line, meters.
pub(super) const CROSSING_M: [f64; 2] = [2.5, 5.5];
const STOP_LINE_M: f64 = 6.7;
/// Minimum gap between the sidewalks of roads that do not meet, meters.
const ROOM_M: f64 = 8.0;

impl Network {
    /// Generates the street network of a seed.
    pub fn new(seed: u64) -> Self {
        for attempt in 0..TRIES {
            let mut random = Random::new(seed, "streets", attempt);
            let bend = 1.0 - (attempt / 4) as f64 / (TRIES / 4) as f64;
            if let Some(network) = fitting(&mut random, bend) {
                return network;
            }
        }
        build(&mut Random::new(seed, "streets", TRIES), 0.0)
    }
}

fn fitting(random: &mut Random, bend: f64) -> Option<Network> {
    let network = build(random, bend);
    fits(&network).then_some(network)
}

fn build(random: &mut Random, bend: f64) -> Network {
    let graph = graph::draw(random, bend);
    let sidewalk_m = random.between(2.5, 4.0);
    let mut network = Network::default();
    let mut distances_m = vec![[0.0; 2]; graph.links.len()];
    for node in 0..graph.nodes.len() {
        let junction = junction(random, &graph, node, sidewalk_m, &mut distances_m);
        network.junctions.push(junction);
    }
    for (link, distances_m) in graph.links.iter().zip(distances_m) {
        network.roads.push(road(&network, &graph.nodes, link, distances_m, sidewalk_m));
    }
    lanes::add_lanes(&mut network);
    for junction in 0..network.junctions.len() {
        if network.junctions[junction].kind != JunctionKind::Free {
            add_crossings(&mut network, junction);
        }
    }
    network
}

fn junction(
    random: &mut Random,
    graph: &Graph,
    node: usize,
    sidewalk_m: f64,
    distances_m: &mut [[f64; 2]],
) -> Junction {
    let mut mouths = Vec::new();
    for (road, link) in graph.links.iter().enumerate() {
        if let Some(end) = link.nodes.iter().position(|n| *n == node) {
            let (direction, half_width_m) = (link.directions[end], link.section.half_width_m());
            mouths.push(Mouth { road, direction, half_width_m });
        }
    }
    corner::sort(&mut mouths);
    let tight = mouths.len() == 2;
    let radius_m = random.between(sidewalk_m + 2.0, if tight { 7.0 } else { 8.0 });
    let own_m = corner::distances_m(&mouths, radius_m);
    for (mouth, distance_m) in mouths.iter().zip(&own_m) {
        let end = usize::from(graph.links[mouth.road].nodes[1] == node);
        distances_m[mouth.road][end] = *distance_m;
    }
    let (outline, edges) = corner::outline(graph.nodes[node], &mouths, &own_m, radius_m);
    let centre = if tight { corner::middle_of_bend(&outline, &edges) } else { graph.nodes[node] };
    let avenue = mouths.iter().any(|m| graph.links[m.road].section.lanes_each_way > 1);
    let kind = match mouths.len() {
        0..=2 => JunctionKind::Free,
        _ if avenue || random.chance(0.3) => JunctionKind::Signals,
        _ => JunctionKind::Stop,
    };
    Junction { centre, outline, edges, kind, sidewalk_m }
}

fn road(network: &Network, nodes: &[DVec2], link: &Link, distances_m: [f64; 2], sidewalk_m: f64) -> Road {
    let ends = [0, 1].map(|end| {
        let free = network.junctions[link.nodes[end]].kind == JunctionKind::Free;
        let straight_m = if free { STRAIGHT_FREE_M } else { STRAIGHT_M };
        let mouth = nodes[link.nodes[end]] + link.directions[end] * distances_m[end];
        let steps = straight_m as usize;
        (0..=steps).map(|i| mouth + link.directions[end] * i as f64).collect::<Vec<DVec2>>()
    });
    let (from, to) = (ends[0][ends[0].len() - 1], ends[1][ends[1].len() - 1]);
    let handle = from.distance(to) * 0.39;
    let curve = [from, from + link.directions[0] * handle, to + link.directions[1] * handle, to];
    let middle = polyline(&bezier(curve, 96)).resampled(1.0);
    let mut centerline = ends[0].clone();
    centerline.extend(&middle[1..middle.len() - 1]);
    centerline.extend(ends[1].iter().rev());
    Road {
        centerline,
        half_width_m: link.section.half_width_m(),
        lanes_each_way: link.section.lanes_each_way,
        lane_width_m: link.section.lane_width_m,
        parking_m: link.section.parking_m,
        sidewalk_m,
        junctions: link.nodes,
    }
}

/// Adds crossings and stop lines to the roads at a junction.
fn add_crossings(network: &mut Network, junction: usize) {
    for road in network.junctions[junction].roads() {
        let Some([mouth, along]) = network.roads[road].mouth(junction) else { continue };
        let (half, sidewalk_m) = (network.roads[road].half_width_m, network.roads[road].sidewalk_m);
        let at = |along_m: f64, left_m: f64| mouth + along * along_m + along.perp() * left_m;
        let [near, far] = CROSSING_M;
        let side = half + sidewalk_m / 2.0;
        let middle = (near + far) / 2.0;
        network.crossings.push(Crossing {
            outline: [at(near, -half), at(far, -half), at(far, half), at(near, half)],
            path: [at(middle, -side), at(middle, side)],
            road,
        });
        let [forward, back] = network.lanes_of(road);
        let incoming = if network.roads[road].junctions[1] == junction { forward } else { back };
        for lane in incoming {
            let Some(end) = network.lanes[lane].centerline.last() else { continue };
            let (middle, half) =
                (*end + along * STOP_LINE_M, along.perp() * network.lanes[lane].width_m / 2.0);
            network.stop_lines.push(([middle - half, middle + half], lane));
        }
    }
}

/// Returns whether no roads or junctions overlap, all curves are wide enough and all outlines are
/// star-shaped.
fn fits(network: &Network) -> bool {
    network.roads.iter().all(road_fits)
        && network.junctions.iter().all(junction_fits)
        && (0..network.roads.len()).all(|road| roads_keep_clear(network, road))
        && network.lanes.iter().all(|lane| curvature(&lane.centerline).iter().all(|k| k.abs() < 1.0 / 4.5))
}

fn road_fits(road: &Road) -> bool {
    let least_radius_m = road.half_width_m + road.sidewalk_m + 8.0;
    polyline(&road.centerline).length_m() > 40.0
        && curvature(&road.centerline).iter().all(|k| k.abs() < 1.0 / least_radius_m)
}

fn junction_fits(junction: &Junction) -> bool {
    let n = junction.outline.len();
    let around = (0..n).all(|i| {
        let [a, b] = [i, (i + 1) % n].map(|i| junction.outline[i] - junction.centre);
        a.perp_dot(b) > 0.0
    });
    around && junction.edges.iter().any(|e| *e != JunctionEdge::Kerb)
}

/// Returns whether a road has enough clearance to later roads, and to junctions that it does not lead to.
fn roads_keep_clear(network: &Network, index: usize) -> bool {
    let road = &network.roads[index];
    let path = polyline(&road.centerline);
    let wide = |road: &Road| road.half_width_m + road.sidewalk_m;
    let roads = network.roads.iter().skip(index + 1).all(|other| {
        let meet = other.junctions.iter().any(|j| road.junctions.contains(j));
        let least =
            if meet { road.half_width_m + other.half_width_m } else { wide(road) + wide(other) + ROOM_M };
        other.centerline.iter().step_by(2).all(|p| path.nearest(*p).1 > least)
    });
    let junctions = network.junctions.iter().enumerate().all(|(j, junction)| {
        let least = wide(road) + junction.sidewalk_m + ROOM_M;
        road.junctions.contains(&j) || junction.outline.iter().all(|p| path.nearest(*p).1 > least)
    });
    roads && junctions
}
