use glam::DVec2;

use super::line::{area_between, offset_line};

/// Street network.
#[derive(Clone, Debug, Default)]
pub struct Network {
    /// Roads between junctions.
    pub roads: Vec<Road>,
    /// Junctions, where roads meet or end.
    pub junctions: Vec<Junction>,
    /// Lanes of roads, and paths through junctions.
    pub lanes: Vec<TownLane>,
    /// Zebra crossings.
    pub crossings: Vec<Crossing>,
    /// Both ends of each stop line, and the index of its lane.
    pub stop_lines: Vec<([DVec2; 2], usize)>,
}

/// Road between two junctions. Its cross section from the middle to either side: lanes, parking, kerb,
/// sidewalk.
#[derive(Clone, Debug)]
pub struct Road {
    /// Middle of the road, a point about every meter; it ends where the junctions' areas begin.
    pub centerline: Vec<DVec2>,
    /// Distance from the middle to the kerb, meters: lanes and parking.
    pub half_width_m: f64,
    /// Lanes in each direction.
    pub lanes_each_way: usize,
    /// Width of a lane, meters.
    pub lane_width_m: f64,
    /// Width of the parking strip on the left and on the right, meters; 0 if absent.
    pub parking_m: [f64; 2],
    /// Width of the sidewalks, meters.
    pub sidewalk_m: f64,
    /// Indices of the junctions at its start and its end.
    pub junctions: [usize; 2],
}

/// Area where roads meet or end.
#[derive(Clone, Debug)]
pub struct Junction {
    /// Middle of the junction.
    pub centre: DVec2,
    /// Outline, counter-clockwise; edge `i` runs from corner `i` to the next. Star-shaped about the middle.
    pub outline: Vec<DVec2>,
    /// Kind of each outline edge.
    pub edges: Vec<JunctionEdge>,
    /// Right-of-way rule.
    pub kind: JunctionKind,
    /// Width of the sidewalk along its kerbs, meters.
    pub sidewalk_m: f64,
}

/// Kind of a junction's edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JunctionEdge {
    /// Kerb with a sidewalk behind it.
    Kerb,
    /// End of a road, by index.
    Road(usize),
}

/// Right-of-way rule of a junction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JunctionKind {
    /// Traffic lights.
    Signals,
    /// All-way stop.
    Stop,
    /// Bend or dead end: no vehicle has to wait.
    Free,
}

/// Lane of a road, or path through a junction.
#[derive(Clone, Debug)]
pub struct TownLane {
    /// Id in the HD map.
    pub id: String,
    /// Road or junction that it belongs to.
    pub kind: LaneKind,
    /// Centerline in driving direction: a point about every meter on roads, about every 0.4 m in junctions.
    pub centerline: Vec<DVec2>,
    /// Width, meters.
    pub width_m: f64,
    /// Indices of the lanes that follow.
    pub successors: Vec<usize>,
}

/// Road or junction that a lane belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaneKind {
    /// A road, by index.
    Road(usize),
    /// A junction, by index.
    Junction(usize),
}

/// A zebra crossing.
#[derive(Clone, Debug)]
pub struct Crossing {
    /// Its four corners, counter-clockwise.
    pub outline: [DVec2; 4],
    /// Walking path from one sidewalk to the other.
    pub path: [DVec2; 2],
    /// Index of the road that it crosses.
    pub road: usize,
}

/// State of a traffic light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Signal {
    Green,
    Yellow,
    Red,
}

/// Side of a road, relative to the direction of its centerline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Side {
    Left = 0,
    Right = 1,
}

impl Side {
    /// Both sides.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// Returns the sign of offsets: 1 to the left, -1 to the right.
    pub fn sign(self) -> f64 {
        if self == Self::Left { 1.0 } else { -1.0 }
    }
}

impl Road {
    /// Returns the line at a distance to the left of the middle, meters (negative: to the right), with a
    /// point for each of `centerline`.
    pub fn offset(&self, left_m: f64) -> Vec<DVec2> {
        offset_line(&self.centerline, left_m)
    }

    /// Returns the kerb on a side, in the direction of the centerline.
    pub fn kerb(&self, side: Side) -> Vec<DVec2> {
        self.offset(side.sign() * self.half_width_m)
    }

    /// Returns the area from kerb to kerb, counter-clockwise.
    pub fn outline(&self) -> Vec<DVec2> {
        area_between(&self.kerb(Side::Right), &self.kerb(Side::Left))
    }

    /// Returns the sidewalk on a side, counter-clockwise.
    pub fn sidewalk(&self, side: Side) -> Vec<DVec2> {
        let far = self.offset(side.sign() * (self.half_width_m + self.sidewalk_m));
        match side {
            Side::Left => area_between(&self.kerb(side), &far),
            Side::Right => area_between(&far, &self.kerb(side)),
        }
    }

    /// Returns the distance from the middle to the outer edge of the lanes, meters.
    pub fn lanes_half_width_m(&self) -> f64 {
        self.lanes_each_way as f64 * self.lane_width_m
    }

    /// Returns the line between the two directions.
    pub fn middle_divider(&self) -> &[DVec2] {
        &self.centerline
    }

    /// Returns the lines between lanes of the same direction, for both directions.
    pub fn lane_dividers(&self) -> Vec<Vec<DVec2>> {
        let offsets = (1..self.lanes_each_way).map(|k| k as f64 * self.lane_width_m);
        offsets.flat_map(|d| [self.offset(d), self.offset(-d)]).collect()
    }

    /// Returns its end at a junction and the unit direction into the road; `None` if it does not end there.
    pub fn mouth(&self, junction: usize) -> Option<[DVec2; 2]> {
        let (first, second, last, before) = match &self.centerline[..] {
            [first, second, .., before, last] => (*first, *second, *last, *before),
            [first, last] => (*first, *last, *last, *first),
            _ => return None,
        };
        if self.junctions[0] == junction {
            Some([first, (second - first).normalize_or(DVec2::X)])
        } else if self.junctions[1] == junction {
            Some([last, (before - last).normalize_or(DVec2::X)])
        } else {
            None
        }
    }
}

impl TownLane {
    /// Returns the line at a distance to the left of its middle, meters, in driving direction.
    pub fn offset(&self, left_m: f64) -> Vec<DVec2> {
        offset_line(&self.centerline, left_m)
    }

    /// Returns its area, counter-clockwise.
    pub fn outline(&self) -> Vec<DVec2> {
        area_between(&self.offset(-self.width_m / 2.0), &self.offset(self.width_m / 2.0))
    }
}

impl Junction {
    /// Returns its kerbs. Each runs counter-clockwise from the mouth of a road to the next mouth, with the
    /// junction on the left and the sidewalk on the right.
    pub fn kerbs(&self) -> Vec<Vec<DVec2>> {
        let n = self.outline.len();
        let Some(start) = self.edges.iter().position(|e| *e != JunctionEdge::Kerb) else { return Vec::new() };
        let mut kerbs: Vec<Vec<DVec2>> = Vec::new();
        for i in (start..start + n).map(|i| i % n) {
            match (self.edges[i], kerbs.last_mut()) {
                (JunctionEdge::Kerb, Some(kerb)) => kerb.push(self.outline[(i + 1) % n]),
                _ => kerbs.push(vec![self.outline[(i + 1) % n]]),
            }
        }
        kerbs.retain(|kerb| kerb.len() > 1);
        kerbs
    }

    /// Returns the roads that lead to it, in the order of `edges`.
    pub fn roads(&self) -> Vec<usize> {
        let road = |edge: &JunctionEdge| match edge {
            JunctionEdge::Road(road) => Some(*road),
            JunctionEdge::Kerb => None,
        };
        self.edges.iter().filter_map(road).collect()
    }
}

impl Network {
    /// Returns the indices of a road's lanes, in the direction of its centerline and against it, each from
    /// the middle outward.
    pub fn lanes_of(&self, road: usize) -> [Vec<usize>; 2] {
        let lanes = (0..self.lanes.len()).filter(|i| self.lanes[*i].kind == LaneKind::Road(road));
        let mut forward: Vec<usize> = lanes.collect();
        let back = forward.split_off(forward.len() / 2);
        [forward, back]
    }
}
