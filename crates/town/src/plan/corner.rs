//! Outline of a junction: mouths of roads with rounded kerbs between them.

use std::f64::consts::{PI, TAU};

use glam::DVec2;

use super::JunctionEdge;
use super::line::{bezier, polyline};

/// Gaps between roads wider than this have no corner to round; their kerb is one long curve.
const WIDE_RAD: f64 = 2.6;
/// Minimum distance from the middle of a junction to its mouths, meters.
const LEAST_M: f64 = 6.0;

/// End of a road at a junction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mouth {
    /// Index of the road.
    pub(super) road: usize,
    /// Unit direction from the middle of the junction into the road.
    pub(super) direction: DVec2,
    /// Distance from the middle of the road to its kerb, meters.
    pub(super) half_width_m: f64,
}

/// Sorts mouths counter-clockwise.
pub(super) fn sort(mouths: &mut [Mouth]) {
    mouths.sort_by(|a, b| a.direction.to_angle().total_cmp(&b.direction.to_angle()));
}

/// Returns the counter-clockwise angle from one mouth to the next, radians; 2π from a mouth to itself.
fn gap_rad(from: &Mouth, to: &Mouth) -> f64 {
    let gap = (to.direction.to_angle() - from.direction.to_angle()).rem_euclid(TAU);
    if gap < 1e-9 { TAU } else { gap }
}

/// Returns the distances of the mouths from the middle, meters, at which kerbs of the radius fit between
/// them. Requires sorted mouths.
pub(super) fn distances_m(mouths: &[Mouth], radius_m: f64) -> Vec<f64> {
    let n = mouths.len();
    let mut distances_m = vec![LEAST_M; n];
    for i in 0..n {
        let j = (i + 1) % n;
        let (a, b) = (&mouths[i], &mouths[j]);
        let gap = gap_rad(a, b);
        if gap > WIDE_RAD {
            continue;
        }
        // Distance at which the kerbs would meet; the curve starts slightly farther out.
        let reach =
            |own: f64, other: f64| (other + own * gap.cos()) / gap.sin() + radius_m / (gap / 2.0).tan() + 0.4;
        distances_m[i] = distances_m[i].max(reach(a.half_width_m, b.half_width_m));
        distances_m[j] = distances_m[j].max(reach(b.half_width_m, a.half_width_m));
    }
    distances_m
}

/// Returns the outline, counter-clockwise, and the kind of each edge. Requires sorted mouths.
pub(super) fn outline(
    centre: DVec2,
    mouths: &[Mouth],
    distances_m: &[f64],
    radius_m: f64,
) -> (Vec<DVec2>, Vec<JunctionEdge>) {
    let (mut corners, mut edges) = (Vec::new(), Vec::new());
    let ends = |i: usize| {
        let (middle, aside) = (mouths[i].direction * distances_m[i], mouths[i].direction.perp());
        [centre + middle - aside * mouths[i].half_width_m, centre + middle + aside * mouths[i].half_width_m]
    };
    for i in 0..mouths.len() {
        let next = (i + 1) % mouths.len();
        let [right, left] = ends(i);
        corners.push(right);
        edges.push(JunctionEdge::Road(mouths[i].road));
        let kerb = kerb([left, ends(next)[0]], [&mouths[i], &mouths[next]], radius_m);
        edges.extend(std::iter::repeat_n(JunctionEdge::Kerb, kerb.len() - 1));
        corners.extend(&kerb[..kerb.len() - 1]);
    }
    (corners, edges)
}

/// Returns a point that sees the whole outline where two roads meet: between the kerbs, nearer to the outer
/// one.
pub(super) fn middle_of_bend(outline: &[DVec2], edges: &[JunctionEdge]) -> DVec2 {
    let starts: Vec<usize> = (0..edges.len()).filter(|i| edges[*i] != JunctionEdge::Kerb).collect();
    let [a, b] = starts[..] else { return outline.iter().sum::<DVec2>() / outline.len().max(1) as f64 };
    let half_way = |from: usize, to: usize| {
        let kerb: Vec<DVec2> = (from..=to).map(|i| outline[i % outline.len()]).collect();
        let path = polyline(&kerb);
        (path.at(path.length_m() / 2.0).0, path.length_m())
    };
    let (one, other) = (half_way(a + 1, b), half_way(b + 1, a + outline.len()));
    let (inner, outer) = if one.1 < other.1 { (one.0, other.0) } else { (other.0, one.0) };
    let share = if (one.1 - other.1).abs() < 1.0 { 0.5 } else { 0.62 };
    inner.lerp(outer, share)
}

/// Returns the kerb from the left end of one mouth to the right end of the next, both included.
fn kerb([from, to]: [DVec2; 2], [a, b]: [&Mouth; 2], radius_m: f64) -> Vec<DVec2> {
    let gap = gap_rad(a, b);
    let chord = from.distance(to);
    if gap > TAU - 1e-6 {
        return cap(from, to, a.direction);
    }
    if gap > WIDE_RAD {
        // The handle length that approximates an arc of a circle.
        let handle = chord / 3.0 / ((gap - PI) / 4.0).cos().powi(2);
        let curve = [from, from - a.direction * handle, to - b.direction * handle, to];
        return bezier(curve, 8);
    }
    let along = (to - from).perp_dot(b.direction) / a.direction.perp_dot(b.direction);
    let corner = from + a.direction * along;
    let tangent_m = radius_m / (gap / 2.0).tan();
    let [start, end] = [corner + a.direction * tangent_m, corner + b.direction * tangent_m];
    let centre = start + a.direction.perp() * radius_m;
    let (first, turn) = ((start - centre).to_angle(), PI - gap);
    let steps = (turn / 0.2).ceil().max(3.0) as usize;
    let arc = |i: usize| centre + DVec2::from_angle(first - turn * i as f64 / steps as f64) * radius_m;
    let mut kerb = vec![from, start];
    kerb.extend((1..steps).map(arc));
    kerb.extend([end, to]);
    kerb.dedup_by(|p, q| p.distance(*q) < 0.05);
    let last = kerb.len() - 1;
    kerb[last] = to;
    kerb
}

/// Returns the kerb around the end of a dead-end road.
fn cap(from: DVec2, to: DVec2, direction: DVec2) -> Vec<DVec2> {
    let (middle, radius) = ((from + to) / 2.0 - direction * LEAST_M, from.distance(to) / 2.0);
    let arc = |i: usize| middle + DVec2::from_angle(PI * i as f64 / 12.0).rotate(direction.perp()) * radius;
    let mut cap = vec![from];
    cap.extend((0..=12).map(arc));
    cap.push(to);
    cap
}
