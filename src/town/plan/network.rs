use glam::DVec2;

use super::line::{area_between, offset_line};

/// The streets.
#[derive(Clone, Debug, Default)]
pub struct Network {
    /// Between junctions.
    pub roads: Vec<Road>,
    /// Where roads meet, or end.
    pub junctions: Vec<Junction>,
    /// Lanes of roads, and ways through junctions.
    pub lanes: Vec<TownLane>,
    /// Zebra crossings.
    pub crossings: Vec<Crossing>,
    /// Both ends of each stop line, and the lane it is on.
    pub stop_lines: Vec<([DVec2; 2], usize)>,
}

/// A road between two junctions. Its cross section, from the middle to either side: lanes, parking, kerb, sidewalk.
#[derive(Clone, Debug)]
pub struct Road {
    /// The middle, a point about every metre; it ends where the junctions' areas begin.
    pub centerline: Vec<DVec2>,
    /// From the middle to the kerb, metres: lanes and parking.
    pub half_width_m: f64,
    /// Lanes in each direction.
    pub lanes_each_way: usize,
    /// Width of a lane, metres.
    pub lane_width_m: f64,
    /// Width of the parking strip on the left and on the right, metres; 0 without.
    pub parking_m: [f64; 2],
    /// Width of the sidewalks, metres.
    pub sidewalk_m: f64,
    /// Indices of the junctions at its start and its end.
    pub junctions: [usize; 2],
}

/// An area that roads lead to.
#[derive(Clone, Debug)]
pub struct Junction {
    /// Its middle.
    pub centre: DVec2,
    /// Its outline, counter-clockwise; edge `i` runs from corner `i` to the next. Star-shaped about the middle.
    pub outline: Vec<DVec2>,
    /// What each edge of the outline is.
    pub edges: Vec<JunctionEdge>,
    /// Who goes first.
    pub kind: JunctionKind,
    /// Width of the sidewalk along its kerbs, metres.
    pub sidewalk_m: f64,
}

/// What is beyond an edge of a junction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JunctionEdge {
    /// A kerb and a sidewalk.
    Kerb,
    /// The end of a road, by index.
    Road(usize),
}

/// Who goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JunctionKind {
    /// Traffic lights.
    Signals,
    /// Everybody stops.
    Stop,
    /// A bend or a dead end: nobody has to wait.
    Free,
}

/// A way that vehicles take.
#[derive(Clone, Debug)]
pub struct TownLane {
    /// For the HD map.
    pub id: String,
    /// Lane or way through a junction.
    pub kind: LaneKind,
    /// In driving direction, a point about every metre.
    pub centerline: Vec<DVec2>,
    /// Metres.
    pub width_m: f64,
    /// Indices of the lanes that follow.
    pub successors: Vec<usize>,
}

/// What a lane belongs to.
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
    /// Where people walk: from one sidewalk to the other.
    pub path: [DVec2; 2],
    /// Index of the road that it crosses.
    pub road: usize,
}

/// What a traffic light shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Signal {
    Green,
    Yellow,
    Red,
}

/// A side of a road, seen along its centerline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Side {
    Left = 0,
    Right = 1,
}

impl Side {
    /// Both.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// 1 to the left, -1 to the right: the sign of offsets.
    pub fn sign(self) -> f64 {
        if self == Self::Left { 1.0 } else { -1.0 }
    }
}

impl Road {
    /// The line that many metres to the left of the middle (negative: to the right), a point for each of `centerline`.
    pub fn offset(&self, left_m: f64) -> Vec<DVec2> {
        offset_line(&self.centerline, left_m)
    }

    /// The kerb on a side, in the direction of the centerline.
    pub fn kerb(&self, side: Side) -> Vec<DVec2> {
        self.offset(side.sign() * self.half_width_m)
    }

    /// From kerb to kerb, counter-clockwise.
    pub fn outline(&self) -> Vec<DVec2> {
        area_between(&self.kerb(Side::Right), &self.kerb(Side::Left))
    }

    /// The sidewalk on a side, counter-clockwise.
    pub fn sidewalk(&self, side: Side) -> Vec<DVec2> {
        let far = self.offset(side.sign() * (self.half_width_m + self.sidewalk_m));
        match side {
            Side::Left => area_between(&self.kerb(side), &far),
            Side::Right => area_between(&far, &self.kerb(side)),
        }
    }

    /// Metres from the middle to where its lanes end.
    pub fn lanes_half_width_m(&self) -> f64 {
        self.lanes_each_way as f64 * self.lane_width_m
    }

    /// The line between the two directions.
    pub fn middle_divider(&self) -> &[DVec2] {
        &self.centerline
    }

    /// The lines between lanes of one direction, for both directions.
    pub fn lane_dividers(&self) -> Vec<Vec<DVec2>> {
        let offsets = (1..self.lanes_each_way).map(|k| k as f64 * self.lane_width_m);
        offsets.flat_map(|d| [self.offset(d), self.offset(-d)]).collect()
    }

    /// Its end at a junction, and the unit direction from there into the road; `None` if it does not end there.
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
    /// A line that many metres to the left of its middle, in driving direction.
    pub fn offset(&self, left_m: f64) -> Vec<DVec2> {
        offset_line(&self.centerline, left_m)
    }

    /// Its area, counter-clockwise.
    pub fn outline(&self) -> Vec<DVec2> {
        area_between(&self.offset(-self.width_m / 2.0), &self.offset(self.width_m / 2.0))
    }
}

impl Junction {
    /// Its kerbs: each runs from the mouth of a road to that of the next, counter-clockwise, so the junction is on the
    /// left and the sidewalk on the right.
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

    /// The roads that lead to it, in the order of `edges`.
    pub fn roads(&self) -> Vec<usize> {
        let road = |edge: &JunctionEdge| match edge {
            JunctionEdge::Road(road) => Some(*road),
            JunctionEdge::Kerb => None,
        };
        self.edges.iter().filter_map(road).collect()
    }
}

impl Network {
    /// The streets that follow from a seed.
    pub fn new(seed: u64) -> Self {
        super::streets::network(seed)
    }

    /// Indices of a road's lanes: in the direction of its centerline and against it, each from the middle outward.
    pub fn lanes_of(&self, road: usize) -> [Vec<usize>; 2] {
        let lanes = (0..self.lanes.len()).filter(|i| self.lanes[*i].kind == LaneKind::Road(road));
        let mut forward: Vec<usize> = lanes.collect();
        let back = forward.split_off(forward.len() / 2);
        [forward, back]
    }
}
