//! A cloud as pieces of surfaces, in a bounding volume hierarchy (`obvhs`).

use glam::DVec3;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::{Ray, RayHit};

use super::patch::Patch;
use super::split::patches;
use crate::cloud::Point;

/// Depth within which surfaces are layers of one, meters along the ray: sweeps and devices differ by
/// centimeters, and the first of several layers is nearer than their surface.
const LAYERS_M: f64 = 0.2;

/// Surfaces of a cloud, in its own frame.
pub(super) struct Solid {
    patches: Vec<Patch>,
    /// `None` without patches, because the tree's builder requires some.
    tree: Option<CwBvh>,
}

/// Where a ray meets a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Distance along the ray, in lengths of its direction.
    pub(super) t: f64,
    /// Coarse class.
    pub(super) class: u8,
}

impl Solid {
    /// Creates the surfaces of points.
    pub(super) fn of(points: &[Point]) -> Self {
        let patches = patches(points);
        let boxes: Vec<_> = patches.iter().map(Patch::bounds).collect();
        let build = || build_cwbvh(&boxes, BvhBuildParams::fast_build(), &mut Default::default());
        let tree = (!boxes.is_empty()).then(build);
        Self { patches, tree }
    }

    /// Returns the first surface that a ray meets up to a distance, in lengths of its direction: the mean of
    /// its layers, weighted by their numbers of points.
    pub(super) fn meet(&self, origin: DVec3, direction: DVec3, far: f64) -> Option<Hit> {
        let tree = self.tree.as_ref()?;
        let ray = |far: f32| Ray::new(origin.as_vec3a(), direction.as_vec3a(), 0.0, far);
        let patch = |id: usize| &self.patches[tree.primitive_indices[id] as usize];
        let mut first = RayHit::none();
        if !tree.ray_traverse(ray(far as f32), &mut first, |ray, id| patch(id).meet(ray)) {
            return None;
        }
        let far = first.t + (LAYERS_M / direction.length()) as f32;
        let (mut sum, mut weights) = (0.0, 0.0);
        tree.ray_traverse_anyhit(ray(far), |ray, id| {
            let (patch, weight) = (patch(id), f64::from(patch(id).points));
            let t = patch.meet(ray);
            if t <= far {
                (sum, weights) = (sum + weight * f64::from(t), weights + weight);
            }
        });
        Some(Hit { t: sum / weights, class: patch(first.primitive_id as usize).class })
    }

    /// Returns the memory of the solid, bytes.
    pub(super) fn bytes(&self) -> u64 {
        let tree = self.tree.as_ref().map_or(0, |tree| {
            size_of_val(tree.nodes.as_slice()) + size_of_val(tree.primitive_indices.as_slice())
        });
        (size_of_val(self.patches.as_slice()) + tree) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls at 10, 10.06, 10.12 and 11 m.
    #[test]
    fn layers_are_one_surface() {
        let wall = |x: f32, step: f32| {
            let count = (1.0 / step) as i32;
            let grid =
                (0..=count).flat_map(move |y| (0..=count).map(move |z| [y as f32 * step, z as f32 * step]));
            grid.map(move |[y, z]| Point::new([x, y, z], [0; 3], 2))
        };
        let layers = [10.0, 10.06, 10.12, 11.0];
        let points: Vec<Point> = layers.into_iter().flat_map(|x| wall(x, 0.02)).collect();
        let solid = Solid::of(&points);
        let meet = |scale: f64| solid.meet(DVec3::new(0.0, 0.5, 0.5), DVec3::X * scale, 50.0).unwrap();
        assert!((meet(1.0).t - 10.06).abs() < 0.01 && (meet(2.0).t - 5.03).abs() < 0.005, "{:?}", meet(1.0));
        assert_eq!(meet(1.0).class, 2);
        assert!(solid.meet(DVec3::new(0.0, 0.5, 0.5), DVec3::X, 9.0).is_none());
        assert!(Solid::of(&[]).meet(DVec3::ZERO, DVec3::X, 9.0).is_none() && Solid::of(&[]).bytes() == 0);
        assert!(solid.bytes() > 0);
    }
}
