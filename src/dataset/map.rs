use std::collections::BTreeMap;

use glam::DVec2;

/// HD map of a location in 2D: global x and y, meters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VectorMap {
    /// Map location, as in [`Recording::location`](super::Recording::location).
    pub location: String,
    /// Lanes outside of intersections, in file order.
    pub lanes: Vec<Lane>,
    /// Lane connectors through intersections, in file order.
    pub lane_connectors: Vec<Lane>,
    /// Drivable areas.
    pub drivable_area: Vec<Area>,
    /// Pedestrian crossings.
    pub crossings: Vec<Area>,
    /// Stop areas of vehicles: a thin area before each stop line.
    pub stop_lines: Vec<Area>,
    /// Walkways; empty if the reader does not know them.
    pub walkways: Vec<Area>,
    /// Dividers: painted or built lines between lanes and roads.
    pub dividers: Vec<Vec<DVec2>>,
    /// Roads and groups of lanes; `None` if the reader does not know them.
    pub network: Option<RoadNetwork>,
    /// Number of items that the reader skipped or missed, by kind.
    pub notes: BTreeMap<String, usize>,
}

/// Kinds of drivable areas and groups of lanes, as nuPlan's maps tell them apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoadNetwork {
    /// Areas of roads outside of intersections.
    pub roads: Vec<Area>,
    /// Areas of intersections.
    pub intersections: Vec<Area>,
    /// Areas of car parks.
    pub car_parks: Vec<Area>,
    /// Ids of the roadblock (group of parallel lanes) or roadblock connector of lanes and lane connectors, by
    /// the ids of these.
    pub roadblocks: BTreeMap<String, String>,
    /// Speed limits of lanes and lane connectors by their ids, meters per second.
    pub speed_limits_mps: BTreeMap<String, f64>,
}

/// Lane, or connector between two lanes.
#[derive(Clone, Debug, PartialEq)]
pub struct Lane {
    /// Id in the dataset.
    pub id: String,
    /// Lane area.
    pub outline: Area,
    /// Centerline in driving direction; empty if the map has none.
    pub centerline: Vec<DVec2>,
    /// Ids of the following lanes and connectors; some may lie beyond the edge of the map.
    pub successors: Vec<String>,
}

/// Polygon with holes. Rings have at least three corners; the first corner is not repeated at the end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Area {
    /// Outer ring.
    pub exterior: Vec<DVec2>,
    /// Rings of the holes.
    pub holes: Vec<Vec<DVec2>>,
}
