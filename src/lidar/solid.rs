//! A cloud as pieces of surfaces, in a bounding volume hierarchy (`obvhs`).

use std::ops::Range;

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;

use super::fan::Fan;
use super::patch::Patch;
use super::split::patches;
use crate::cloud::Point;

/// Depth within which surfaces are layers of one, meters along the ray: sweeps and devices differ by
/// centimeters, and the first of several layers is nearer than their surface.
const LAYERS_M: f32 = 0.2;

/// Surfaces of a cloud, in its own frame.
pub(super) struct Solid {
    patches: Vec<Patch>,
    /// `None` without patches, because the tree's builder requires some.
    tree: Option<Bvh2>,
}

/// Where a ray meets a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Number of the ray as given to the fan.
    pub(super) ray: usize,
    /// Distance along the ray, in lengths of its direction.
    pub(super) t: f64,
    /// Coarse class.
    pub(super) class: u8,
}

/// A ray of a fan while its first surface is searched.
#[derive(Clone, Copy)]
struct Search {
    direction: Vec3A,
    /// Greatest distance, in lengths of the direction as all here; negative if the ray is not searched.
    far: f32,
    /// Depth of layers.
    layers: f32,
    /// The nearest surface, and its class.
    first: (f32, u8),
}

/// A piece of a surface that a ray meets.
struct Met {
    ray: usize,
    t: f32,
    points: u32,
}

impl Solid {
    /// Creates the surfaces of points.
    pub(super) fn of(points: &[Point]) -> Self {
        let patches = patches(points);
        let boxes: Vec<_> = patches.iter().map(Patch::bounds).collect();
        let build = || build_bvh2(&boxes, BvhBuildParams::fast_build(), &mut Default::default());
        let tree = (!boxes.is_empty()).then(build);
        Self { patches, tree }
    }

    /// Returns the first surface that each ray of a fan meets up to its distance: the mean of its layers,
    /// weighted by their numbers of points. Distances are in lengths of the ray's direction, in the order of
    /// the rays as given to the fan; rays of negative ones are not searched.
    pub(super) fn meet(&self, origin: Vec3A, fan: &Fan, far: &[f32]) -> Vec<Hit> {
        let far = fan.order.iter().map(|number| far[*number as usize]);
        let search = |(direction, far): (&Vec3A, f32)| {
            let layers = LAYERS_M / direction.length();
            Search { direction: *direction, far, layers, first: (f32::INFINITY, 0) }
        };
        let mut searches: Vec<Search> = fan.directions.iter().zip(far).map(search).collect();
        let is_searched = |search: &Search| search.far >= 0.0;
        let (Some(tree), Some(first)) = (&self.tree, searches.iter().position(is_searched)) else {
            return Vec::new();
        };
        let all = first..searches.iter().rposition(is_searched).map_or(first, |last| last + 1);
        let mut met = Vec::new();
        self.visit(tree, origin, fan, &all, &mut |patch, rays| {
            for ray in rays {
                let search = &mut searches[ray];
                let t = patch.meet(origin, search.direction);
                if t > search.first.0.min(search.far) + search.layers {
                    continue;
                }
                met.push(Met { ray, t, points: patch.points });
                if t <= search.far && t < search.first.0 {
                    search.first = (t, patch.class);
                }
            }
        });
        let mut sums = vec![(0.0, 0.0); searches.len()];
        for Met { ray, t, points } in met {
            let Search { layers, first, .. } = searches[ray];
            if t <= first.0 + layers {
                let (weight, sum) = (f64::from(points), &mut sums[ray]);
                *sum = (sum.0 + weight * f64::from(t), sum.1 + weight);
            }
        }
        let hit = |((search, sum), number): ((&Search, &(f64, f64)), &u32)| {
            let (t, class) = search.first;
            t.is_finite().then(|| Hit { ray: *number as usize, t: sum.0 / sum.1, class })
        };
        searches.iter().zip(&sums).zip(&fan.order).filter_map(hit).collect()
    }

    /// Visits the patches that some rays of a fan may meet, each with these rays.
    fn visit(
        &self,
        tree: &Bvh2,
        origin: Vec3A,
        fan: &Fan,
        rays: &Range<usize>,
        each: &mut impl FnMut(&Patch, Range<usize>),
    ) {
        let mut left = Vec::with_capacity(tree.max_depth);
        left.push(0);
        while let Some(node) = left.pop() {
            let node = &tree.nodes[node as usize];
            let bounds = node.aabb();
            let reach = fan.reach_box(bounds.min - origin, bounds.max - origin);
            let Some(reach) = reach.filter(|reach| fan.has(reach, rays)) else { continue };
            if !node.is_leaf() {
                left.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            let found = fan.rays(&reach);
            let found = found.start.max(rays.start)..found.end.min(rays.end);
            for id in node.first_index..node.first_index + node.prim_count {
                each(&self.patches[tree.primitive_indices[id as usize] as usize], found.clone());
            }
        }
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
    use glam::DVec3;

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
        let from = Vec3A::new(0.0, 0.5, 0.5);
        let all = |solid: &Solid, scale: f64, far: f32| {
            solid.meet(from, &Fan::of([DVec3::X * scale].into_iter()), &[far])
        };
        let meet = |scale: f64| all(&solid, scale, 50.0)[0];
        assert!((meet(1.0).t - 10.06).abs() < 0.01 && (meet(2.0).t - 5.03).abs() < 0.005, "{:?}", meet(1.0));
        assert_eq!((meet(1.0).class, meet(1.0).ray), (2, 0));
        assert!(all(&solid, 1.0, 9.0).is_empty() && all(&solid, 1.0, -1.0).is_empty());
        assert!(all(&Solid::of(&[]), 1.0, 9.0).is_empty() && Solid::of(&[]).bytes() == 0);
        assert!(solid.bytes() > 0);
    }

    /// Rays of a fan meet what each of them meets among all pieces: walls, a floor and boxes, from inside of
    /// them and from beside, with directions that are scaled, beside the half-plane, and on both sides.
    #[test]
    fn fans_meet_what_each_ray_meets() {
        let mut points: Vec<Point> = Vec::new();
        for i in 0..4000_i64 {
            let at = |axis: i64, low: f64, high: f64| crate::hash::between(7, &[i, axis], low, high) as f32;
            let (x, y, z) = (at(0, -8.0, 8.0), at(1, -8.0, 8.0), at(2, 0.0, 3.0));
            let place = match i % 4 {
                0 | 1 => [x, y, 0.02 * z],
                2 => [6.0, y, z],
                _ => [x * 0.3 - 3.0, y * 0.2 + 3.0, z],
            };
            points.push(Point::new(place, [0; 3], (i % 4) as u8));
        }
        let solid = Solid::of(&points);
        let fan = |turn: f64, rise: [f64; 2], beside: f64, scale: f64| -> Vec<DVec3> {
            let ray = |i: i32| {
                let part = f64::from(i) / 63.0;
                let (yaw, pitch) = (turn + beside * f64::from(i % 3), rise[0] + (rise[1] - rise[0]) * part);
                DVec3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()) * scale
            };
            (0..64).map(ray).collect()
        };
        let mut found = 0;
        for turn in 0..90 {
            let turn = f64::from(turn) * 0.07;
            for directions in [
                fan(turn, [-0.5, 0.3], 0.0, 1.0),
                fan(turn, [0.4, -0.4], 0.1, 0.8),
                fan(turn, [-2.0, 2.0], 0.01, 1.0),
            ] {
                let from = Vec3A::new(turn as f32, -1.0, 1.5);
                let together = solid.meet(from, &Fan::of(directions.iter().copied()), &[7.0; 64]);
                let mut expected = Vec::new();
                for (ray, direction) in directions.iter().enumerate() {
                    let direction = direction.as_vec3a();
                    let met = solid.patches.iter().map(|patch| (patch.meet(from, direction), patch.points));
                    let met: Vec<(f32, f64)> = met.map(|(t, points)| (t, f64::from(points))).collect();
                    let first = met.iter().fold(f32::INFINITY, |first, (t, _)| first.min(*t));
                    if first > 7.0 {
                        continue;
                    }
                    let layers = met.iter().filter(|(t, _)| *t <= first + LAYERS_M / direction.length());
                    let add = |(sum, weights): (f64, f64), (t, weight): &(f32, f64)| {
                        (sum + f64::from(*t) * weight, weights + weight)
                    };
                    let (sum, weights) = layers.fold((0.0, 0.0), add);
                    expected.push((ray, sum / weights));
                }
                let mut met: Vec<(usize, f64)> = together.iter().map(|hit| (hit.ray, hit.t)).collect();
                met.sort_by_key(|(ray, _)| *ray);
                assert_eq!(met.len(), expected.len());
                for ((ray, t), (other, expected)) in met.into_iter().zip(expected) {
                    assert!(
                        ray == other && (t - expected).abs() < 1e-9 * expected,
                        "{ray}: {t}, not {expected}"
                    );
                }
                found += together.len();
            }
        }
        assert!(found > 5000, "{found}");
    }
}
