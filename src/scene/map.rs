//! HD map of a log with ground heights from the ego's trajectory.
//!
//! # How it works
//! The source map is 2D (x and y). Each corner of an outline gets the height of the nearest ego origin of the
//! log, found in x and y with an R-tree. A second R-tree indexes the edges, so the cost of a step does not
//! grow with the size of the map.

use std::fmt;
use std::sync::Arc;

use glam::{DVec2, DVec3};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

use crate::dataset::{Area, DatasetError, LogReader, Recording, VectorMap};

/// Kind of area that an edge bounds, or of line; layers are drawn in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MapLayer {
    /// A lane outside of intersections.
    Lane,
    /// Area where vehicles may drive.
    DrivableArea,
    /// Area for pedestrians.
    Walkway,
    /// Line between lanes or at the edge of a road.
    Divider,
    /// Pedestrian crossing.
    Crossing,
}

/// Straight segment of an outline or line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapEdge {
    /// Kind of the bounded area or line.
    pub layer: MapLayer,
    /// Start, global frame, meters.
    pub from: DVec3,
    /// End, global frame, meters.
    pub to: DVec3,
}

/// HD map of a log with heights.
pub struct SceneMap {
    map: VectorMap,
    edges: Vec<MapEdge>,
    /// Indices of edges, keyed by their bounding rectangle.
    places: RTree<GeomWithData<Rectangle<[f64; 2]>, usize>>,
}

impl SceneMap {
    /// Reads the HD map of a log; `None` if it has none.
    ///
    /// # Errors
    /// Fails if the map is damaged.
    pub fn read(dataset: &dyn LogReader) -> Result<Option<Arc<Self>>, DatasetError> {
        Ok(dataset.read_map()?.map(|map| Arc::new(Self::new(map, dataset.recording()))))
    }

    /// Assigns ground heights from a log to a map. Skips edges with coordinates that are not finite, and all
    /// edges if the log has no ego pose and thus no heights.
    pub fn new(map: VectorMap, log: &Recording) -> Self {
        let ground = Ground::of(log);
        let lanes = map.lanes.iter().map(|lane| (MapLayer::Lane, &lane.outline));
        let drivable = map.drivable_area.iter().map(|area| (MapLayer::DrivableArea, area));
        let walkways = map.walkways.iter().map(|area| (MapLayer::Walkway, area));
        let dividers = map.dividers.iter().flat_map(|line| edges_along(MapLayer::Divider, line, &ground));
        let crossings = map.crossings.iter().map(|area| (MapLayer::Crossing, area));
        let outline = |(layer, area)| edges_of(layer, area, &ground);
        let areas = lanes.chain(drivable).chain(walkways).flat_map(outline);
        let edges: Vec<MapEdge> = areas.chain(dividers).chain(crossings.flat_map(outline)).collect();
        let place = |(number, edge): (usize, &MapEdge)| {
            let corners = [edge.from, edge.to].map(|p| p.truncate().to_array());
            GeomWithData::new(Rectangle::from_corners(corners[0], corners[1]), number)
        };
        let places = RTree::bulk_load(edges.iter().enumerate().map(place).collect());
        Self { map, edges, places }
    }

    /// Returns the map as read from its source.
    pub fn vector_map(&self) -> &VectorMap {
        &self.map
    }

    /// Returns all edges in drawing order: by layer, then in the file's order, exterior before holes.
    pub fn edges(&self) -> &[MapEdge] {
        &self.edges
    }

    /// Returns the edges whose bounding rectangle intersects a window in x and y (global, meters), in drawing
    /// order.
    pub fn edges_within(&self, min: DVec2, max: DVec2) -> Vec<MapEdge> {
        let window = AABB::from_corners(min.to_array(), max.to_array());
        let mut numbers: Vec<usize> =
            self.places.locate_in_envelope_intersecting(window).map(|place| place.data).collect();
        numbers.sort_unstable();
        numbers.into_iter().map(|number| self.edges[number]).collect()
    }
}

impl fmt::Debug for SceneMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SceneMap of {:?} with {} edges", self.map.location, self.edges.len())
    }
}

impl PartialEq for SceneMap {
    /// Ignores the R-tree, which is derived from the edges.
    fn eq(&self, other: &Self) -> bool {
        (&self.map, &self.edges) == (&other.map, &other.edges)
    }
}

fn edges_of(layer: MapLayer, area: &Area, ground: &Ground) -> Vec<MapEdge> {
    let rings = std::iter::once(&area.exterior).chain(&area.holes);
    let edges = rings.flat_map(|ring| {
        let corners: Vec<Option<DVec3>> = ring.iter().map(|corner| ground.under(*corner)).collect();
        (0..corners.len()).filter_map(move |i| {
            let (from, to) = (corners[i]?, corners[(i + 1) % corners.len()]?);
            Some(MapEdge { layer, from, to })
        })
    });
    edges.collect()
}

fn edges_along(layer: MapLayer, line: &[DVec2], ground: &Ground) -> Vec<MapEdge> {
    let corners: Vec<Option<DVec3>> = line.iter().map(|corner| ground.under(*corner)).collect();
    let edge = |pair: &[Option<DVec3>]| Some(MapEdge { layer, from: pair[0]?, to: pair[1]? });
    corners.windows(2).filter_map(edge).collect()
}

/// Ground heights along the ego's trajectory.
struct Ground {
    heights_m: Vec<f64>,
    /// Indices of heights, keyed by x and y.
    places: RTree<GeomWithData<[f64; 2], usize>>,
}

impl Ground {
    /// Collects the ego poses of all frames and their sweeps.
    fn of(log: &Recording) -> Self {
        let poses = log.frames.iter().flat_map(|frame| {
            std::iter::once(frame.global_from_ego).chain(frame.sweeps.iter().map(|s| s.global_from_ego))
        });
        let origins: Vec<DVec3> = poses.map(|pose| pose.translation).filter(|p| p.is_finite()).collect();
        let place = |(i, p): (usize, &DVec3)| GeomWithData::new([p.x, p.y], i);
        let places = RTree::bulk_load(origins.iter().enumerate().map(place).collect());
        Self { heights_m: origins.iter().map(|p| p.z).collect(), places }
    }

    /// Returns a position at the height of the nearest ego origin; of equally near origins, the first.
    fn under(&self, at: DVec2) -> Option<DVec3> {
        if !at.is_finite() {
            return None;
        }
        let mut nearest = self.places.nearest_neighbor_iter_with_distance_2(at.to_array());
        let (first, distance_2) = nearest.next()?;
        let ties = nearest.take_while(|(_, other)| *other <= distance_2).map(|(place, _)| place.data);
        let index = ties.fold(first.data, usize::min);
        Some(at.extend(self.heights_m[index]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Frame, Lane};
    use crate::geometry::Pose;

    fn log(origins: &[DVec3]) -> Recording {
        let frame = |(t_us, at): (i64, &DVec3)| {
            let (sweeps, images, between_images, boxes) = Default::default();
            let global_from_ego = Pose::from_yaw(0.0, *at);
            Frame { t_us, global_from_ego, sweeps, images, between_images, boxes }
        };
        Recording { frames: (0..).zip(origins).map(frame).collect(), ..Recording::default() }
    }

    fn square(at: DVec2, side_m: f64) -> Vec<DVec2> {
        [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y].map(|corner| at + corner * side_m).to_vec()
    }

    fn area(at: DVec2, side_m: f64) -> Area {
        Area { exterior: square(at, side_m), holes: Vec::new() }
    }

    fn lane(at: DVec2, side_m: f64) -> Lane {
        let (centerline, successors) = Default::default();
        Lane { id: "lane".into(), outline: area(at, side_m), centerline, successors }
    }

    /// Returns a fixed pseudorandom sequence of numbers in 0..1.
    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 7_u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1 << 24) as f64
        }
    }

    #[test]
    fn every_corner_has_the_height_of_the_nearest_ego_origin() {
        let mut number = numbers();
        // UTM coordinates, and many origins at one position, as for a waiting ego.
        let base = DVec3::new(600_000.0, 4_000_000.0, 100.0);
        let mut origins = vec![base; 50];
        origins.extend((0..200).map(|_| base + DVec3::new(number(), number(), number()) * 300.0));
        let ground = Ground::of(&log(&origins));
        for _ in 0..500 {
            let at = base.truncate() + DVec2::new(number(), number()) * 400.0 - 50.0;
            let nearest = origins.iter().map(|p| (p.truncate() - at).length_squared()).enumerate();
            let (index, _) = nearest.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
            assert_eq!(ground.under(at), Some(at.extend(origins[index].z)));
        }
    }

    #[test]
    fn equally_near_origins_use_the_first_height() {
        let ring = [DVec3::new(1.0, 0.0, 5.0), DVec3::new(-1.0, 0.0, 3.0), DVec3::new(0.0, 1.0, 4.0)];
        assert_eq!(Ground::of(&log(&ring)).under(DVec2::ZERO), Some(DVec3::new(0.0, 0.0, 5.0)));
        let turned: Vec<DVec3> = ring.into_iter().rev().collect();
        assert_eq!(Ground::of(&log(&turned)).under(DVec2::ZERO), Some(DVec3::new(0.0, 0.0, 4.0)));
    }

    #[test]
    fn edges_close_rings_and_are_sorted_by_layer() {
        let with_hole = Area { exterior: square(DVec2::ZERO, 9.0), holes: vec![square(DVec2::ONE, 2.0)] };
        let map = VectorMap {
            lanes: vec![lane(DVec2::ZERO, 3.0)],
            lane_connectors: vec![lane(DVec2::ZERO, 4.0)],
            drivable_area: vec![with_hole],
            crossings: vec![area(DVec2::ONE, 5.0)],
            stop_lines: vec![area(DVec2::ONE, 6.0)],
            walkways: vec![area(DVec2::ONE, 7.0)],
            ..VectorMap::default()
        };
        let map = SceneMap::new(map, &log(&[DVec3::Z]));
        let layers: Vec<MapLayer> = map.edges().iter().map(|e| e.layer).collect();
        let expected = [
            (MapLayer::Lane, 4),
            (MapLayer::DrivableArea, 8),
            (MapLayer::Walkway, 4),
            (MapLayer::Crossing, 4),
        ];
        let expected: Vec<MapLayer> =
            expected.into_iter().flat_map(|(layer, count)| vec![layer; count]).collect();
        assert_eq!(layers, expected);
        for ring in map.edges().chunks(4) {
            assert!((0..4).all(|i| ring[i].to == ring[(i + 1) % 4].from && ring[i].from.z == 1.0));
        }
        let lengths: Vec<f64> = map.edges().iter().map(|e| (e.to - e.from).length()).collect();
        let expected = [3.0, 9.0, 2.0, 7.0, 5.0].map(|side| [side; 4]);
        assert_eq!(lengths, expected.as_flattened());
    }

    /// A line is open: a divider of three corners has two edges.
    #[test]
    fn dividers_are_lines() {
        let divider = [[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]].map(DVec2::from).to_vec();
        let map = VectorMap {
            dividers: vec![divider],
            crossings: vec![area(DVec2::ONE, 5.0)],
            ..VectorMap::default()
        };
        let map = SceneMap::new(map, &log(&[DVec3::Z]));
        let edge = |from: [f64; 2], to: [f64; 2]| MapEdge {
            layer: MapLayer::Divider,
            from: DVec2::from(from).extend(1.0),
            to: DVec2::from(to).extend(1.0),
        };
        assert_eq!(map.edges()[..2], [edge([0.0, 0.0], [3.0, 0.0]), edge([3.0, 0.0], [3.0, 4.0])]);
        assert!(map.edges()[2..].iter().all(|edge| edge.layer == MapLayer::Crossing));
    }

    #[test]
    fn a_window_query_equals_a_scan() {
        let mut number = numbers();
        let mut areas = |count: usize| -> Vec<Area> {
            let place = |n: f64, m: f64| DVec2::new(600_000.0, 4_000_000.0) + DVec2::new(n, m) * 900.0;
            (0..count).map(|_| area(place(number(), number()), number() * 40.0)).collect()
        };
        let map = VectorMap { drivable_area: areas(300), crossings: areas(300), ..VectorMap::default() };
        let map = SceneMap::new(map, &log(&[DVec3::ZERO]));
        let mut found_some = 0;
        for _ in 0..50 {
            let min = DVec2::new(600_000.0, 4_000_000.0) + DVec2::new(number(), number()) * 900.0;
            let max = min + DVec2::new(number(), number()) * 100.0;
            let meets = |e: &&MapEdge| {
                let (a, b) = (e.from.truncate(), e.to.truncate());
                a.min(b).cmple(max).all() && a.max(b).cmpge(min).all()
            };
            let scanned: Vec<MapEdge> = map.edges().iter().filter(meets).copied().collect();
            assert_eq!(map.edges_within(min, max), scanned);
            found_some += usize::from(!scanned.is_empty() && scanned.len() < map.edges().len());
        }
        assert!(found_some > 25, "{found_some}");
    }

    #[test]
    fn edges_without_position_or_height_are_skipped() {
        let mut broken = area(DVec2::ZERO, 2.0);
        broken.exterior[1].x = f64::NAN;
        let map = VectorMap { crossings: vec![broken, Area::default()], ..VectorMap::default() };
        // Two of the four edges end at the corner that is not finite.
        assert_eq!(SceneMap::new(map.clone(), &log(&[DVec3::ZERO])).edges().len(), 2);
        assert!(SceneMap::new(map, &log(&[])).edges().is_empty());
    }
}
