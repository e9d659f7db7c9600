use glam::DVec2;

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

impl Network {
    /// One straight road.
    pub fn new(_seed: u64) -> Self {
        let centerline: Vec<DVec2> = (-100..=300).map(|x| DVec2::new(f64::from(x), 0.0)).collect();
        let lane = |side: f64| {
            let mut line: Vec<DVec2> = centerline.iter().map(|p| *p + DVec2::new(0.0, side * 1.75)).collect();
            if side > 0.0 {
                line.reverse();
            }
            let id = format!("lane-{}", if side > 0.0 { "left" } else { "right" });
            TownLane { id, kind: LaneKind::Road(0), centerline: line, width_m: 3.5, successors: Vec::new() }
        };
        let lanes = vec![lane(-1.0), lane(1.0)];
        let road = Road {
            centerline,
            half_width_m: 5.7,
            lanes_each_way: 1,
            lane_width_m: 3.5,
            parking_m: [2.2, 2.2],
            sidewalk_m: 3.0,
            junctions: [0, 0],
        };
        Self { roads: vec![road], lanes, ..Self::default() }
    }
}
