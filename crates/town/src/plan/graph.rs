//! Street graph of junctions and streets: a grid that is bent, thinned and cut.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec2;

use super::random::Random;

/// Topology of the streets, before their courses are computed.
#[derive(Clone, Debug, Default)]
pub(super) struct Graph {
    /// Positions where streets meet or end, meters.
    pub(super) nodes: Vec<DVec2>,
    /// Streets.
    pub(super) links: Vec<Link>,
}

/// Street between two nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// Indices of its nodes.
    pub(super) nodes: [usize; 2],
    /// Unit directions at which it leaves its nodes.
    pub(super) directions: [DVec2; 2],
    /// Its cross section.
    pub(super) section: Section,
}

/// Cross section of a street.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Section {
    /// Lanes in each direction.
    pub(super) lanes_each_way: usize,
    /// Width of a lane, meters.
    pub(super) lane_width_m: f64,
    /// Width of the parking strips on the left and on the right, meters.
    pub(super) parking_m: [f64; 2],
}

/// Width of a parking strip, meters.
const PARKING_M: f64 = 2.3;
/// Width between the outermost lane and a kerb without parking, meters.
const GUTTER_M: f64 = 0.3;
/// Maximum turn of a street across a block towards its other end where it leaves a node, radians.
const ACROSS_RAD: f64 = 0.36;
/// Sides on which a street may leave a node, counter-clockwise from the grid's east.
const EAST: usize = 0;
const NORTH: usize = 1;
const WEST: usize = 2;
const SOUTH: usize = 3;

impl Section {
    /// Returns the distance from the middle to the kerb, meters.
    pub(super) fn half_width_m(&self) -> f64 {
        let parking = self.parking_m[0].max(self.parking_m[1]);
        self.lanes_each_way as f64 * self.lane_width_m + parking.max(GUTTER_M)
    }
}

/// Grid that the generation starts from.
struct Grid {
    columns: usize,
    rows: usize,
    turn_rad: f64,
    nodes: Vec<DVec2>,
    links: Vec<Joined>,
    outs: Vec<(usize, usize, f64, Section)>,
}

/// Street of the grid: node and side at both ends.
type Joined = ([(usize, usize); 2], Section, Course);

/// Course of a street between its nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Course {
    Straight,
    /// Around a removed corner of the grid.
    Around,
    /// From one side of a block to the opposite one.
    Across,
}

/// Generates a graph. `bend` in 0..=1 is the deviation from a plain grid; 0 always gives streets that fit.
pub(super) fn draw(random: &mut Random, bend: f64) -> Graph {
    let mut grid = Grid::new(random, bend);
    let streets = Streets::new(random, &grid);
    grid.join(random, &streets);
    if bend > 0.0 {
        grid.cut_corners(random);
        grid.swing(random);
        grid.thin(random);
    }
    grid.lead_out(random, &streets);
    grid.narrow_bends();
    grid.graph()
}

/// Cross sections of the streets: which rows and columns are avenues.
struct Streets {
    rows: Vec<bool>,
    columns: Vec<bool>,
    avenue: Section,
    lane_width_m: f64,
}

impl Streets {
    fn new(random: &mut Random, grid: &Grid) -> Self {
        let mut rows = vec![false; grid.rows];
        let mut columns = vec![false; grid.columns];
        let both = random.chance(0.4);
        if both || random.chance(0.5) {
            rows[1 + random.index(grid.rows - 2)] = true;
        }
        if both || !rows.contains(&true) {
            columns[1 + random.index(grid.columns - 2)] = true;
        }
        let parking = if random.chance(0.45) { PARKING_M } else { 0.0 };
        let avenue = Section { lanes_each_way: 2, lane_width_m: 3.5, parking_m: [parking; 2] };
        Self { rows, columns, avenue, lane_width_m: random.between(3.3, 3.6) }
    }

    fn small(&self, random: &mut Random) -> Section {
        let sides = [([1.0, 1.0], 0.45), ([1.0, 0.0], 0.15), ([0.0, 1.0], 0.15), ([0.0, 0.0], 0.25)];
        let parking = random.weighted(&sides).unwrap_or([0.0; 2]).map(|side: f64| side * PARKING_M);
        Section { lanes_each_way: 1, lane_width_m: self.lane_width_m, parking_m: parking }
    }
}

impl Grid {
    fn new(random: &mut Random, bend: f64) -> Self {
        let (columns, rows) = (4 + random.index(2), 4 + random.index(2));
        let mut places = |count: usize| {
            let mut at = 0.0;
            let mut places = vec![0.0];
            for _ in 1..count {
                at += 108.0 + bend * random.between(-18.0, 18.0);
                places.push(at);
            }
            places.iter().map(|p| p - at / 2.0).collect::<Vec<f64>>()
        };
        let (xs, ys) = (places(columns), places(rows));
        let turn_rad = random.between(-PI, PI);
        let bow = [random.between(-14.0, 14.0), random.between(-14.0, 14.0)].map(|b| b * bend);
        let phase = [random.between(0.0, TAU), random.between(0.0, TAU)];
        let mut nodes = Vec::with_capacity(columns * rows);
        for y in &ys {
            for x in &xs {
                let shake = DVec2::new(random.between(-7.0, 7.0), random.between(-7.0, 7.0)) * bend;
                let bowed = DVec2::new(
                    x + bow[0] * (y / 130.0 + phase[0]).sin(),
                    y + bow[1] * (x / 130.0 + phase[1]).sin(),
                );
                nodes.push(DVec2::from_angle(turn_rad).rotate(bowed + shake));
            }
        }
        Self { columns, rows, turn_rad, nodes, links: Vec::new(), outs: Vec::new() }
    }

    fn node(&self, column: usize, row: usize) -> usize {
        row * self.columns + column
    }

    fn join(&mut self, random: &mut Random, streets: &Streets) {
        for row in 0..self.rows {
            for column in 0..self.columns {
                let here = self.node(column, row);
                if column + 1 < self.columns {
                    let section = if streets.rows[row] { streets.avenue } else { streets.small(random) };
                    let next = self.node(column + 1, row);
                    self.links.push(([(here, EAST), (next, WEST)], section, Course::Straight));
                }
                if row + 1 < self.rows {
                    let avenue = streets.columns[column];
                    let section = if avenue { streets.avenue } else { streets.small(random) };
                    let next = self.node(column, row + 1);
                    self.links.push(([(here, NORTH), (next, SOUTH)], section, Course::Straight));
                }
            }
        }
    }

    fn link_at(&self, node: usize, side: usize) -> Option<usize> {
        self.links.iter().position(|(ends, ..)| ends.contains(&(node, side)))
    }

    fn degree(&self, node: usize) -> usize {
        self.links.iter().filter(|(ends, ..)| ends.iter().any(|e| e.0 == node)).count()
    }

    /// Removes some corners of the grid and replaces each with a long bend.
    fn cut_corners(&mut self, random: &mut Random) {
        let (right, top) = (self.columns - 1, self.rows - 1);
        for (column, row, sides) in [
            (0, 0, [EAST, NORTH]),
            (right, 0, [WEST, NORTH]),
            (0, top, [EAST, SOUTH]),
            (right, top, [WEST, SOUTH]),
        ] {
            let corner = self.node(column, row);
            let links = sides.map(|side| self.link_at(corner, side));
            let ([Some(a), Some(b)], true) = (links, random.chance(0.5)) else { continue };
            let far = |link: usize| self.links[link].0.into_iter().find(|end| end.0 != corner);
            let (Some(from), Some(to)) = (far(a), far(b)) else { continue };
            let section = self.links[a].1;
            self.links.retain(|(ends, ..)| ends.iter().all(|e| e.0 != corner));
            self.links.push(([from, to], section, Course::Around));
        }
    }

    /// Replaces two opposite sides of a block with one street that swings from one to the other.
    fn swing(&mut self, random: &mut Random) {
        for _ in 0..2 {
            let (column, row) = (random.index(self.columns - 1), random.index(self.rows - 1));
            let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| self.node(column + x, row + y));
            let (first, second, from, to) = if random.chance(0.5) {
                (self.link_at(a, EAST), self.link_at(d, EAST), (a, EAST), (c, WEST))
            } else {
                (self.link_at(a, NORTH), self.link_at(b, NORTH), (a, NORTH), (c, SOUTH))
            };
            let (Some(first), Some(second)) = (first, second) else { continue };
            let plain = |link: usize| {
                self.links[link].2 == Course::Straight && self.links[link].1.lanes_each_way == 1
            };
            if !plain(first) || !plain(second) || [a, b, c, d].iter().any(|n| self.degree(*n) < 3) {
                continue;
            }
            let section = self.links[first].1;
            let retained = |i: usize| i != first && i != second;
            self.links = (0..self.links.len()).filter(|i| retained(*i)).map(|i| self.links[i]).collect();
            self.links.push(([from, to], section, Course::Across));
            return;
        }
    }

    /// Removes some streets, so that blocks merge.
    fn thin(&mut self, random: &mut Random) {
        let mut order: Vec<_> = self.links.iter().map(|link| link.0).collect();
        random.shuffle(&mut order);
        let mut left = self.links.len() / 7;
        for ends in order {
            let Some(i) = self.links.iter().position(|link| link.0 == ends) else { continue };
            let plain = self.links[i].1.lanes_each_way == 1 && self.links[i].2 == Course::Straight;
            let bends = ends.iter().filter(|e| self.would_bend(**e)).count();
            let rare = bends > 0 && !random.chance(0.2);
            if left == 0 || !plain || rare || ends.iter().any(|e| self.degree(e.0) < 3) {
                continue;
            }
            let link = self.links.remove(i);
            if self.connected() {
                left -= 1;
            } else {
                self.links.insert(i, link);
            }
        }
    }

    /// Returns whether a node would become a mere bend without its street on a side.
    fn would_bend(&self, (node, side): (usize, usize)) -> bool {
        let others: Vec<usize> = (0..4).filter(|s| *s != side && self.link_at(node, *s).is_some()).collect();
        others.len() == 2 && (others[0] + 2) % 4 != others[1]
    }

    fn connected(&self) -> bool {
        let Some(start) = self.links.first().map(|link| link.0[0].0) else { return false };
        let mut seen = vec![false; self.nodes.len()];
        let mut open = vec![start];
        seen[start] = true;
        while let Some(node) = open.pop() {
            for (ends, ..) in &self.links {
                let [a, b] = ends.map(|e| e.0);
                for (from, to) in [(a, b), (b, a)] {
                    if from == node && !seen[to] {
                        seen[to] = true;
                        open.push(to);
                    }
                }
            }
        }
        (0..self.nodes.len()).all(|node| seen[node] || self.degree(node) == 0)
    }

    /// Adds streets that leave the town at its edge: all avenues, some others.
    fn lead_out(&mut self, random: &mut Random, streets: &Streets) {
        for row in 1..self.rows - 1 {
            for (node, side) in [(self.node(0, row), WEST), (self.node(self.columns - 1, row), EAST)] {
                self.add_out(random, streets, node, side, streets.rows[row]);
            }
        }
        for column in 1..self.columns - 1 {
            for (node, side) in [(self.node(column, 0), SOUTH), (self.node(column, self.rows - 1), NORTH)] {
                self.add_out(random, streets, node, side, streets.columns[column]);
            }
        }
    }

    fn add_out(&mut self, random: &mut Random, streets: &Streets, node: usize, side: usize, avenue: bool) {
        if avenue || random.chance(0.3) {
            let section = if avenue { streets.avenue } else { streets.small(random) };
            self.outs.push((node, side, random.between(62.0, 85.0), section));
        }
    }

    /// Gives both streets the same cross section where only two meet.
    fn narrow_bends(&mut self) {
        for _ in 0..self.nodes.len() {
            for node in 0..self.nodes.len() {
                let out = self.outs.iter().any(|(n, ..)| *n == node);
                let met: Vec<usize> =
                    (0..self.links.len()).filter(|i| self.links[*i].0.iter().any(|e| e.0 == node)).collect();
                if let ([a, b], false) = (&met[..], out) {
                    self.links[*b].1 = self.links[*a].1;
                }
            }
        }
    }

    fn side_direction(&self, side: usize) -> DVec2 {
        DVec2::from_angle(self.turn_rad + side as f64 * FRAC_PI_2)
    }

    /// Returns the point that a street on a side of a node heads for; `None` without a street there.
    fn target(&self, node: usize, side: usize) -> Option<DVec2> {
        let aside = self.nodes[node] + self.side_direction(side) * 100.0;
        if let Some(link) = self.link_at(node, side) {
            let (ends, _, course) = self.links[link];
            let other = if ends[0] == (node, side) { ends[1].0 } else { ends[0].0 };
            return Some(if course == Course::Straight { self.nodes[other] } else { aside });
        }
        self.outs.iter().any(|(n, s, ..)| (*n, *s) == (node, side)).then_some(aside)
    }

    /// Returns the direction of a street where it leaves a node. Streets on opposite sides leave in opposite
    /// directions, except one that crosses a block.
    fn direction(&self, node: usize, side: usize) -> DVec2 {
        let here = self.nodes[node];
        let Some(target) = self.target(node, side) else { return self.side_direction(side) };
        if let Some((ends, ..)) = self.across(node, side) {
            let other = if ends[0].0 == node { ends[1].0 } else { ends[0].0 };
            let turn = self.side_direction(side).angle_to(self.nodes[other] - here);
            return DVec2::from_angle(turn.clamp(-ACROSS_RAD, ACROSS_RAD)).rotate(self.side_direction(side));
        }
        let opposite = (side + 2) % 4;
        let back = self.target(node, opposite).filter(|_| self.across(node, opposite).is_none());
        (target - back.unwrap_or(here)).normalize_or(self.side_direction(side))
    }

    fn across(&self, node: usize, side: usize) -> Option<Joined> {
        self.link_at(node, side).map(|link| self.links[link]).filter(|link| link.2 == Course::Across)
    }

    fn graph(&self) -> Graph {
        let mut graph = Graph::default();
        let mut index = vec![None; self.nodes.len()];
        let mut place = |graph: &mut Graph, node: usize| {
            *index[node].get_or_insert_with(|| {
                graph.nodes.push(self.nodes[node]);
                graph.nodes.len() - 1
            })
        };
        for (ends, section, _) in &self.links {
            let nodes = ends.map(|(node, _)| place(&mut graph, node));
            let directions = ends.map(|(node, side)| self.direction(node, side));
            graph.links.push(Link { nodes, directions, section: *section });
        }
        for (node, side, length_m, section) in &self.outs {
            let direction = self.direction(*node, *side);
            let from = place(&mut graph, *node);
            graph.nodes.push(self.nodes[*node] + direction * *length_m);
            let (nodes, directions) = ([from, graph.nodes.len() - 1], [direction, -direction]);
            graph.links.push(Link { nodes, directions, section: *section });
        }
        graph
    }
}
