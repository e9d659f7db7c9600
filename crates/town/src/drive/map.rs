//! HD map of a town, in the global frame.

use std::collections::BTreeMap;

use glam::DVec2;
use point_skeleton::dataset::nuscenes::{MapLayers, RoadSegment};
use point_skeleton::dataset::{Area, Lane, VectorMap};
use point_skeleton::geometry::Pose;

use crate::plan::{LaneKind, Network, Road, TownLane};

/// Depth of the area before a stop line, meters.
const STOP_DEPTH_M: f64 = 0.5;

/// Returns the map, and the additional layers of the nuScenes format.
pub(super) fn vector_map(
    network: &Network,
    location: &str,
    global_from_town: &Pose,
) -> (VectorMap, MapLayers) {
    let lanes = |in_junctions: bool| {
        let wanted = network.lanes.iter().filter(|l| matches!(l.kind, LaneKind::Junction(_)) == in_junctions);
        wanted.map(|lane| self::lane(network, lane)).collect()
    };
    let roads = || network.roads.iter();
    let junctions = || network.junctions.iter().filter(|j| j.outline.len() >= 3);
    let road_areas = || roads().map(|road| strip(&road.centerline, -road.half_width_m, road.half_width_m));
    let junction_areas = || junctions().map(|junction| plain(junction.outline.clone()));
    let middles = || roads().map(|road| road.centerline.clone());
    let mut map = VectorMap {
        location: location.to_owned(),
        lanes: lanes(false),
        lane_connectors: lanes(true),
        drivable_area: road_areas().chain(junction_areas()).collect(),
        crossings: network.crossings.iter().map(|c| plain(c.outline.to_vec())).collect(),
        stop_lines: network
            .stop_lines
            .iter()
            .map(|(ends, lane)| stop_area(*ends, network.lanes.get(*lane)))
            .collect(),
        walkways: Vec::new(),
        dividers: middles().chain(roads().flat_map(lane_lines)).collect(),
        network: None,
        notes: BTreeMap::new(),
    };
    let segment = |is_intersection| move |area| RoadSegment { area, is_intersection };
    let mut layers = MapLayers {
        road_dividers: network.roads.len(),
        walkways: roads()
            .flat_map(|road| beside(road, |road, _| [road.half_width_m, road.half_width_m + road.sidewalk_m]))
            .collect(),
        carparks: roads()
            .flat_map(|road| {
                beside(road, |road, side| [road.half_width_m - road.parking_m[side], road.half_width_m])
            })
            .collect(),
        road_blocks: roads()
            .flat_map(|road| beside(road, |road, _| [0.0, road.lanes_each_way as f64 * road.lane_width_m]))
            .collect(),
        road_segments: road_areas().map(segment(false)).chain(junction_areas().map(segment(true))).collect(),
    };
    move_all(&mut map, &mut layers, global_from_town);
    (map, layers)
}

fn lane(network: &Network, lane: &TownLane) -> Lane {
    let id = |next: &usize| network.lanes.get(*next).map(|lane| lane.id.clone());
    Lane {
        id: lane.id.clone(),
        outline: strip(&lane.centerline, -lane.width_m / 2.0, lane.width_m / 2.0),
        centerline: lane.centerline.clone(),
        successors: lane.successors.iter().filter_map(id).collect(),
    }
}

/// Returns the lines between lanes of the same direction.
fn lane_lines(road: &Road) -> impl Iterator<Item = Vec<DVec2>> + '_ {
    let offsets =
        (1..road.lanes_each_way).flat_map(|i| [1.0, -1.0].map(|side| side * i as f64 * road.lane_width_m));
    offsets.map(|offset_m| parallel(&road.centerline, offset_m))
}

/// Returns a strip on the left and one on the right of a road, between two distances from its middle; skips
/// strips without width.
fn beside(road: &Road, ends_m: impl Fn(&Road, usize) -> [f64; 2]) -> Vec<Area> {
    let strip = |(side, sign): (usize, f64)| {
        let [from_m, to_m] = ends_m(road, side).map(|m| sign * m);
        ((from_m - to_m).abs() > 1e-6)
            .then(|| self::strip(&road.centerline, from_m.min(to_m), from_m.max(to_m)))
    };
    [(0, 1.0), (1, -1.0)].into_iter().filter_map(strip).collect()
}

/// Returns the area before a stop line, seen in the lane's direction.
fn stop_area([a, b]: [DVec2; 2], lane: Option<&TownLane>) -> Area {
    let mut back = (b - a).perp().normalize_or_zero() * STOP_DEPTH_M;
    let ahead = lane.and_then(|lane| lane.centerline.last_chunk::<2>()).map(|[from, to]| *to - *from);
    if ahead.is_some_and(|ahead| ahead.dot(back) > 0.0) {
        back = -back;
    }
    plain(vec![a, b, b + back, a + back])
}

/// Returns the area along a line from `right_m` to `left_m` (meters, positive to the left),
/// counter-clockwise.
fn strip(line: &[DVec2], right_m: f64, left_m: f64) -> Area {
    let mut ring = parallel(line, right_m);
    ring.extend(parallel(line, left_m).into_iter().rev());
    plain(ring)
}

/// Returns the parallel of a line at a distance to the left, meters.
fn parallel(line: &[DVec2], left_m: f64) -> Vec<DVec2> {
    let last = line.len().saturating_sub(1);
    let left = |i: usize| {
        let along = (line[(i + 1).min(last)] - line[i.saturating_sub(1)]).normalize_or_zero();
        line[i] + along.perp() * left_m
    };
    (0..line.len()).map(left).collect()
}

fn plain(exterior: Vec<DVec2>) -> Area {
    Area { exterior, holes: Vec::new() }
}

/// Transforms all coordinates from the town's frame to the global frame.
fn move_all(map: &mut VectorMap, layers: &mut MapLayers, global_from_town: &Pose) {
    let shift = |p: &mut DVec2| *p = global_from_town.transform_point(p.extend(0.0)).truncate();
    for lane in map.lanes.iter_mut().chain(&mut map.lane_connectors) {
        lane.centerline.iter_mut().chain(&mut lane.outline.exterior).for_each(shift);
    }
    let areas = map.drivable_area.iter_mut().chain(&mut map.crossings).chain(&mut map.stop_lines);
    let more = layers.walkways.iter_mut().chain(&mut layers.carparks).chain(&mut layers.road_blocks);
    let segments = layers.road_segments.iter_mut().map(|segment| &mut segment.area);
    areas.chain(more).chain(segments).flat_map(|area| &mut area.exterior).for_each(shift);
    map.dividers.iter_mut().flatten().for_each(shift);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn area_m2(ring: &[DVec2]) -> f64 {
        (0..ring.len()).map(|i| ring[i].perp_dot(ring[(i + 1) % ring.len()])).sum::<f64>() / 2.0
    }

    /// Returns a road of 100 m with two lanes of 3.5 m each way and parking on its left.
    fn network() -> Network {
        let centerline: Vec<DVec2> = (0..=100).map(|x| DVec2::new(f64::from(x), 0.0)).collect();
        let lane = TownLane {
            id: "a".into(),
            kind: LaneKind::Road(0),
            centerline: centerline.iter().map(|p| *p - DVec2::Y * 1.75).collect(),
            width_m: 3.5,
            successors: vec![1, 9],
        };
        let connector =
            TownLane { id: "b".into(), kind: LaneKind::Junction(0), successors: vec![], ..lane.clone() };
        let road = Road {
            centerline,
            half_width_m: 9.0,
            lanes_each_way: 2,
            lane_width_m: 3.5,
            parking_m: [2.0, 0.0],
            sidewalk_m: 3.0,
            junctions: [0, 0],
        };
        let stop_lines = vec![([DVec2::new(99.0, -3.5), DVec2::new(99.0, 0.0)], 0)];
        Network { roads: vec![road], lanes: vec![lane, connector], stop_lines, ..Network::default() }
    }

    #[test]
    fn straight_road_has_expected_areas() {
        let quarter = Pose::from_yaw(std::f64::consts::FRAC_PI_2, DVec3::new(1000.0, 50.0, 0.0));
        let (map, layers) = vector_map(&network(), "town", &quarter);
        let areas = |areas: &[Area]| areas.iter().map(|a| area_m2(&a.exterior).round()).collect::<Vec<_>>();
        assert_eq!(areas(&map.drivable_area), [1800.0]);
        assert_eq!(areas(&[map.lanes[0].outline.clone()]), [350.0]);
        assert_eq!((areas(&layers.walkways), areas(&layers.carparks)), (vec![300.0; 2], vec![200.0]));
        assert_eq!(map.lanes[0].successors, ["b"]); // 9 is no lane
        assert_eq!((map.lane_connectors.len(), map.dividers.len(), layers.road_dividers), (1, 3, 1));
        // Rotated by 90°: x of the town runs along the global y.
        assert!(map.lanes[0].centerline[10].distance(DVec2::new(1001.75, 60.0)) < 1e-9);
        let offsets: Vec<f64> = map.dividers.iter().map(|line| 1000.0 - line[5].x).collect();
        assert!(offsets.iter().zip([0.0, 3.5, -3.5]).all(|(a, b)| (a - b).abs() < 1e-9), "{offsets:?}");
        // The stop area lies before the line.
        let back = map.stop_lines[0].exterior.iter().map(|p| p.y - 50.0).fold(f64::INFINITY, f64::min);
        assert!((back - 98.5).abs() < 1e-9, "{back}");
    }
}
