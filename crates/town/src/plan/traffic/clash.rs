//! Conflicts between paths through a junction: which paths cross, and from where on one has cleared the
//! other.

use glam::DVec2;
use point_skeleton::geometry::{Footprint, Polyline};
use rustc_hash::FxHashMap;

use super::footprint::on_path;
use super::junction_path::JunctionPath;
use crate::plan::line::polyline;

/// Envelope of every car, and of every truck and bus: length, width and wheelbase, meters.
const CAR_M: [f64; 3] = [6.2, 2.7, 3.2];
const LONG_M: [f64; 3] = [12.6, 3.1, 7.0];
/// Spacing of the sampled positions, and their range beyond both ends of a path, meters.
const STEP_M: f64 = 0.8;
const BEYOND_M: f64 = 8.0;

/// Returns two tables, for pairs of cars and for pairs with a long vehicle. For paths `(a, b)` they have the
/// distance along `a` that the middle of a vehicle must have reached so that no vehicle on `b` can touch it,
/// meters.
pub(super) fn tables(
    paths: &[Polyline],
    connectors: &[Option<JunctionPath>],
) -> [FxHashMap<(usize, usize), f64>; 2] {
    [CAR_M, LONG_M].map(|size| {
        let swept: Vec<Vec<Footprint>> =
            (0..paths.len()).map(|i| swept(paths, connectors, i, size)).collect();
        let mut table = FxHashMap::default();
        let junction = |i: usize| connectors[i].map(|connector| connector.junction);
        for a in 0..paths.len() {
            for b in (a + 1..paths.len()).filter(|b| junction(a).is_some() && junction(a) == junction(*b)) {
                if let Some([last_a, last_b]) = last_touch(&swept[a], &swept[b]) {
                    for (pair, last) in [((a, b), last_a), ((b, a), last_b)] {
                        // Where two paths merge, car following replaces this table beyond the end.
                        let clear_m = (last as f64 + 1.0) * STEP_M - BEYOND_M;
                        table.insert(pair, clear_m.min(paths[pair.0].length_m()));
                    }
                }
            }
        }
        table
    })
}

/// Returns the boxes of a vehicle every [`STEP_M`] along its path; empty for lanes of roads.
fn swept(
    paths: &[Polyline],
    connectors: &[Option<JunctionPath>],
    index: usize,
    [length, width, base]: [f64; 3],
) -> Vec<Footprint> {
    let Some(connector) = connectors[index] else { return Vec::new() };
    let (before, after) = (&paths[connector.from], &paths[connector.to]);
    let lead_m = 2.0 * BEYOND_M;
    let mut points = before.part(before.length_m() - lead_m, before.length_m());
    points.extend(paths[index].points());
    points.extend(after.part(0.0, lead_m));
    let whole = polyline(&points);
    let steps = ((paths[index].length_m() + 2.0 * BEYOND_M) / STEP_M) as usize;
    let place = |i: usize| lead_m - BEYOND_M + i as f64 * STEP_M;
    (0..=steps).map(|i| on_path(&whole, place(i), base, DVec2::new(length, width))).collect()
}

/// Returns the last index of each that touches the other; `None` if they never touch.
fn last_touch(a: &[Footprint], b: &[Footprint]) -> Option<[usize; 2]> {
    let touches = |one: &Footprint, others: &[Footprint]| others.iter().any(|other| one.overlaps(other));
    let last_a = a.iter().rposition(|one| touches(one, b))?;
    let last_b = b.iter().rposition(|one| touches(one, a))?;
    Some([last_a, last_b])
}
