use std::collections::BTreeMap;

use glam::DVec2;
use point_skeleton::dataset::{Area, Lane, VectorMap};
use point_skeleton::geometry::{Cuboid, Footprint};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

/// Number of cells that sample the footprint, along and across.
const CELLS: [usize; 2] = [10, 4];

/// Drivable area and lanes.
pub(crate) struct Road {
    drivable: Areas,
    lanes: Areas,
    /// Successor indices of each lane.
    successors: Vec<Vec<usize>>,
}

/// Areas, found by position.
pub(crate) struct Areas {
    areas: Vec<Area>,
    /// Indices of areas, keyed by their bounding rectangle.
    places: RTree<GeomWithData<Rectangle<[f64; 2]>, usize>>,
}

impl Road {
    /// Builds the index; `None` for a map without a drivable area.
    pub(crate) fn new(map: &VectorMap) -> Option<Self> {
        let lanes = map.lanes.iter().chain(&map.lane_connectors);
        let lanes: Vec<&Lane> = lanes.filter(|lane| is_sound(&lane.outline)).collect();
        let mut numbers: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (number, lane) in lanes.iter().enumerate() {
            numbers.entry(&lane.id).or_default().push(number);
        }
        // Some successors lie beyond the edge of the map.
        let known = |id: &String| numbers.get(id.as_str()).into_iter().flatten().copied();
        let road = Self {
            drivable: Areas::new(&map.drivable_area),
            lanes: Areas::new(lanes.iter().map(|lane| &lane.outline)),
            successors: lanes.iter().map(|lane| lane.successors.iter().flat_map(known).collect()).collect(),
        };
        (!road.drivable.areas.is_empty()).then_some(road)
    }

    /// Returns whether a position (global, meters) is outside the drivable area.
    pub(crate) fn is_off(&self, place: DVec2) -> bool {
        self.drivable.around(place).is_empty()
    }

    /// Returns the share of a box's footprint outside the drivable area, 0 to 1, sampled at the centers of 10
    /// by 4 cells and at the corners. A corner outside counts for at least one cell.
    pub(crate) fn share_off(&self, cuboid: &Cuboid) -> f64 {
        let footprint = Footprint::from(cuboid);
        let middle = |i: usize, j: usize| {
            let share = |k: usize, n: usize| (2 * k + 1) as f64 / n as f64 - 1.0;
            let local = footprint.half_m * DVec2::new(share(i, CELLS[0]), share(j, CELLS[1]));
            footprint.center + footprint.forward * local.x + footprint.forward.perp() * local.y
        };
        let cells = (0..CELLS[0]).flat_map(|i| (0..CELLS[1]).map(move |j| (i, j)));
        let off = |place: DVec2| self.is_off(place);
        let cells_off = cells.filter(|&(i, j)| off(middle(i, j))).count();
        let corner_off = footprint.corners().into_iter().any(off);
        cells_off.max(usize::from(corner_off)) as f64 / (CELLS[0] * CELLS[1]) as f64
    }

    /// Returns whether all corners lie on the drivable area and in one lane or connector, or in one and one
    /// of its successors.
    pub(super) fn is_in_one_lane(&self, footprint: &Footprint) -> bool {
        let corners = footprint.corners();
        let common = corners.map(|corner| self.lanes.around(corner));
        let hold = |lane: usize, next: usize| {
            common.iter().all(|lanes| lanes.contains(&lane) || lanes.contains(&next))
        };
        let follows = |lane: usize| self.successors[lane].iter().any(|next| hold(lane, *next));
        let shared = common.iter().flatten().any(|lane| hold(*lane, *lane) || follows(*lane));
        shared && corners.iter().all(|corner| !self.drivable.around(*corner).is_empty())
    }
}

impl Areas {
    /// Indexes the areas with finite corners.
    pub(crate) fn new<'a>(areas: impl IntoIterator<Item = &'a Area>) -> Self {
        let areas: Vec<Area> = areas.into_iter().filter(|area| is_sound(area)).cloned().collect();
        let place = |(number, area): (usize, &Area)| {
            let (low, high) = (
                area.exterior.iter().copied().reduce(DVec2::min).unwrap_or_default(),
                area.exterior.iter().copied().reduce(DVec2::max).unwrap_or_default(),
            );
            GeomWithData::new(Rectangle::from_corners(low.to_array(), high.to_array()), number)
        };
        let places = RTree::bulk_load(areas.iter().enumerate().map(place).collect());
        Self { areas, places }
    }

    /// Returns the indices of the areas that contain a position (global, meters).
    pub(crate) fn around(&self, place: DVec2) -> Vec<usize> {
        let near = self.places.locate_in_envelope_intersecting(AABB::from_point(place.to_array()));
        near.map(|near| near.data).filter(|number| contains(&self.areas[*number], place)).collect()
    }
}

/// Returns whether an area has corners, all of them finite.
pub(crate) fn is_sound(area: &Area) -> bool {
    !area.exterior.is_empty() && area.exterior.iter().all(|p| p.is_finite())
}

/// Returns whether a position lies within an area and in none of its holes.
fn contains(area: &Area, place: DVec2) -> bool {
    in_ring(&area.exterior, place) && !area.holes.iter().any(|hole| in_ring(hole, place))
}

/// Counts the edges crossed by a ray along x: an odd number means inside.
pub(crate) fn in_ring(ring: &[DVec2], place: DVec2) -> bool {
    let crosses = |i: &usize| {
        let (a, b) = (ring[*i], ring[(i + 1) % ring.len()]);
        (a.y > place.y) != (b.y > place.y) && place.x < a.x + (b.x - a.x) * (place.y - a.y) / (b.y - a.y)
    };
    (0..ring.len()).filter(crosses).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use point_skeleton::geometry::Pose;

    fn rectangle(x: [f64; 2], y: [f64; 2]) -> Area {
        let corner = |i: usize, j: usize| DVec2::new(x[i], y[j]);
        Area { exterior: vec![corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)], holes: Vec::new() }
    }

    /// Returns a road of two lanes of 4 m: the left one split into two adjacent areas, the right one with a
    /// hole.
    fn road() -> Road {
        let lane = |id: &str, outline: Area| Lane {
            id: id.into(),
            outline,
            centerline: Vec::new(),
            successors: Vec::new(),
        };
        let mut right = rectangle([0.0, 100.0], [-4.0, 0.0]);
        right.holes.push(rectangle([50.0, 60.0], [-4.0, 0.0]).exterior);
        let map = VectorMap {
            lanes: vec![
                lane("l", rectangle([0.0, 100.0], [0.0, 4.0])),
                lane("r", rectangle([0.0, 100.0], [-4.0, 0.0])),
            ],
            drivable_area: vec![
                rectangle([0.0, 40.0], [0.0, 4.0]),
                rectangle([40.0, 100.0], [0.0, 4.0]),
                right,
            ],
            ..VectorMap::default()
        };
        Road::new(&map).unwrap()
    }

    fn cuboid(x: f64, y: f64) -> Cuboid {
        Cuboid { pose: Pose::from_yaw(0.0, DVec3::new(x, y, 1.0)), size: DVec3::new(5.0, 2.0, 2.0) }
    }

    #[test]
    fn computes_off_road_shares() {
        let road = road();
        let share = |x: f64, y: f64| road.share_off(&cuboid(x, y));
        assert_eq!([share(20.0, 2.0), share(40.0, 0.0), share(20.0, -2.0)], [0.0; 3]);
        // Outside, half outside, a small part outside, over the hole.
        assert_eq!([share(20.0, 9.0), share(20.0, 4.0), share(20.0, -4.0)], [1.0, 0.5, 0.5]);
        assert_eq!(share(20.0, 3.01), 1.0 / 40.0);
        assert_eq!([share(55.0, -2.0), share(50.0, -2.0)], [1.0, 0.5]);
    }

    #[test]
    fn all_corners_must_be_in_one_lane() {
        let road = road();
        let one = |x: f64, y: f64| road.is_in_one_lane(&Footprint::from(&cuboid(x, y)));
        assert!(one(20.0, 2.0) && one(40.0, 2.0) && one(20.0, -2.0));
        assert!(!one(20.0, 0.5) && !one(20.0, 3.5) && !one(50.0, -2.0));
        assert!(Road::new(&VectorMap::default()).is_none());
    }

    /// A lane along x that forks at 40 m into a left and a right connector, beside a continuing lane.
    #[test]
    fn lane_and_successor_count_as_one() {
        let lane = |id: &str, outline: Area, successors: &[&str]| Lane {
            id: id.into(),
            outline,
            centerline: Vec::new(),
            successors: successors.iter().map(|id| (*id).to_owned()).collect(),
        };
        let broken = Area { exterior: vec![DVec2::NAN; 3], holes: Vec::new() };
        let map = VectorMap {
            lanes: vec![
                lane("broken", broken, &["right"]),
                lane("first", rectangle([0.0, 40.0], [0.0, 4.0]), &["elsewhere", "left", "right"]),
                lane("beside", rectangle([0.0, 100.0], [4.0, 8.0]), &[]),
            ],
            lane_connectors: vec![
                lane("left", rectangle([40.0, 60.0], [2.0, 4.0]), &["last"]),
                lane("right", rectangle([40.0, 60.0], [0.0, 2.9]), &[]),
                lane("last", rectangle([60.0, 64.0], [1.0, 4.0]), &[]),
            ],
            drivable_area: vec![rectangle([0.0, 100.0], [0.0, 8.0])],
            ..VectorMap::default()
        };
        let road = Road::new(&map).unwrap();
        let one = |x: f64, y: f64, yaw_rad: f64| {
            let pose = Pose::from_yaw(yaw_rad, DVec3::new(x, y, 1.0));
            road.is_in_one_lane(&Footprint::from(&Cuboid { pose, size: DVec3::new(5.0, 1.6, 2.0) }))
        };
        // Over the joint into the left connector, into the right one, and between both; out of the left one.
        assert!(one(40.0, 3.0, 0.0) && one(40.0, 1.5, 0.0) && one(60.0, 3.0, 0.0));
        assert!(!one(40.0, 2.2, 0.0));
        // Neither the adjacent lane nor a successor of another lane counts as the same lane.
        assert!(!one(20.0, 4.0, 0.0) && !one(40.0, 4.0, 0.0) && !one(60.0, 1.95, 0.0));
        // Backward over the joint it is the same lane.
        assert!(one(40.0, 3.0, std::f64::consts::PI));
    }
}
