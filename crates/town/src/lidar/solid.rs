//! Bounding volume hierarchy of triangles (`obvhs`), and the first hit of a ray.

use std::time::Duration;

use glam::{DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;

use crate::mesh::Mesh;

/// Meshes for ray casting, in their own frame.
pub(super) struct Solid {
    /// `None` without triangles, because the tree's builder requires some.
    tree: Option<CwBvh>,
    triangles: Vec<Triangle>,
    skins: Vec<Skin>,
    /// Center and radius of a bounding sphere, meters.
    pub(super) ball: (DVec3, f64),
}

/// Appearance of a triangle.
#[derive(Clone, Copy)]
struct Skin {
    rgb: [u8; 3],
    /// [`crate::mesh::Surface`] as a number.
    surface: u8,
}

/// Hit of a ray on a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Distance along the ray, in lengths of its direction.
    pub(super) t: f64,
    /// Unit normal in the solid's frame, to either side.
    pub(super) normal: DVec3,
    /// sRGB color.
    pub(super) rgb: [u8; 3],
    /// [`crate::mesh::Surface`] as a number.
    pub(super) surface: u8,
}

impl Solid {
    pub(super) fn new<'a>(meshes: impl IntoIterator<Item = &'a Mesh>) -> Self {
        let (mut triangles, mut skins) = (Vec::new(), Vec::new());
        for mesh in meshes {
            for corners in &mesh.triangles {
                let [a, b, c] = corners.map(|i| &mesh.vertices[i as usize]);
                let at = |v: &crate::mesh::Vertex| Vec3A::from(v.position);
                triangles.push(Triangle { v0: at(a), v1: at(b), v2: at(c) });
                let [r, g, b, _] = a.rgba;
                skins.push(Skin { rgb: [r, g, b], surface: a.surface as u8 });
            }
        }
        let build =
            || build_cwbvh_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default());
        let tree = (!triangles.is_empty()).then(build);
        Self { tree, ball: ball(&triangles), triangles, skins }
    }

    /// Returns the nearest hit before `t_max`. The tree is searched in `f32`; the intersection with the
    /// triangle's plane is computed in `f64`.
    pub(super) fn meet(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<Hit> {
        let tree = self.tree.as_ref()?;
        let ray = Ray::new(origin.as_vec3a(), direction.as_vec3a(), 0.0, t_max as f32);
        let index = |id: u32| tree.primitive_indices[id as usize] as usize;
        let mut found = RayHit::none();
        let met =
            tree.ray_traverse(ray, &mut found, |ray, id| self.triangles[index(id as u32)].intersect(ray));
        if !met {
            return None;
        }
        let (triangle, skin) =
            (&self.triangles[index(found.primitive_id)], self.skins[index(found.primitive_id)]);
        let [a, b, c] = [triangle.v0, triangle.v1, triangle.v2].map(|v| v.as_dvec3());
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let facing = normal.dot(direction);
        // For a ray parallel to the plane, the tree's result is the best available.
        let t = if facing.abs() > 1e-9 { normal.dot(a - origin) / facing } else { f64::from(found.t) };
        Some(Hit { t, normal, rgb: skin.rgb, surface: skin.surface })
    }
}

/// Returns a bounding sphere around the middle of the bounds.
fn ball(triangles: &[Triangle]) -> (DVec3, f64) {
    let corners = || triangles.iter().flat_map(|t| [t.v0, t.v1, t.v2]).map(|v| v.as_dvec3());
    let ends = corners().reduce(DVec3::min).zip(corners().reduce(DVec3::max));
    let middle = ends.map_or(DVec3::ZERO, |(min, max)| (min + max) / 2.0);
    (middle, corners().map(|c| c.distance(middle)).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Skin, Surface};
    use point_skeleton::hash::between;

    fn blocks() -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..200 {
            let at = |k, low, high| between(5, &[i, k], low, high);
            let min = DVec3::new(at(0, -60.0, 60.0), at(1, -60.0, 60.0), at(2, 0.0, 6.0));
            let skin = Skin { rgb: [i as u8; 3], surface: Surface::Plaster, seed: 3 };
            mesh.block(min, min + DVec3::new(at(3, 0.2, 5.0), at(4, 0.2, 5.0), at(5, 0.2, 5.0)), skin);
        }
        mesh
    }

    /// Tests each triangle with the method of Möller and Trumbore, in `f64`.
    fn full_search(mesh: &Mesh, origin: DVec3, direction: DVec3) -> Option<f64> {
        let meet = |corners: &[u32; 3]| {
            let [a, b, c] = corners.map(|i| glam::Vec3::from(mesh.vertices[i as usize].position).as_dvec3());
            let (e1, e2) = (b - a, c - a);
            let p = direction.cross(e2);
            let det = e1.dot(p);
            let s = (origin - a) / det;
            let u = s.dot(p);
            let q = s.cross(e1);
            let (v, t) = (direction.dot(q), e2.dot(q));
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
        };
        mesh.triangles.iter().filter_map(meet).min_by(f64::total_cmp)
    }

    #[test]
    fn tree_matches_exhaustive_search() {
        let mesh = blocks();
        let solid = Solid::new([&mesh]);
        let mut hits = 0;
        for i in 0..2000 {
            let at = |k| between(9, &[i, k], -1.0, 1.0);
            let origin = DVec3::new(50.0 * at(0), 50.0 * at(1), 3.0 + 2.0 * at(2));
            let direction = DVec3::new(at(3), at(4), 0.3 * at(5)).normalize();
            let found = solid.meet(origin, direction, 1e3).map(|hit| hit.t);
            match (found, full_search(&mesh, origin, direction)) {
                (Some(a), Some(b)) => assert!((a - b).abs() < 1e-9, "{i}: {a} {b}"),
                (a, b) => assert_eq!(a, b),
            }
            hits += usize::from(found.is_some());
        }
        assert!((500..2000).contains(&hits), "{hits}");
    }

    #[test]
    fn hits_report_surface_appearance() {
        let mut mesh = Mesh::default();
        let skin = Skin { rgb: [1, 2, 3], surface: Surface::CarGlass, seed: 77 };
        mesh.block(DVec3::new(5.0, -1.0, -1.0), DVec3::new(6.0, 1.0, 1.0), skin);
        let solid = Solid::new([&Mesh::default(), &mesh]);
        let hit = solid.meet(DVec3::ZERO, DVec3::X, 100.0).unwrap();
        let expected = Hit { t: 5.0, normal: DVec3::NEG_X, rgb: [1, 2, 3], surface: Surface::CarGlass as u8 };
        assert_eq!(hit, expected);
        assert_eq!(solid.meet(DVec3::ZERO, DVec3::X, 4.99), None);
        assert_eq!(solid.meet(DVec3::ZERO, DVec3::NEG_X, 100.0), None);
        assert_eq!(solid.ball, (DVec3::X * 5.5, DVec3::new(0.5, 1.0, 1.0).length()));
        assert_eq!(Solid::new([]).meet(DVec3::ZERO, DVec3::X, 100.0), None);
    }
}
