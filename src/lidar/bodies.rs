//! Solids of a scene, and which of them rays may meet.

use glam::{DAffine3, DVec3};
use obvhs::aabb::Aabb;

use super::fan::Fan;
use super::motion::ActorPath;
use super::rays::LidarRays;
use super::solid::Solid;
use super::solids::Solids;
use super::tree::Tree;
use crate::cloud::Bounds;
use crate::dataset::Class;
use crate::raster::Instance;
use crate::scene::ActorState;

/// What surfaces may extend beyond the bounds of their points, meters.
const BEYOND_M: f64 = 0.1;

/// Part of a vehicle's box that is inside of every vehicle, from -1 to 1 along its axes: from door to door,
/// and from the floor to the height of the seats.
const CORE: [DVec3; 2] = [DVec3::new(-0.85, -0.8, -0.8), DVec3::new(0.85, 0.8, 0.2)];

/// A solid of the scene.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) cloud: usize,
    /// Actor number; 0 for the background.
    pub(super) number: u32,
    /// Pose of an actor's cloud in the actor's box; of the background's in the global frame.
    parent_from_local: DAffine3,
    path: Option<ActorPath>,
    /// Center and half size of the bounds, meters, in the cloud's frame.
    center: DVec3,
    half: DVec3,
    /// Inside of a vehicle: no ray passes it.
    pub(super) core: Option<[DVec3; 2]>,
}

/// The solids of a scene during some time.
pub(super) struct Bodies {
    bodies: Vec<Body>,
    /// Boxes that they do not leave during that time, from the anchor.
    tree: Tree,
    /// Meters, global frame.
    anchor: DVec3,
}

/// A body that rays may meet.
pub(super) struct Candidate<'b> {
    pub(super) body: &'b Body,
    pub(super) solid: &'b Solid,
    pub(super) local_from_world: DAffine3,
    /// Least range at which it can be met, meters.
    pub(super) near_m: f32,
}

impl Body {
    /// Creates the body of an instance with bounds, and of its actor with its path.
    pub(super) fn new(instance: &Instance, bounds: &Bounds, actor: Option<(&ActorState, ActorPath)>) -> Self {
        let [min, max] = [bounds.min, bounds.max].map(|at| DVec3::from(at.map(f64::from)));
        let parent_from_world = actor.map_or(DAffine3::IDENTITY, |(_, path)| path.at(0.0).affine().inverse());
        let parent_from_local = parent_from_world * instance.world_from_local;
        let vehicle = actor.filter(|(actor, _)| actor.class == Class::MotorVehicle);
        let core = vehicle.map(|(actor, _)| {
            let local_from_parent = parent_from_local.inverse();
            CORE.map(|corner| local_from_parent.transform_point3(corner * actor.cuboid.size / 2.0))
        });
        Self {
            cloud: instance.cloud,
            number: instance.number,
            parent_from_local,
            path: actor.map(|(_, path)| path),
            center: (min + max) / 2.0,
            half: (max - min) / 2.0 + BEYOND_M,
            core,
        }
    }

    /// Returns the pose of its cloud in the global frame, a time after the state's, seconds.
    fn world_from_local(&self, after_s: f64) -> DAffine3 {
        let Some(path) = &self.path else { return self.parent_from_local };
        path.at(after_s).affine() * self.parent_from_local
    }

    /// Returns the least distance of its bounding sphere from a point, meters.
    pub(super) fn distance_m(&self, from: DVec3, after_s: f64) -> f64 {
        let world_from_local = self.world_from_local(after_s);
        let half = world_from_local.matrix3 * self.half;
        world_from_local.transform_point3(self.center).distance(from) - half.length()
    }

    /// Returns a box that the body does not leave between two times after the state's, seconds, from a point.
    fn bounds(&self, anchor: DVec3, times_s: [f64; 2]) -> Aabb {
        let center = self.parent_from_local.transform_point3(self.center);
        let half = self.parent_from_local.matrix3.abs() * self.half;
        let bounds = |center: DVec3, half: DVec3| {
            let corners = [center - half, center + half].map(|corner| (corner - anchor).as_vec3a());
            Aabb::new(corners[0], corners[1])
        };
        let Some(path) = &self.path else { return bounds(center, half) };
        // Actors move on a line, and turn about their center.
        let radius = center.length() + half.length();
        let [from, to] = times_s.map(|after_s| bounds(path.at(after_s).translation, DVec3::splat(radius)));
        from.union(&to)
    }
}

impl Bodies {
    /// Creates the solids of a scene during the time of rays.
    pub(super) fn of(bodies: Vec<Body>, rays: &[LidarRays]) -> Self {
        let anchor = rays.first().map_or(DVec3::ZERO, |rays| rays.origin);
        let span = |[from, to]: [f64; 2], rays: &LidarRays| [from.min(rays.after_s), to.max(rays.after_s)];
        let times_s = rays.iter().fold([f64::INFINITY, f64::NEG_INFINITY], span);
        let boxes: Vec<Aabb> = bodies.iter().map(|body| body.bounds(anchor, times_s)).collect();
        let (tree, order) = Tree::of(&boxes);
        let bodies = order.into_iter().map(|number| bodies[number as usize].clone()).collect();
        Self { bodies, tree, anchor }
    }

    /// Returns the bodies that rays may meet, the nearest first.
    pub(super) fn candidates<'b>(
        &'b self,
        rays: &LidarRays,
        fan: &Fan,
        solids: &'b Solids<'_>,
    ) -> Vec<Candidate<'b>> {
        let origin = (rays.origin - self.anchor).as_vec3a();
        let (mut left, mut found) = (self.tree.start(origin, fan), Vec::new());
        while let Some(visit) = left.pop() {
            match visit.branch.piece() {
                Some(body) => found.extend(self.candidate(body, rays, fan, solids)),
                None => self.tree.branch(visit.branch, origin, fan, &mut left),
            }
        }
        found.sort_by(|a, b| a.near_m.total_cmp(&b.near_m));
        found
    }

    fn candidate<'b>(
        &'b self,
        body: usize,
        rays: &LidarRays,
        fan: &Fan,
        solids: &'b Solids<'_>,
    ) -> Option<Candidate<'b>> {
        let body = &self.bodies[body];
        let solid = solids.get(body.cloud)?;
        let world_from_local = body.world_from_local(rays.after_s);
        let offset = world_from_local.transform_point3(body.center) - rays.origin;
        let near_m = fan.near(offset, world_from_local.matrix3, body.half)?;
        Some(Candidate { body, solid, local_from_world: world_from_local.inverse(), near_m })
    }
}
