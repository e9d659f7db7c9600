//! Pieces of surfaces that rays meet.

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;

use super::lanes::{Lanes, and, dot, squared};
use super::mask::{Mask, SIDE};

/// Sine of the angle between a plane and rays that are along it: they meet it within its box. The points of a
/// row from one beam are on that beam's plane, and so are the rays that should meet them.
const EDGE_ON: f32 = 0.005;

/// A piece of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub(super) struct Patch {
    pub(super) shape: Shape,
    /// Coarse class of its points.
    pub(super) class: u8,
    /// Number of its points.
    pub(super) points: u32,
}

/// Shape of a piece, meters in the frame of its cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// Part of the plane `normal · x = offset` in a box, where a mask over its two axes other than `along` is
    /// set.
    Plane { normal: Vec3, offset: f32, min: Vec3, max: Vec3, along: u8, mask: Mask },
    /// Points of no plane, in a box: met next to their mean.
    Box { min: Vec3, max: Vec3, mean: Vec3 },
}

/// Returns the two axes other than one.
pub(super) fn across(along: u8) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][usize::from(along)]
}

impl Patch {
    /// Returns the bounds of the patch.
    pub(super) fn bounds(&self) -> Aabb {
        let (Shape::Plane { min, max, .. } | Shape::Box { min, max, .. }) = self.shape;
        Aabb::new(Vec3A::from(min), Vec3A::from(max))
    }

    /// Returns the distances at which rays from a point meet the patch, in lengths of their directions;
    /// infinite if they do not.
    #[inline(always)]
    pub(super) fn meet<const N: usize>(&self, origin: Vec3A, directions: [Lanes<N>; 3]) -> Lanes<N> {
        match self.shape {
            Shape::Plane { normal, offset, min, max, along, mask } => {
                let slopes = dot(normal.to_array(), directions);
                let t = Lanes::all(offset - normal.dot(origin.into())) / slopes;
                let [x, y, z] = directions;
                let at = [x * t + origin.x, y * t + origin.y, z * t + origin.z];
                let is_between = |axis: usize| {
                    and(Lanes::all(min[axis]).at_most(at[axis]), at[axis].at_most(Lanes::all(max[axis])))
                };
                let is_inside = and(and(is_between(0), is_between(1)), is_between(2));
                let mut met = Lanes::all(f32::INFINITY);
                if is_inside != [false; N] {
                    let [a, b] = across(along).map(|axis| (at[axis] - min[axis]) / (max[axis] - min[axis]));
                    for i in (0..N).filter(|i| is_inside[*i]) {
                        if t.0[i] > 0.0 && mask.has([a.0[i], b.0[i]]) {
                            met.0[i] = t.0[i];
                        }
                    }
                }
                let edge_on = (slopes * slopes).at_most(squared(directions) * (EDGE_ON * EDGE_ON));
                if edge_on == [false; N] {
                    return met;
                }
                let (first, last) = within(min, max, origin, directions);
                for i in (0..N).filter(|i| edge_on[*i]) {
                    let direction = Vec3::new(x.0[i], y.0[i], z.0[i]);
                    let is_set = |t: f32| mask.has(cell(Vec3::from(origin) + direction * t, min, max, along));
                    met.0[i] = met.0[i].min(first_set([first.0[i], last.0[i]], is_set));
                }
                met
            }
            Shape::Box { min, max, mean } => {
                let mean = mean - Vec3::from(origin);
                let nearest = dot(mean.to_array(), directions) / squared(directions);
                let (first, last) = within(min, max, origin, directions);
                let is_ahead = Lanes::all(f32::MIN_POSITIVE).at_most(first);
                nearest.max(first).min(last).only(and(is_ahead, first.at_most(last)))
            }
        }
    }
}

/// Returns where rays from a point enter and leave a box, in lengths of their directions: those that miss it
/// leave before they enter.
#[inline(always)]
fn within<const N: usize>(
    min: Vec3,
    max: Vec3,
    origin: Vec3A,
    directions: [Lanes<N>; 3],
) -> (Lanes<N>, Lanes<N>) {
    let ends = |axis: usize| {
        let inverse = Lanes::all(1.0) / directions[axis];
        let (a, b) = (inverse * (min[axis] - origin[axis]), inverse * (max[axis] - origin[axis]));
        (a.min(b), a.max(b))
    };
    let (x, y, z) = (ends(0), ends(1), ends(2));
    (x.0.max(y.0).max(z.0), x.1.min(y.1).min(z.1))
}

/// Returns the first distance between two at which a mask is set, by steps of half a cell; infinite if it is
/// not, or if the first one is behind the second one or not ahead.
#[inline(always)]
fn first_set([first, last]: [f32; 2], is_set: impl Fn(f32) -> bool) -> f32 {
    if first > last || first <= 0.0 {
        return f32::INFINITY;
    }
    let step = (last - first) / (2 * SIDE) as f32;
    let mut steps = (0..2 * SIDE).map(|part| first + (part as f32 + 0.5) * step);
    steps.find(|t| is_set(*t)).unwrap_or(f32::INFINITY)
}

/// Returns the coordinates of a place over the mask of a box.
#[inline(always)]
fn cell(at: Vec3, min: Vec3, max: Vec3, along: u8) -> [f32; 2] {
    let [a, b] = across(along);
    [(at[a] - min[a]) / (max[a] - min[a]), (at[b] - min[b]) / (max[b] - min[b])]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meet(patch: &Patch, origin: [f32; 3], direction: [f32; 3]) -> f32 {
        patch.meet(origin.into(), direction.map(|d| Lanes([d]))).0[0]
    }

    /// Returns a plane across an axis from 0 to 8 along the others, whose mask has the cell at a place.
    fn plane(along: u8, offset: f32, place: [f32; 2]) -> Patch {
        let mut mask = Mask::default();
        mask.set(place.map(|at| at / 8.0));
        let (normal, mut ends) = (Vec3::AXES[usize::from(along)], [Vec3::ZERO, Vec3::splat(8.0)]);
        ends[0][usize::from(along)] = offset - 0.1;
        ends[1][usize::from(along)] = offset + 0.1;
        let [min, max] = ends;
        Patch { shape: Shape::Plane { normal, offset, min, max, along, mask }, class: 3, points: 1 }
    }

    /// The plane x = 5; the mask has the cell of y from 2 to 3 and z from 4 to 5.
    #[test]
    fn planes_are_met_where_the_mask_is_set() {
        let patch = plane(0, 5.0, [2.5, 4.5]);
        let at = |y: f32, z: f32| meet(&patch, [0.0, y, z], [2.0, 0.0, 0.0]);
        assert_eq!(
            (at(2.5, 4.5), at(3.5, 4.5), at(2.5, 3.5), at(-5.5, 4.5)),
            (2.5, f32::INFINITY, f32::INFINITY, f32::INFINITY)
        );
        assert_eq!(meet(&patch, [10.0, 2.5, 4.5], [1.0, 0.0, 0.0]), f32::INFINITY);
        assert_eq!(meet(&patch, [0.0, 2.5, 4.5], [0.0, 1.0, 0.0]), f32::INFINITY);
        let tilted = meet(&patch, [0.0, 0.0, 0.0], [1.0, 0.5, 0.9]);
        assert_eq!(tilted, 5.0);
    }

    /// The plane z = 1; the mask has the cell of x from 6 to 7 and y from 4 to 5.
    #[test]
    fn rays_along_a_plane_meet_its_first_cell() {
        let patch = plane(2, 1.0, [6.5, 4.5]);
        let along = |y: f32, z: f32| meet(&patch, [-10.0, y, z], [1.0, 0.0, 0.0]);
        let found = along(4.5, 1.001);
        assert!((16.0..17.0).contains(&found), "{found}");
        assert_eq!(
            (along(4.5, 1.0), along(5.5, 1.001), along(4.5, 1.11)),
            (found, f32::INFINITY, f32::INFINITY)
        );
        assert_eq!(meet(&patch, [10.0, 4.5, 1.001], [1.0, 0.0, 0.0]), f32::INFINITY);
        assert_eq!(meet(&patch, [6.5, 4.5, 2.0], [0.0, 0.0, -1.0]), 1.0);
    }

    #[test]
    fn boxes_are_met_next_to_the_mean_of_their_points() {
        let (min, max) = (Vec3::new(3.9, -0.1, -0.1), Vec3::new(4.1, 0.1, 0.1));
        let mean = Vec3::new(4.0625, 0.05, 0.0);
        let patch = Patch { shape: Shape::Box { min, max, mean }, class: 0, points: 1 };
        let at = |y: f32| meet(&patch, [0.0, y, 0.0], [2.0, 0.0, 0.0]);
        assert_eq!((at(0.09), at(0.11), at(-0.11)), (2.03125, f32::INFINITY, f32::INFINITY));
        assert_eq!(meet(&patch, [8.0, 0.0, 0.0], [1.0, 0.0, 0.0]), f32::INFINITY);
        let bounds = patch.bounds();
        assert_eq!((Vec3::from(bounds.min), Vec3::from(bounds.max)), (min, max));
    }
}
