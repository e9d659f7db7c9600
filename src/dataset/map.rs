use std::collections::BTreeMap;

use glam::DVec2;

/// The HD map of a place, seen from above: global x and y, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VectorMap {
    /// Map location, as in [`Log::location`](super::Log::location).
    pub location: String,
    /// Lanes outside of intersections, in the file's order.
    pub lanes: Vec<Lane>,
    /// Ways through intersections, in the file's order.
    pub lane_connectors: Vec<Lane>,
    /// Where vehicles may drive.
    pub drivable_area: Vec<Area>,
    /// Where pedestrians cross.
    pub crossings: Vec<Area>,
    /// Where vehicles stop: a thin area before the line.
    pub stop_lines: Vec<Area>,
    /// Painted or built lines between lanes and roads.
    pub dividers: Vec<Vec<DVec2>>,
    /// What the reader left out, by kind, with counts.
    pub notes: BTreeMap<String, usize>,
}

/// A lane or the way from one to another.
#[derive(Clone, Debug, PartialEq)]
pub struct Lane {
    /// The data set's id.
    pub id: String,
    /// Its area.
    pub outline: Area,
    /// Its middle in driving direction; empty if the map has none.
    pub centerline: Vec<DVec2>,
    /// Ids of the lanes and connectors that follow; some may lie beyond the edge of the map.
    pub successors: Vec<String>,
}

/// An area with holes. Rings have at least three corners and are not closed: the last corner is not the first again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Area {
    /// Outline.
    pub exterior: Vec<DVec2>,
    /// Outlines of what is left out.
    pub holes: Vec<Vec<DVec2>>,
}
