//! A cloud as pieces of surfaces, in a bounding volume hierarchy (`obvhs`).

use glam::Vec3A;
use obvhs::aabb::Aabb;

use super::fan::Fan;
use super::patch::Patch;
use super::search::Search;
use super::split::patches;
use super::tree::{Tree, Visit};
use crate::cloud::Point;
use crate::vectors::wide;

/// Surfaces of a cloud, in its own frame.
pub(super) struct Solid {
    /// In the order of the tree.
    patches: Vec<Patch>,
    tree: Tree,
}

impl Solid {
    /// Creates the surfaces of points.
    pub(super) fn of(points: &[Point]) -> Self {
        let patches = patches(points);
        let boxes: Vec<Aabb> = patches.iter().map(Patch::bounds).collect();
        let (tree, order) = Tree::of(&boxes);
        Self { patches: order.into_iter().map(|number| patches[number as usize]).collect(), tree }
    }

    /// Lets a fan's rays from a point meet the surfaces.
    pub(super) fn meet(&self, origin: Vec3A, fan: &Fan, search: &mut Search) {
        wide(
            #[inline(always)]
            || {
                let mut left = self.tree.start(origin, fan);
                while let Some(Visit { near, branch, rays }) = left.pop() {
                    let rays = [rays[0] as usize, rays[1] as usize];
                    if !search.is_open(fan, rays, near) {
                        continue;
                    }
                    match branch.piece() {
                        Some(patch) => search.meet(&self.patches[patch], origin, fan, rays),
                        None => self.tree.branch(branch, origin, fan, &mut left),
                    }
                }
            },
        );
    }

    /// Returns the memory of the solid, bytes.
    pub(super) fn bytes(&self) -> u64 {
        (size_of_val(self.patches.as_slice()) + self.tree.bytes()) as u64
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::lanes::Lanes;
    use super::super::search::{Hit, LAYERS_M};
    use super::*;

    fn hits(solid: &Solid, origin: Vec3A, fan: &Fan, far: &[f32]) -> Vec<Hit> {
        let mut search = Search::default();
        search.start(fan, far);
        solid.meet(origin, fan, &mut search);
        search.hits(fan).collect()
    }

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
            hits(solid, from, &Fan::of([DVec3::X * scale].into_iter()), &[far])
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
        for turn in 0..30 {
            let turn = f64::from(turn) * 0.21;
            for directions in [
                fan(turn, [-0.5, 0.3], 0.0, 1.0),
                fan(turn, [0.4, -0.4], 0.1, 0.8),
                fan(turn, [-2.0, 2.0], 0.01, 1.0),
            ] {
                let from = Vec3A::new(turn as f32, -1.0, 1.5);
                let together = hits(&solid, from, &Fan::of(directions.iter().copied()), &[7.0; 64]);
                let mut expected = Vec::new();
                for (ray, direction) in directions.iter().enumerate() {
                    let direction = direction.as_vec3a();
                    let met =
                        |patch: &Patch| patch.meet(from, direction.to_array().map(|axis| Lanes([axis]))).0[0];
                    let met = solid.patches.iter().map(|patch| (met(patch), f64::from(patch.points)));
                    let met: Vec<(f32, f64)> = met.collect();
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
        assert!(found > 1500, "{found}");
    }
}
