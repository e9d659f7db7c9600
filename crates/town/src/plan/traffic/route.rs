use point_skeleton::geometry::Polyline;

use super::lanes::Lanes;
use crate::plan::Turn;
use crate::plan::line::{offset_line, polyline};
use crate::plan::random::Random;

/// Lateral acceleration that limits the speed along curves, m/s².
const LATERAL_MPS2: f64 = 1.9;
/// Deceleration ahead of a curve or a stop line, m/s².
pub(super) const BRAKING_MPS2: f64 = 1.5;
/// Spacing of the stored speed limits, meters.
const CAP_STEP_M: f64 = 1.0;
/// Window that curvature is measured over, meters.
const CURVE_M: f64 = 3.0;
/// Trucks and buses avoid curves with a smaller radius, meters.
const LONG_RADIUS_M: f64 = 14.0;

/// Route along lanes.
#[derive(Clone, Debug)]
pub(super) struct Route {
    /// Lanes in driving order.
    pub(super) lanes: Vec<usize>,
    /// Start of each lane, meters along the path, then the end of the last.
    pub(super) starts_m: Vec<f64>,
    /// Driven line.
    pub(super) path: Polyline,
    /// Maximum speed every meter.
    caps_mps: Vec<f64>,
}

/// Requirements of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RouteConstraints {
    /// Offset to the right of lane centers, meters.
    pub(super) right_m: f64,
    /// Whether it avoids sharp curves.
    pub(super) long: bool,
    /// If set, the route turns off at the first junction, then at every n-th.
    pub(super) turn_within: Option<usize>,
}

impl Route {
    /// Draws a random route from a lane on, at least `length_m` meters long if the streets continue.
    pub(super) fn draw(
        lanes: &Lanes<'_>,
        first: usize,
        length_m: f64,
        wish: RouteConstraints,
        random: &mut Random,
    ) -> Self {
        let mut taken = vec![first];
        let (mut left_m, mut last) = (length_m - lanes.length_m(first), first);
        // A route that turns off does so at the first junction.
        let mut straight = wish.turn_within.unwrap_or(0);
        while left_m > 0.0 {
            let connectors = &lanes.network.lanes[last].successors;
            let turn_of = |i: usize| lanes.connectors[i].map_or(Turn::Straight, |w| w.turn);
            let mut choices: Vec<usize> = connectors.clone();
            let mut prefer = |keep: &dyn Fn(usize) -> bool| {
                if choices.iter().any(|i| keep(*i)) {
                    choices.retain(|i| keep(*i));
                }
            };
            prefer(&|i| lanes.is_open(i, 3));
            // If all paths are narrow, those that do not turn right are the widest.
            prefer(&|i| !wish.long || turn_of(i) != Turn::Right);
            prefer(&|i| !wish.long || gentle(&lanes.paths[i]));
            if let Some(within) = wish.turn_within {
                let turns = straight + 1 >= within;
                prefer(&|i| (turn_of(i) != Turn::Straight) == turns);
            }
            // Vehicles that turn left hold up others.
            let weight = |i: usize| match turn_of(i) {
                Turn::Left => 1.0,
                Turn::Straight => 8.0,
                Turn::Right => 3.0,
            };
            let weighted: Vec<(usize, f64)> = choices.iter().map(|i| (*i, weight(*i))).collect();
            let Some(next) = random.weighted(&weighted) else { break };
            straight = if turn_of(next) == Turn::Straight { straight + 1 } else { 0 };
            let Some(after) = lanes.connectors[next].map(|w| w.to) else { break };
            taken.extend([next, after]);
            left_m -= lanes.length_m(next) + lanes.length_m(after);
            last = after;
        }
        Self::along(lanes, taken, wish.right_m)
    }

    fn along(lanes: &Lanes<'_>, taken: Vec<usize>, right_m: f64) -> Self {
        let mut points = Vec::new();
        let mut starts_m = vec![0.0];
        for lane in &taken {
            points.extend(offset_line(&lanes.network.lanes[*lane].centerline, -right_m));
            starts_m.push(polyline(&points).length_m());
        }
        let path = polyline(&points);
        let caps_mps = caps_mps(&path);
        Self { lanes: taken, starts_m, path, caps_mps }
    }

    /// Returns whether a long vehicle fits for `length_m` meters from a position on.
    pub(super) fn is_wide(&self, from_m: f64, length_m: f64) -> bool {
        self.length_m() > from_m + length_m && gentle(&polyline(&self.path.part(from_m, from_m + length_m)))
    }

    pub(super) fn length_m(&self) -> f64 {
        self.path.length_m()
    }

    /// Returns the index in `lanes` of the lane at a position, meters.
    pub(super) fn lane_at(&self, along_m: f64) -> usize {
        let next = self.starts_m.partition_point(|s| *s <= along_m);
        next.clamp(1, self.lanes.len()) - 1
    }

    /// Returns the maximum speed at a position, meters, with room to brake for what follows.
    pub(super) fn cap_mps(&self, along_m: f64) -> f64 {
        let at = (along_m / CAP_STEP_M).clamp(0.0, (self.caps_mps.len() - 1) as f64);
        let [a, b] = [at.floor(), at.ceil()].map(|k| self.caps_mps[k as usize]);
        a + (b - a) * at.fract()
    }
}

/// Returns the curvature of a path around a position, radians per meter.
fn curvature(path: &Polyline, at_m: f64) -> f64 {
    let [a, b, c] = [-CURVE_M / 2.0, 0.0, CURVE_M / 2.0].map(|d| path.at(at_m + d).0);
    (b - a).angle_to(c - b).abs() / (CURVE_M / 2.0)
}

fn gentle(path: &Polyline) -> bool {
    (0..path.length_m() as usize).all(|s| curvature(path, s as f64) < 1.0 / LONG_RADIUS_M)
}

fn caps_mps(path: &Polyline) -> Vec<f64> {
    let steps = (path.length_m() / CAP_STEP_M).ceil() as usize;
    let mut caps: Vec<f64> = (0..=steps)
        .map(|i| (LATERAL_MPS2 / curvature(path, i as f64 * CAP_STEP_M).max(1e-3)).sqrt())
        .collect();
    for i in (0..caps.len().saturating_sub(1)).rev() {
        let before = (caps[i + 1].powi(2) + 2.0 * BRAKING_MPS2 * CAP_STEP_M).sqrt();
        caps[i] = caps[i].min(before);
    }
    caps
}
