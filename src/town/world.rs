//! Things with a place, and what a ray meets first among them.
//!
//! How it works: every thing has parts in its own frame and bounds in the street's frame. A tree of bounds
//! (median split) finds the few things near a ray; their parts are then tested in the thing's frame.

use glam::DVec3;

use super::material::Material;
use super::shape::{Aabb, Ray, Shape};
use crate::geometry::Pose;

/// A solid with its look.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) shape: Shape,
    pub(super) material: Material,
}

/// Parts that stand together.
#[derive(Clone, Debug)]
pub(super) struct Thing {
    pub(super) street_from_thing: Pose,
    pub(super) parts: Vec<Part>,
}

/// Where a ray meets a thing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) t: f64,
    /// Unit, street frame.
    pub(super) normal: DVec3,
    /// In the thing's frame.
    pub(super) local: DVec3,
    /// Unit, thing's frame.
    pub(super) local_normal: DVec3,
    pub(super) material: Material,
}

/// Things, found by place.
#[derive(Clone, Debug, Default)]
pub(super) struct World {
    things: Vec<(Thing, Pose)>,
    nodes: Vec<Node>,
}

/// A node of the tree: a leaf holds one thing.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Aabb,
    kind: NodeKind,
}

#[derive(Clone, Copy, Debug)]
enum NodeKind {
    Leaf(usize),
    Fork(usize, usize),
}

impl Thing {
    /// Bounds of the parts in the thing's own frame.
    pub(super) fn local_bounds(&self) -> Aabb {
        self.parts.iter().fold(Aabb::EMPTY, |bounds, part| bounds.union(part.shape.bounds()))
    }

    fn bounds(&self) -> Aabb {
        let corners = self.local_bounds().corners();
        corners.iter().fold(Aabb::EMPTY, |b, c| b.with(self.street_from_thing.transform_point(*c)))
    }
}

impl World {
    pub(super) fn new(things: Vec<Thing>) -> Self {
        let mut leaves: Vec<(usize, Aabb)> = things.iter().map(Thing::bounds).enumerate().collect();
        let things = things.into_iter().map(|t| (t.street_from_thing.inverse(), t)).map(|(i, t)| (t, i));
        let mut world = Self { things: things.collect(), nodes: Vec::new() };
        if !leaves.is_empty() {
            world.grow(&mut leaves);
        }
        world
    }

    /// Adds the tree of some leaves and tells its root, which is the last node.
    fn grow(&mut self, leaves: &mut [(usize, Aabb)]) -> usize {
        let bounds = leaves.iter().fold(Aabb::EMPTY, |b, (_, leaf)| b.union(*leaf));
        let kind = if let [(thing, _)] = leaves {
            NodeKind::Leaf(*thing)
        } else {
            let size = bounds.max - bounds.min;
            let axis = usize::from(size.y > size.x);
            leaves.sort_by(|(_, a), (_, b)| (a.min + a.max)[axis].total_cmp(&(b.min + b.max)[axis]));
            let (low, high) = leaves.split_at_mut(leaves.len() / 2);
            NodeKind::Fork(self.grow(low), self.grow(high))
        };
        self.nodes.push(Node { bounds, kind });
        self.nodes.len() - 1
    }

    /// The nearest hit before `t_max`.
    pub(super) fn cast(&self, ray: &Ray, t_max: f64) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.walk(ray, t_max, |thing, local_ray, t_max| {
            for part in &thing.parts {
                let limit = best.map_or(t_max, |b| b.t);
                let Some((t, normal)) = part.shape.hit(local_ray).filter(|(t, _)| *t < limit) else {
                    continue;
                };
                let local_normal = normal.normalize();
                let normal = thing.street_from_thing.rotation * local_normal;
                let (local, material) = (local_ray.at(t), part.material);
                best = Some(Hit { t, normal, local, local_normal, material });
            }
            best.map_or(t_max, |b| b.t)
        });
        best
    }

    /// Whether anything stands in a ray's way.
    pub(super) fn blocks(&self, ray: &Ray) -> bool {
        let mut blocked = false;
        self.walk(ray, f64::INFINITY, |thing, local_ray, t_max| {
            blocked |= thing.parts.iter().any(|part| part.shape.hit(local_ray).is_some());
            if blocked { f64::NEG_INFINITY } else { t_max }
        });
        blocked
    }

    /// Visits the things whose bounds a ray reaches before the distance that the last visit told.
    fn walk(&self, ray: &Ray, mut t_max: f64, mut visit: impl FnMut(&Thing, &Ray, f64) -> f64) {
        let inverse = ray.dir.recip();
        let mut stack = [0; 64];
        let mut depth = 0;
        let mut next = self.nodes.len().checked_sub(1);
        while let Some(index) = next {
            let node = &self.nodes[index];
            next = None;
            if node.bounds.reached(ray.origin, inverse, t_max) {
                match node.kind {
                    NodeKind::Leaf(thing) => {
                        let (thing, thing_from_street) = &self.things[thing];
                        let origin = thing_from_street.transform_point(ray.origin);
                        let local = Ray { origin, dir: thing_from_street.rotation * ray.dir };
                        t_max = visit(thing, &local, t_max);
                    }
                    NodeKind::Fork(low, high) => {
                        // Halving keeps the tree far below 64 levels.
                        stack[depth] = high;
                        depth += 1;
                        next = Some(low);
                    }
                }
            }
            if next.is_none() && depth > 0 {
                depth -= 1;
                next = Some(stack[depth]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::town::hash::between;

    #[test]
    fn the_tree_finds_what_a_full_search_finds() {
        let things: Vec<Thing> = (0..60)
            .map(|i| {
                let at = |k, low, high| between(5, &[i, k], low, high);
                let place = DVec3::new(at(0, -40.0, 40.0), at(1, -20.0, 20.0), at(2, 0.0, 3.0));
                let shape = Shape::block(DVec3::splat(-at(3, 0.2, 1.5)), DVec3::splat(at(4, 0.2, 1.5)));
                let parts = vec![Part { shape, material: Material::Tyre }];
                Thing { street_from_thing: Pose::from_yaw(at(5, 0.0, 3.0), place), parts }
            })
            .collect();
        let world = World::new(things.clone());
        let alone: Vec<World> = things.into_iter().map(|t| World::new(vec![t])).collect();
        let mut hits = 0;
        for i in 0..500 {
            let at = |k| between(9, &[i, k], -1.0, 1.0);
            let ray = Ray {
                origin: DVec3::new(at(0), at(1), 1.0 + at(2)),
                dir: DVec3::new(at(3), at(4), 0.1 * at(5)),
            };
            let found = world.cast(&ray, f64::INFINITY);
            let each = alone.iter().filter_map(|w| w.cast(&ray, f64::INFINITY));
            let nearest = each.min_by(|a, b| a.t.total_cmp(&b.t));
            assert_eq!(found.map(|h| h.t), nearest.map(|h| h.t));
            assert_eq!(world.blocks(&ray), nearest.is_some());
            hits += usize::from(nearest.is_some());
        }
        assert!(hits > 100);
    }
}
