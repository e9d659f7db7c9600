use glam::DVec2;
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

/// Occupant of an area.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Occupant {
    /// Road or sidewalk.
    Street,
    /// House.
    House,
    /// Garden in front of a house.
    Garden,
}

/// Spatial index of occupied convex areas.
#[derive(Debug)]
pub(super) struct Occupancy {
    areas: Vec<(Vec<DVec2>, Occupant)>,
    tree: RTree<GeomWithData<Rectangle<[f64; 2]>, usize>>,
}

impl Occupancy {
    /// Creates an index with the areas of streets.
    pub(super) fn new(strips: Vec<Vec<DVec2>>) -> Self {
        let areas: Vec<(Vec<DVec2>, Occupant)> =
            strips.into_iter().map(|area| (area, Occupant::Street)).collect();
        let boxes =
            areas.iter().enumerate().map(|(i, (area, _))| GeomWithData::new(bounds(area), i)).collect();
        Self { areas, tree: RTree::bulk_load(boxes) }
    }

    /// Marks an area as occupied.
    pub(super) fn take(&mut self, area: &[DVec2], by: Occupant) {
        self.tree.insert(GeomWithData::new(bounds(area), self.areas.len()));
        self.areas.push((area.to_vec(), by));
    }

    /// Returns whether a convex area overlaps no occupied area by more than a centimeter.
    pub(super) fn is_free(&self, area: &[DVec2]) -> bool {
        self.meets(area).next().is_none()
    }

    /// Returns the occupants that a convex area overlaps, in no particular order.
    pub(super) fn meets<'a>(&'a self, area: &'a [DVec2]) -> impl Iterator<Item = Occupant> + 'a {
        let envelope = rstar::RTreeObject::envelope(&bounds(area));
        let near = self.tree.locate_in_envelope_intersecting(envelope);
        near.map(|found| &self.areas[found.data]).filter(|(other, _)| overlap(area, other)).map(|(_, by)| *by)
    }
}

/// Overlap depth that is tolerated, meters.
const SLACK_M: f64 = 0.01;

/// Returns whether two convex polygons overlap (separating axis test).
pub(super) fn overlap(a: &[DVec2], b: &[DVec2]) -> bool {
    let apart = |a: &[DVec2], b: &[DVec2]| {
        (0..a.len()).any(|i| {
            let edge = a[(i + 1) % a.len()] - a[i];
            let out = -edge.normalize_or_zero().perp();
            out != DVec2::ZERO && b.iter().all(|p| (*p - a[i]).dot(out) > -SLACK_M)
        })
    };
    !(apart(a, b) || apart(b, a))
}

fn bounds(area: &[DVec2]) -> Rectangle<[f64; 2]> {
    let low = area.iter().copied().reduce(DVec2::min).unwrap_or_default();
    let high = area.iter().copied().reduce(DVec2::max).unwrap_or_default();
    Rectangle::from_aabb(AABB::from_corners(low.to_array(), high.to_array()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_overlap_test() {
        let square = |x: f64, y: f64| {
            [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[u, v]| DVec2::new(x + u, y + v))
        };
        let diamond = [[2.0, 0.0], [3.0, 1.0], [2.0, 2.0], [1.0, 1.0]].map(DVec2::from);
        for (a, b, expected) in [
            (square(0.0, 0.0), square(0.5, 0.9), true),
            (square(0.0, 0.0), square(1.0, 0.0), false),
            (square(0.0, 0.0), square(0.0, 0.995), false),
            (square(0.0, 0.0), square(0.0, 0.98), true),
            (square(0.0, 0.0), diamond, false),
            (square(0.3, 0.5), diamond, true),
            // Only their bounds overlap.
            (square(0.2, -0.8), diamond, false),
        ] {
            assert_eq!((overlap(&a, &b), overlap(&b, &a)), (expected, expected), "{a:?} {b:?}");
            let mut occupancy = Occupancy::new(vec![a.to_vec()]);
            assert_eq!(occupancy.is_free(&b), !expected);
            occupancy.take(&b, Occupant::House);
            assert!(occupancy.meets(&b).any(|by| by == Occupant::House));
        }
    }
}
