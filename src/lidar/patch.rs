//! Pieces of surfaces that rays meet.

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;

use super::mask::Mask;

/// A piece of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    /// Part of the plane `normal · x = offset` in a box, where a mask over the two axes of the box other than
    /// `along` is set.
    Plane { normal: Vec3, offset: f32, min: Vec3, max: Vec3, along: u8, mask: Mask },
    /// Points of no plane: met in the middle of their box.
    Box { min: Vec3, max: Vec3 },
}

/// Returns the two axes other than one.
pub(super) fn across(along: u8) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][usize::from(along)]
}

impl Patch {
    /// Returns the bounds of the patch.
    pub(super) fn bounds(&self) -> Aabb {
        let (Shape::Plane { min, max, .. } | Shape::Box { min, max }) = self.shape;
        Aabb::new(Vec3A::from(min), Vec3A::from(max))
    }

    /// Returns the distance at which a ray meets the patch, in lengths of its direction; infinite if it does
    /// not.
    #[inline]
    pub(super) fn meet(&self, origin: Vec3A, direction: Vec3A) -> f32 {
        let (origin, direction) = (Vec3::from(origin), Vec3::from(direction));
        match self.shape {
            Shape::Plane { normal, offset, min, max, along, mask } => {
                let t = (offset - normal.dot(origin)) / normal.dot(direction);
                let at = origin + direction * t;
                let is_inside = t > 0.0 && at.cmpge(min).all() && at.cmple(max).all();
                let cell = across(along).map(|axis| (at[axis] - min[axis]) / (max[axis] - min[axis]));
                if is_inside && mask.has(cell) { t } else { f32::INFINITY }
            }
            Shape::Box { min, max } => {
                let [a, b] = [min, max].map(|corner| (corner - origin) / direction);
                let (first, last) = (a.min(b).max_element(), a.max(b).min_element());
                let middle = ((min + max) / 2.0 - origin).dot(direction) / direction.length_squared();
                if first <= last && first > 0.0 { middle.clamp(first, last) } else { f32::INFINITY }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meet(patch: &Patch, origin: [f32; 3], direction: [f32; 3]) -> f32 {
        patch.meet(origin.into(), direction.into())
    }

    /// The plane x = 5 over y, z from 0 to 8; the mask has the cell of y from 2 to 3 and z from 4 to 5.
    #[test]
    fn planes_are_met_where_the_mask_is_set() {
        let mut mask = Mask::default();
        mask.set([2.5 / 8.0, 4.5 / 8.0]);
        let (min, max) = (Vec3::new(4.9, 0.0, 0.0), Vec3::new(5.1, 8.0, 8.0));
        let shape = Shape::Plane { normal: Vec3::X, offset: 5.0, min, max, along: 0, mask };
        let patch = Patch { shape, class: 3, points: 1 };
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

    #[test]
    fn boxes_are_met_in_their_middle() {
        let (min, max) = (Vec3::new(3.9, -0.1, -0.1), Vec3::new(4.1, 0.1, 0.1));
        let patch = Patch { shape: Shape::Box { min, max }, class: 0, points: 1 };
        let at = |y: f32| meet(&patch, [0.0, y, 0.0], [2.0, 0.0, 0.0]);
        assert_eq!((at(0.09), at(0.11), at(-0.11)), (2.0, f32::INFINITY, f32::INFINITY));
        assert_eq!(meet(&patch, [8.0, 0.0, 0.0], [1.0, 0.0, 0.0]), f32::INFINITY);
        let bounds = patch.bounds();
        assert_eq!((Vec3::from(bounds.min), Vec3::from(bounds.max)), (min, max));
    }
}
