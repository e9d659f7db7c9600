//! Division of a cloud into pieces of surfaces.
//!
//! # How it works
//! Points are divided in halves along the longest side of their bounds, until they are on a plane, or in a
//! small box. Points on a plane get a mask of where they are. Its gaps are closed; if few cells were gaps and
//! most of them have several points, the halves have finer masks of the same plane: one through fewer points
//! would be tilted by their noise. So dense surfaces have exact outlines, and sparse ones, like the side of a
//! car that few beams met from far away, have no holes. Points in a small box and on no plane, like leaves,
//! are that box.

use glam::Vec3;

use super::mask::{Mask, SIDE};
use super::patch::{Patch, Shape, across};
use super::plane::Plane;
use crate::cloud::Point;

/// Longest side of a piece, meters.
const LONGEST_M: f32 = 1.0;
/// Longest side of a small box, meters.
const SMALL_M: f32 = 0.13;
/// Greatest standard deviation of points from their plane, meters: more than the noise of a sensor, and less
/// than the distance of surfaces that should be told apart.
const THICK_M: f32 = 0.025;
/// Least standard deviation along both axes of a plane, in standard deviations from it.
const WIDE: f32 = 1.5;
/// Least standard deviation from a plane that counts there, meters. A row of points from one beam is as wide
/// as the noise of its ranges, and no other beam meets the plane of that one.
const NOISE_M: f32 = 0.02;
/// How far a piece reaches beyond its points: in cells of its mask, and at least, meters.
const EDGE: f32 = 0.5;
const EDGE_M: f32 = 0.005;
/// Radius of closing, cells of a mask. A piece reaches the edge of what its part covers if that is as near.
const CLOSING: usize = 3;
/// Least share of cells with points in a mask that is full, before it is closed.
const FULL: f32 = 0.8;
/// Least share of cells with points, and number of points per cell, in a mask with gaps that is divided.
const DENSE: f32 = 0.75;
const POINTS_PER_CELL: usize = 2;
/// Least half side of a box, meters.
const HALF_M: f32 = 0.02;

/// Divides a cloud into pieces of surfaces.
pub(super) fn patches(points: &[Point]) -> Vec<Patch> {
    let finite = points.iter().filter(|point| point.is_finite());
    let mut points: Vec<(Vec3, u8)> = finite.map(|point| (point.position.into(), point.class())).collect();
    let mut patches = Vec::new();
    divide(&mut points, Cell::ALL, None, &mut patches);
    patches
}

/// What a part of a cloud may cover, meters.
#[derive(Clone, Copy, Debug)]
struct Cell {
    min: Vec3,
    max: Vec3,
}

impl Cell {
    const ALL: Self = Self { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };

    /// Returns the halves of the cell.
    fn halves(self, axis: usize, at: f32) -> [Self; 2] {
        let (mut low, mut high) = (self, self);
        (low.max[axis], high.min[axis]) = (at, at);
        [low, high]
    }
}

/// Divides points of a cell into pieces. `known` is the plane that they are on, if that is known.
fn divide(points: &mut [(Vec3, u8)], cell: Cell, known: Option<Plane>, patches: &mut Vec<Patch>) {
    let all = points.iter().map(|(at, _)| *at);
    let (Some(min), Some(max)) = (all.clone().reduce(Vec3::min), all.clone().reduce(Vec3::max)) else {
        return;
    };
    let extent = max - min;
    let axis = extent.max_position();
    let is_small = extent[axis] <= SMALL_M;
    let plane = known.or_else(|| (extent[axis] <= LONGEST_M).then(|| flat(all, is_small)).flatten());
    let shape = plane.and_then(|plane| surface(points, &plane, cell, [min, max], is_small));
    let shape = shape.or_else(|| (is_small || points.len() == 1).then(|| filled(points, [min, max])));
    if let Some(shape) = shape {
        patches.push(Patch { shape, class: class(points), points: points.len() as u32 });
        return;
    }
    let middle = f32::midpoint(min[axis], max[axis]);
    let [low, high] = cell.halves(axis, middle);
    points.sort_unstable_by_key(|(at, _)| at[axis] >= middle);
    let (below, above) = points.split_at_mut(points.partition_point(|(at, _)| at[axis] < middle));
    divide(below, low, plane, patches);
    divide(above, high, plane, patches);
}

/// Returns the plane that points are on; `None` if they are on none. `is_small` accepts thick planes.
fn flat(points: impl ExactSizeIterator<Item = Vec3> + Clone, is_small: bool) -> Option<Plane> {
    let count = points.len();
    let plane = Plane::through(points).filter(|_| count >= 4)?;
    let is_flat = plane.thickness_m <= THICK_M || is_small;
    (is_flat && plane.width_m > WIDE * plane.thickness_m.max(NOISE_M)).then_some(plane)
}

/// Returns the piece of a plane that has points in a cell; `None` if the halves have finer masks.
fn surface(
    points: &[(Vec3, u8)],
    plane: &Plane,
    cell: Cell,
    [min, max]: [Vec3; 2],
    is_small: bool,
) -> Option<Shape> {
    let along = plane.normal.abs().max_position();
    let sides = across(along as u8);
    let [mut low, mut high] = [min, max];
    let cell_m = sides.map(|side| (max - min)[side] / SIDE as f32);
    let room_m = (EDGE * cell_m[0].max(cell_m[1])).max(EDGE_M);
    for (side, cell_m) in sides.into_iter().zip(cell_m) {
        let beyond = |edge_m: f32| {
            let is_near = edge_m <= CLOSING as f32 * cell_m;
            if is_near { edge_m.max(EDGE_M) } else { room_m.min(edge_m) }
        };
        low[side] -= beyond(min[side] - cell.min[side]);
        high[side] += beyond(cell.max[side] - max[side]);
    }
    let mut seen = Mask::default();
    for (at, _) in points {
        seen.set(sides.map(|side| (at[side] - low[side]) / (high[side] - low[side])));
    }
    let mask = seen.closed(CLOSING);
    let (seen, covered) = (seen.count() as f32, mask.count());
    let is_full = covered == SIDE * SIDE && seen >= FULL * covered as f32;
    let is_dense = seen >= DENSE * covered as f32 && points.len() >= POINTS_PER_CELL * covered;
    if is_dense && !is_full && !is_small {
        return None;
    }
    let offset = plane.normal.dot(plane.mean);
    // As far as the plane reaches between its sides, which are beyond the points.
    let beside = sides.map(|side| [low, high].map(|end| end[side] * plane.normal[side]));
    let reach = |choose: fn(f32, f32) -> f32| {
        let [a, b] = beside.map(|[low, high]| choose(low, high) / plane.normal[along]);
        offset / plane.normal[along] - a - b
    };
    let (a, b) = (reach(f32::min), reach(f32::max));
    let slack_m = 2.0 * plane.thickness_m + EDGE_M;
    low[along] = min[along].min(a.min(b)) - slack_m;
    high[along] = max[along].max(a.max(b)) + slack_m;
    Some(Shape::Plane { normal: plane.normal, offset, min: low, max: high, along: along as u8, mask })
}

/// Returns the box of points with bounds.
fn filled(points: &[(Vec3, u8)], [min, max]: [Vec3; 2]) -> Shape {
    let (center, half) = ((min + max) / 2.0, ((max - min) / 2.0).max(Vec3::splat(HALF_M)));
    let mean = center + points.iter().map(|(at, _)| *at - center).sum::<Vec3>() / points.len() as f32;
    Shape::Box { min: center - half, max: center + half, mean }
}

/// Returns the most frequent class of points, the least of equally frequent ones.
fn class(points: &[(Vec3, u8)]) -> u8 {
    let mut counts = [0_usize; 256];
    points.iter().for_each(|(_, class)| counts[usize::from(*class)] += 1);
    (0..=u8::MAX).rev().max_by_key(|class| counts[usize::from(*class)]).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::lanes::Lanes;
    use super::*;
    use crate::hash::between;

    fn point(at: [f64; 3], class: u8) -> Point {
        Point::new(at.map(|x| x as f32), [0; 3], class)
    }

    /// Returns the range at which a ray along x from a place meets pieces.
    fn range(patches: &[Patch], [y, z]: [f32; 2]) -> Option<f32> {
        let meet =
            |patch: &Patch| patch.meet([0.0, y, z].into(), [1.0, 0.0, 0.0].map(|axis| Lanes([axis]))).0[0];
        let nearest = patches.iter().map(meet).fold(f32::INFINITY, f32::min);
        nearest.is_finite().then_some(nearest)
    }

    /// A wall at x = 10 with 2 cm of noise, a point every 5 cm, and a door of 1 by 2 m.
    #[test]
    fn walls_are_closed_and_doors_open() {
        let is_door = |y: f64, z: f64| (1.0..2.0).contains(&y) && z < 2.0;
        let grid = (0..80).flat_map(|i| (0..60).map(move |j| [f64::from(i) * 0.05, f64::from(j) * 0.05]));
        let points: Vec<Point> = grid
            .enumerate()
            .filter(|(_, [y, z])| !is_door(*y, *z))
            .map(|(i, [y, z])| point([10.0 + between(3, &[i as i64], -0.03, 0.03), y, z], 2))
            .collect();
        let patches = patches(&points);
        let steps = |count: i32| (1..count).map(move |i| i as f32 * 0.033);
        for (y, z) in steps(118).flat_map(|y| steps(88).map(move |z| (y, z))) {
            let near_door = (0.9..2.1).contains(&y) && z < 2.1;
            match range(&patches, [y, z]) {
                Some(range_m) => assert!((range_m - 10.0).abs() < 0.03, "{y} {z}: {range_m}"),
                None => assert!(near_door, "{y} {z}"),
            }
            assert!(range(&patches, [y, z]).is_none() || !(1.1..1.9).contains(&y) || z > 1.9, "{y} {z}");
        }
        assert!(patches.iter().all(|patch| patch.class == 2) && patches.len() < 120, "{}", patches.len());
    }

    /// Lines of beams 15 cm apart, with a point every 6 cm, as on the side of a car far away.
    #[test]
    fn sparse_lines_are_a_surface() {
        let lines =
            (0..9).flat_map(|line| (0..50).map(move |i| [f64::from(i) * 0.06, f64::from(line) * 0.15]));
        let points: Vec<Point> = lines.map(|[y, z]| point([5.0, y, z], 1)).collect();
        let patches = patches(&points);
        for y in 1..28 {
            for z in 1..12 {
                assert_eq!(range(&patches, [y as f32 * 0.1, z as f32 * 0.1]), Some(5.0), "{y} {z}");
            }
        }
        assert_eq!(
            [[-0.1, 0.5], [3.1, 0.5], [1.0, -0.1], [1.0, 1.4]].map(|at| range(&patches, at)),
            [None; 4]
        );
    }

    #[test]
    fn points_on_no_plane_are_boxes() {
        let patches = patches(&[point([4.0, 0.0, 0.0], 3), point([6.0, 0.5, 0.0], 0)]);
        assert_eq!((range(&patches, [0.015, 0.0]), range(&patches, [0.025, 0.0])), (Some(4.0), None));
        assert_eq!((range(&patches, [0.49, 0.01]), patches.len()), (Some(6.0), 2));
        assert!(super::patches(&[point([f64::NAN, 0.0, 0.0], 0)]).is_empty());
    }
}
