//! Lanes of roads, and the paths that lead from them through junctions.

use glam::DVec2;

use super::line::{bezier, offset_line, polyline};
use super::{LaneKind, Network, TownLane};

/// Paths that turn by less than this count as straight.
const STRAIGHT_RAD: f64 = 0.62;
/// Point spacing of a path through a junction, meters; fine because its curves are tight.
const STEP_M: f64 = 0.4;

/// Turn of a path through a junction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum Turn {
    Left,
    Straight,
    Right,
}

impl Turn {
    /// Returns the turn between the directions at the start and the end of a line.
    pub fn of(line: &[DVec2]) -> Self {
        let path = polyline(line);
        Self::between(path.at(0.0).1, path.at(path.length_m()).1)
    }

    fn between(from: DVec2, to: DVec2) -> Self {
        match from.angle_to(to) {
            angle if angle > STRAIGHT_RAD => Self::Left,
            angle if angle < -STRAIGHT_RAD => Self::Right,
            _ => Self::Straight,
        }
    }
}

/// Adds the lanes of all roads, then the paths through all junctions.
pub(super) fn add_lanes(network: &mut Network) {
    for (index, road) in network.roads.iter().enumerate() {
        for (forward, sign) in [('f', -1.0), ('b', 1.0)] {
            for lane in 0..road.lanes_each_way {
                let middle = (lane as f64 + 0.5) * road.lane_width_m;
                let mut centerline = offset_line(&road.centerline, sign * middle);
                if forward == 'b' {
                    centerline.reverse();
                }
                network.lanes.push(TownLane {
                    id: format!("lane-{index:02}{forward}{lane}"),
                    kind: LaneKind::Road(index),
                    centerline,
                    width_m: road.lane_width_m,
                    successors: Vec::new(),
                });
            }
        }
    }
    for junction in 0..network.junctions.len() {
        for from in network.junctions[junction].roads() {
            add_connectors(network, junction, from);
        }
    }
}

/// Returns the lanes of a road that end at a junction and those that start there, each from the middle
/// outward.
fn lanes_at(network: &Network, junction: usize, road: usize) -> [Vec<usize>; 2] {
    let [forward, back] = network.lanes_of(road);
    if network.roads[road].junctions[1] == junction { [forward, back] } else { [back, forward] }
}

/// Adds the paths from one road through a junction: from the outermost lane to the right, from the innermost
/// to the left, from all lanes straight ahead. A lane without any of these gets paths to the available roads.
fn add_connectors(network: &mut Network, junction: usize, from: usize) {
    let [incoming, _] = lanes_at(network, junction, from);
    let mut targets: Vec<(Turn, Vec<usize>)> = Vec::new();
    for road in network.junctions[junction].roads() {
        let (Some([_, out]), Some([_, back])) =
            (network.roads[road].mouth(junction), network.roads[from].mouth(junction))
        else {
            continue;
        };
        if road != from {
            targets.push((Turn::between(-back, out), lanes_at(network, junction, road)[1].clone()));
        }
    }
    targets.sort();
    let last = incoming.len().saturating_sub(1);
    let only = targets.len() == 1;
    for (k, lane) in incoming.iter().enumerate() {
        let allowed = |turn: Turn| match turn {
            Turn::Left => k == 0 || only,
            Turn::Straight => true,
            Turn::Right => k == last || only,
        };
        let mut ways: Vec<&(Turn, Vec<usize>)> = targets.iter().filter(|t| allowed(t.0)).collect();
        // If the road straight ahead has fewer lanes, only the outermost lane goes straight.
        ways.retain(|(turn, lanes)| {
            only || *turn != Turn::Straight || lanes.len() >= incoming.len() || k == last
        });
        if ways.is_empty() {
            ways = targets.iter().filter(|t| t.0 == Turn::Straight).collect();
        }
        if ways.is_empty() {
            ways = targets.iter().collect();
        }
        for (turn, lanes) in ways {
            let outer = lanes.len() - 1;
            let to = match turn {
                _ if only => k.min(outer),
                Turn::Left => 0,
                Turn::Right => outer,
                Turn::Straight if incoming.len() > lanes.len() => outer,
                Turn::Straight => outer - (last - k),
            };
            add_connector(network, junction, *lane, lanes[to]);
        }
    }
}

fn add_connector(network: &mut Network, junction: usize, from: usize, to: usize) {
    let (a, b) = (&network.lanes[from], &network.lanes[to]);
    let (before, after) = (polyline(&a.centerline), polyline(&b.centerline));
    let centerline = connector(before.at(before.length_m()).into(), after.at(0.0).into());
    let connector = TownLane {
        id: format!("way-{junction:02}-{}-{}", &a.id["lane-".len()..], &b.id["lane-".len()..]),
        kind: LaneKind::Junction(junction),
        centerline,
        width_m: a.width_m.min(b.width_m),
        successors: vec![to],
    };
    let index = network.lanes.len();
    network.lanes.push(connector);
    network.lanes[from].successors.push(index);
}

/// Returns a smooth line from one point and direction to another: straight where there is room, then a curve.
fn connector([from, ahead]: [DVec2; 2], [to, on]: [DVec2; 2]) -> Vec<DVec2> {
    let turn = ahead.angle_to(on);
    let denominator = ahead.perp_dot(on);
    let (a, b) = ((to - from).perp_dot(on) / denominator, (to - from).perp_dot(ahead) / denominator);
    if turn.abs() < 0.3 || a < 3.0 || b < 3.0 {
        let handle = from.distance(to) * 0.4;
        let curve = [from, from + ahead * handle, to - on * handle, to];
        return polyline(&bezier(curve, 64)).resampled(STEP_M);
    }
    let corner = from + ahead * a;
    let tangent = a.min(b) - 0.5;
    let [start, end] = [corner - ahead * tangent, corner + on * tangent];
    // This handle length approximates an arc of a circle; the 10 % extra makes the ends of the curve gentler.
    let handle = tangent * 1.1 * 4.0 / 3.0 * (turn / 4.0).tan() / (turn / 2.0).tan();
    let curve = bezier([start, start + ahead * handle, end - on * handle, end], 64);
    let line: Vec<DVec2> = [from].into_iter().chain(curve).chain([to]).collect();
    polyline(&line).resampled(STEP_M)
}
