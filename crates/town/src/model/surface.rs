//! Sampling of a mesh's outer surface as points.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::mesh::Mesh;

/// Maximum number of rays across a mesh.
const MAX_RAYS: f64 = 2048.0;
/// Depths that differ by less are equal, meters.
const TIE_M: f64 = 1e-5;

/// Point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position in the mesh's frame, meters.
    pub position_m: DVec3,
    /// sRGB color.
    pub rgb: [u8; 3],
    /// Index of its triangle.
    pub triangle: usize,
    /// Whether the outer side of that triangle was hit.
    pub outside: bool,
}

/// Samples the surfaces that are visible from the side or from above. The points are the first hits of
/// parallel rays in thirteen directions, with a spacing of three quarters of `spacing_m`. At most 2048 rays
/// cross the mesh in a row. The result is deterministic; it is empty if the mesh has no finite extent.
pub fn surface(mesh: &Mesh, spacing_m: f64) -> Vec<SurfacePoint> {
    let step_m = 0.75 * spacing_m;
    directions().par_iter().flat_map_iter(|direction| seen_along(mesh, *direction, step_m)).collect()
}

/// Returns the ray directions: from above, from eight sides, and from four corners above.
fn directions() -> Vec<DVec3> {
    let mut all = vec![DVec3::NEG_Z];
    for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        all.push(DVec3::new(x, y, 0.0));
    }
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        all.push(DVec3::new(x, y, 0.0).normalize());
        all.push(DVec3::new(x, y, -1.0).normalize());
    }
    all
}

/// Returns the first hits of parallel rays along a unit direction. Rays pass through a square grid of
/// `step_m` aligned to the origin.
pub(super) fn seen_along(mesh: &Mesh, direction: DVec3, step_m: f64) -> Vec<SurfacePoint> {
    let (u, v) = direction.any_orthonormal_pair();
    let turn = DMat3::from_cols(u, v, direction).transpose();
    let Some([low, high]) = bounds(mesh, turn) else { return Vec::new() };
    let step_m = step_m.max((high - low).truncate().max_element() / MAX_RAYS);
    if !step_m.is_normal() {
        return Vec::new();
    }
    let origin = [low.x, low.y].map(|a| (a / step_m).floor());
    let size =
        [(high.x, origin[0]), (high.y, origin[1])].map(|(a, first)| ((a / step_m) - first) as usize + 2);
    let mut first: Vec<Option<(f64, usize)>> = vec![None; size[0] * size[1]];
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let corners = mesh.corners(*triangle).map(|p| turn * p);
        // At a silhouette edge with equal depths, the side that faces the viewer wins.
        let turned_away = if mesh.area(*triangle).dot(direction) < 0.0 { 0.0 } else { TIE_M };
        cover(corners, step_m, |at, depth| {
            let depth = depth + turned_away;
            let cell = (at[0] - origin[0]) as usize + (at[1] - origin[1]) as usize * size[0];
            if let Some(nearest) = first.get_mut(cell)
                && nearest.is_none_or(|(other, _)| depth < other)
            {
                *nearest = Some((depth, i));
            }
        });
    }
    let point = |(cell, hit): (usize, &Option<(f64, usize)>)| {
        let (depth, i) = (*hit)?;
        let at = [origin[0] + (cell % size[0]) as f64, origin[1] + (cell / size[0]) as f64];
        let position_m = u * (at[0] * step_m) + v * (at[1] * step_m) + direction * depth;
        let triangle = mesh.triangles[i];
        let [r, g, b, _] = mesh.vertices[triangle[0] as usize].rgba;
        let outside = mesh.area(triangle).dot(direction) < 0.0;
        Some(SurfacePoint { position_m, rgb: [r, g, b], triangle: i, outside })
    };
    first.iter().enumerate().filter_map(point).collect()
}

/// Returns the bounds of the rotated triangles; `None` without triangles or if a corner is not finite.
fn bounds(mesh: &Mesh, turn: DMat3) -> Option<[DVec3; 2]> {
    let mut places = mesh.triangles.iter().flat_map(|t| mesh.corners(*t)).map(|p| turn * p);
    let first = places.next()?;
    let join = |[low, high]: [DVec3; 2], p: DVec3| p.is_finite().then(|| [low.min(p), high.max(p)]);
    places.try_fold([first, first], join).filter(|_| first.is_finite())
}

/// Calls `at` with each grid point (in steps) that a triangle covers along z, and its z there. Skips
/// triangles seen edge-on.
fn cover(corners: [DVec3; 3], step_m: f64, mut at: impl FnMut([f64; 2], f64)) {
    let [a, b, c] = corners;
    let flat = |p: DVec3| DVec2::new(p.x, p.y);
    let twice_area = (flat(b) - flat(a)).perp_dot(flat(c) - flat(a));
    if twice_area.abs() < 1e-12 {
        return;
    }
    let (low, high) = (a.min(b).min(c) / step_m, a.max(b).max(c) / step_m);
    for row in low.y.ceil() as i64..=high.y.floor() as i64 {
        for column in low.x.ceil() as i64..=high.x.floor() as i64 {
            let place = [column as f64, row as f64];
            let p = DVec2::from(place) * step_m;
            let share =
                |from: DVec3, to: DVec3| (flat(to) - flat(from)).perp_dot(p - flat(from)) / twice_area;
            let shares = [share(b, c), share(c, a), share(a, b)];
            if shares.iter().all(|s| *s >= -1e-9) {
                at(place, a.z * shares[0] + b.z * shares[1] + c.z * shares[2]);
            }
        }
    }
}
