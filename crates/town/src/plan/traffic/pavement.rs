//! Tracks of pedestrians: closed lines around the blocks, parallel to the kerb.

use glam::DVec2;
use point_skeleton::geometry::Polyline;

use crate::plan::line::{offset_line, polyline};
use crate::plan::{Network, Side};

/// Minimum distance of walkers to the kerb, where poles are, on sidewalks up to and above `WIDE_M`, and to
/// the houses, meters. Wide sidewalks have wider furniture.
const POLES_M: f64 = 1.3;
const POLES_WIDE_M: f64 = 1.62;
const WIDE_M: f64 = 3.3;
const HOUSES_M: f64 = 0.5;
/// Minimum distance between parallel tracks, meters.
const TRACK_M: f64 = 0.85;
/// Ends nearer than this are identical, meters.
const SAME_M: f64 = 0.05;

/// Kerb around a block, closed, with the road on the left.
pub(super) struct Kerb(Vec<DVec2>);

/// Closed line to walk on.
pub(super) struct Track {
    path: Polyline,
    /// Whether it is walked with the road on the left.
    pub(super) forward: bool,
}

impl Kerb {
    /// Returns all kerbs of a network.
    pub(super) fn all(network: &Network) -> Vec<Self> {
        let mut seen = vec![[false; 2]; network.roads.len()];
        let mut kerbs = Vec::new();
        for road in 0..network.roads.len() {
            for forward in [true, false] {
                if !seen[road][usize::from(forward)] {
                    kerbs.extend(Self::from(network, (road, forward), &mut seen));
                }
            }
        }
        kerbs
    }

    /// Follows a side of a road around its block; `None` if it does not close.
    fn from(network: &Network, start: (usize, bool), seen: &mut [[bool; 2]]) -> Option<Self> {
        let (mut points, mut at) = (Vec::new(), start);
        loop {
            let (road, forward) = at;
            if std::mem::replace(&mut seen[road][usize::from(forward)], true) {
                break;
            }
            add(&mut points, &side(network, at));
            let junction = &network.junctions[network.roads[road].junctions[usize::from(forward)]];
            let same = |a: &DVec2, b: &DVec2| a.distance(*b) < SAME_M;
            let corners = junction.kerbs();
            let corner = corners.iter().find(|corner| same(&corner[0], &points[points.len() - 1]))?;
            let end = corner[corner.len() - 1];
            add(&mut points, corner);
            let sides = junction.roads().into_iter().flat_map(|road| [(road, true), (road, false)]);
            at = sides.into_iter().find(|s| side(network, *s).first().is_some_and(|p| same(p, &end)))?;
        }
        // Two nearly identical points would have no direction.
        let first = points[0];
        while points.len() > 2 && points[points.len() - 1].distance(first) < SAME_M {
            points.pop();
        }
        points.push(first);
        (at == start).then_some(Self(points))
    }

    /// Returns the tracks along it, from the road outward.
    pub(super) fn tracks(&self, sidewalk_m: f64, number: usize) -> Vec<Track> {
        let first_m = if sidewalk_m > WIDE_M { POLES_WIDE_M } else { POLES_M };
        let room_m = sidewalk_m - HOUSES_M - first_m;
        let count = 1 + (room_m / TRACK_M).max(0.0) as usize;
        let step_m = if count > 1 { room_m / (count - 1) as f64 } else { 0.0 };
        let track = |k: usize| {
            let line = offset_line(&self.0, -(first_m + step_m * k as f64));
            Track { path: polyline(&line), forward: (k + number).is_multiple_of(2) }
        };
        (0..count).map(track).collect()
    }
}

/// Appends points, except those that coincide with the last one.
fn add(points: &mut Vec<DVec2>, more: &[DVec2]) {
    for point in more {
        if points.last().is_none_or(|last| last.distance(*point) > SAME_M) {
            points.push(*point);
        }
    }
}

/// Returns the kerb on a side of a road, in the direction that has the road on the left.
fn side(network: &Network, (road, forward): (usize, bool)) -> Vec<DVec2> {
    if forward {
        return network.roads[road].kerb(Side::Right);
    }
    let mut kerb = network.roads[road].kerb(Side::Left);
    kerb.reverse();
    kerb
}

impl Track {
    pub(super) fn length_m(&self) -> f64 {
        self.path.length_m()
    }

    /// Returns the nearest position along the track and the distance from it, meters.
    pub(super) fn nearest(&self, point: DVec2) -> (f64, f64) {
        self.path.nearest(point)
    }

    /// Returns the part around a position along it, in walking direction, from `before_m` before to `after_m`
    /// after, meters.
    pub(super) fn part(&self, along_m: f64, before_m: f64, after_m: f64) -> Vec<DVec2> {
        let sign = if self.forward { 1.0 } else { -1.0 };
        let steps = (before_m + after_m).ceil().max(1.0) as usize;
        let at = |i: usize| {
            let walked_m = (before_m + after_m) * i as f64 / steps as f64 - before_m;
            self.path.at((along_m + sign * walked_m).rem_euclid(self.length_m())).0
        };
        (0..=steps).map(at).collect()
    }
}
