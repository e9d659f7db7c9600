//! Roads of a map, and the route of the ego on them.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec2;
use point_skeleton::dataset::{Area, Lane, VectorMap};
use point_skeleton::geometry::{Polyline, wrap_angle};

use super::path::Path;
use super::shape;
use super::state::PdmState;
use crate::metrics::{Areas, is_sound};
use crate::recorded::Recorded;

/// Maximum distance of the ego from its route, meters; beyond it, the recorded path is the route.
const MAX_ROUTE_DISTANCE_M: f64 = 3.0;
/// Maximum number of roadblocks in a route ahead. Source: NAVSIM.
const MAX_ROADBLOCKS: usize = 30;
/// Length by which the recorded path continues straight, meters.
const EXTENSION_M: f64 = 100.0;
/// Distance between points at which the recorded path is located on lanes, meters.
const LANE_STEP_M: f64 = 1.0;

/// Areas and lanes of a map.
pub(super) struct Roads<'a> {
    pub(super) drivable: Areas,
    pub(super) intersections: Areas,
    pub(super) lane_areas: Areas,
    pub(super) lanes: Vec<&'a Lane>,
    /// Roadblocks of the lanes.
    roadblocks: Vec<Option<&'a str>>,
    /// Speed limits of the lanes, meters per second.
    limits_mps: Vec<Option<f64>>,
}

/// Route of the ego.
pub(super) struct Route {
    pub(super) centerline: Path,
    /// Indices of its lanes.
    pub(super) lanes: BTreeSet<usize>,
    /// Speed limit of the lane at the start, meters per second.
    pub(super) limit_mps: Option<f64>,
}

impl<'a> Roads<'a> {
    /// Returns the roads of a map. Maps without a road network have no kinds of areas: all drivable ones
    /// count, and intersections are where the lane connectors are.
    pub(super) fn new(map: &'a VectorMap) -> Self {
        let lanes = map.lanes.iter().chain(&map.lane_connectors);
        let lanes: Vec<&Lane> = lanes.filter(|lane| is_sound(&lane.outline)).collect();
        let outlines = |lanes: &'a [Lane]| lanes.iter().map(|lane| &lane.outline).collect::<Vec<&Area>>();
        let network = map.network.as_ref();
        let (drivable, intersections) = match network {
            Some(network) => {
                let kinds = [&network.roads, &network.intersections, &network.car_parks];
                (kinds.into_iter().flatten().collect(), network.intersections.iter().collect())
            }
            None => (map.drivable_area.iter().collect::<Vec<&Area>>(), outlines(&map.lane_connectors)),
        };
        let roadblock = |lane: &&Lane| network?.roadblocks.get(&lane.id).map(String::as_str);
        let limit = |lane: &&Lane| network?.speed_limits_mps.get(&lane.id).copied();
        Self {
            drivable: Areas::new(drivable),
            intersections: Areas::new(intersections),
            lane_areas: Areas::new(lanes.iter().map(|lane| &lane.outline)),
            roadblocks: lanes.iter().map(roadblock).collect(),
            limits_mps: lanes.iter().map(limit).collect(),
            lanes,
        }
    }

    /// Returns the indices of red lane connectors on a route.
    pub(super) fn red(&self, ids: &BTreeSet<String>, route: &Route) -> Vec<usize> {
        route.lanes.iter().copied().filter(|lane| ids.contains(&self.lanes[*lane].id)).collect()
    }

    /// Returns the headings (radians) of the lanes at a position, global, meters.
    pub(super) fn headings(&self, place: DVec2) -> impl Iterator<Item = f64> {
        let lines = self.lane_areas.around(place).into_iter();
        let lines = lines.filter_map(|lane| Polyline::new(self.lanes[lane].centerline.iter().copied()));
        lines.map(move |line| line.at(line.nearest(place).0).1.to_angle())
    }

    /// Returns the route at a time (microseconds): on the lanes of the log's roadblocks, or along the
    /// recorded path if it has none or the ego is not on them. `None` if the ego never moved.
    pub(super) fn route(&self, recorded: &Recorded<'_>, ego: &PdmState, t_us: i64) -> Option<Route> {
        let roadblocks = recorded.log.route_at(t_us).map(|route| route.roadblocks.as_slice());
        let planned = roadblocks.and_then(|roadblocks| self.planned(roadblocks, ego));
        planned.or_else(|| self.driven(recorded))
    }

    fn planned(&self, roadblocks: &[String], ego: &PdmState) -> Option<Route> {
        let wanted: BTreeSet<&str> = roadblocks.iter().map(String::as_str).collect();
        let is_wanted = |lane: &usize| self.roadblocks[*lane].is_some_and(|id| wanted.contains(id));
        let lanes: BTreeSet<usize> = (0..self.lanes.len()).filter(is_wanted).collect();
        let start = self.start(&lanes, ego)?;
        let mut order: Vec<&str> = Vec::new();
        for id in roadblocks {
            if !order.contains(&id.as_str()) {
                order.push(id);
            }
        }
        let first = order.iter().position(|id| self.roadblocks[start] == Some(id)).unwrap_or(0);
        let target = *order[first..order.len().min(first + MAX_ROADBLOCKS)].last()?;
        let plan = self.search(start, target, &lanes);
        let lines = plan.iter().map(|lane| &self.lanes[*lane].centerline[..]);
        Some(Route { centerline: Path::through(lines)?, lanes, limit_mps: self.limits_mps[start] })
    }

    /// Returns the route along the recorded path, on all lanes below it. It continues straight beyond its
    /// end, since PDM-Closed stops at the end of its path.
    fn driven(&self, recorded: &Recorded<'_>) -> Option<Route> {
        let line = recorded.route.line()?;
        let lanes = line.resampled(LANE_STEP_M).into_iter().flat_map(|place| self.lane_areas.around(place));
        let lanes = lanes.collect();
        let end = line.at(line.length_m() + EXTENSION_M).0;
        let points: Vec<DVec2> = line.points().iter().copied().chain([end]).collect();
        Some(Route { centerline: Path::through([&points[..]])?, lanes, limit_mps: None })
    }

    /// Returns the lane below the ego that is closest to its heading, or else the nearest lane.
    fn start(&self, lanes: &BTreeSet<usize>, ego: &PdmState) -> Option<usize> {
        let error = |lane: &usize| {
            let line = &self.lanes[*lane].centerline;
            let distance = |i: &usize| line[*i].distance(ego.place_m);
            let nearest = (0..line.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
            let from = nearest.min(line.len().checked_sub(2)?);
            let heading = (line[from + 1] - line[from]).to_angle();
            Some((*lane, wrap_angle(heading - ego.heading_rad).abs()))
        };
        let below = self.lane_areas.around(ego.place_m).into_iter().filter(|lane| lanes.contains(lane));
        let best = below.filter_map(|lane| error(&lane)).min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((lane, _)) = best {
            return Some(lane);
        }
        let body = ego.body();
        let around = self.lane_areas.around(body.center);
        if let Some(lane) = around.into_iter().find(|lane| lanes.contains(lane)) {
            return Some(lane);
        }
        let corners = body.corners();
        let distance = |lane: &usize| shape::distance_m(&self.lanes[*lane].outline.exterior, &corners);
        let nearest = lanes.iter().map(|lane| (*lane, distance(lane))).min_by(|a, b| a.1.total_cmp(&b.1));
        nearest.filter(|(_, distance_m)| *distance_m <= MAX_ROUTE_DISTANCE_M).map(|(lane, _)| lane)
    }

    /// Returns the shortest sequence of lanes to a roadblock (Dijkstra), or else the deepest one.
    fn search(&self, start: usize, target: &str, lanes: &BTreeSet<usize>) -> Vec<usize> {
        let numbers: BTreeMap<&str, usize> =
            lanes.iter().map(|lane| (self.lanes[*lane].id.as_str(), *lane)).collect();
        let length_m =
            |lane: usize| self.lanes[lane].centerline.windows(2).map(|p| p[0].distance(p[1])).sum::<f64>();
        let mut before: BTreeMap<usize, usize> = BTreeMap::new();
        // Lanes with their distance and depth, in the order in which they were found.
        let mut open: Vec<(usize, f64, usize)> = vec![(start, 1.0, 1)];
        let mut done: Vec<(usize, f64, usize)> = Vec::new();
        while let Some(next) = (0..open.len()).min_by(|a, b| open[*a].1.total_cmp(&open[*b].1)) {
            let (lane, distance_m, depth) = open.remove(next);
            if self.roadblocks[lane] == Some(target) {
                return path_to(lane, &before);
            }
            done.push((lane, distance_m, depth));
            for follower in self.lanes[lane].successors.iter().filter_map(|id| numbers.get(id.as_str())) {
                let found = (*follower, distance_m + length_m(*follower), depth + 1);
                let known = open.iter_mut().find(|(lane, ..)| lane == follower);
                match known {
                    Some(known) if found.1 < known.1 => *known = found,
                    Some(_) => continue,
                    None if done.iter().any(|(lane, ..)| lane == follower) => continue,
                    None => open.push(found),
                }
                before.insert(*follower, lane);
            }
        }
        let deepest = done.iter().map(|(.., depth)| *depth).max().unwrap_or_default();
        let ends = done.iter().filter(|(.., depth)| *depth == deepest);
        ends.min_by(|a, b| a.1.total_cmp(&b.1)).map_or_else(Vec::new, |(lane, ..)| path_to(*lane, &before))
    }
}

fn path_to(lane: usize, before: &BTreeMap<usize, usize>) -> Vec<usize> {
    let mut lanes = vec![lane];
    while let Some(previous) = lanes.last().and_then(|lane| before.get(lane)) {
        lanes.push(*previous);
    }
    lanes.reverse();
    lanes
}

/// Returns the corners of a lane.
pub(super) fn ring<'a>(roads: &Roads<'a>, lane: usize) -> &'a [DVec2] {
    &roads.lanes[lane].outline.exterior
}
