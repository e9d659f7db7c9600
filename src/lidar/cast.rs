//! Rays against the solids of a scene.

use glam::{DAffine3, DMat3, DVec3};

use super::fan::Fan;
use super::motion::ActorPath;
use super::solid::{Hit, Solid};
use super::solids::Solids;
use crate::cloud::Bounds;
use crate::dataset::Class;
use crate::raster::Instance;
use crate::scene::ActorState;

/// What surfaces may extend beyond the bounds of their points, meters.
const BEYOND_M: f64 = 0.1;

/// Rays of an instant from a point: a column of a device, for example.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarRays {
    /// Time after the state's, seconds.
    pub after_s: f64,
    /// Meters, global frame.
    pub origin: DVec3,
    /// Unit vectors, global frame. Casting is fast if all are near a half-plane.
    pub directions: Vec<DVec3>,
}

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarHit {
    /// Meters along the ray.
    pub range_m: f64,
    /// Coarse class, as in class maps.
    pub class: u8,
    /// Actor number, as in instance maps.
    pub instance: u32,
}

/// Part of a vehicle's box that is inside of every vehicle, from -1 to 1 along its axes: from door to door,
/// and from the floor to the height of the seats.
const CORE: [DVec3; 2] = [DVec3::new(-0.85, -0.8, -0.8), DVec3::new(0.85, 0.8, 0.2)];

/// A solid of the scene.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) cloud: usize,
    /// Actor number; 0 for the background.
    number: u32,
    /// Pose of an actor's cloud in the actor's box; of the background's in the global frame.
    parent_from_local: DAffine3,
    path: Option<ActorPath>,
    /// Center and half size of the bounds, meters, in the cloud's frame.
    center: DVec3,
    half: DVec3,
    /// Inside of a vehicle: no ray passes it.
    core: Option<[DVec3; 2]>,
}

/// A body that rays may meet.
struct Candidate<'b> {
    number: u32,
    solid: &'b Solid,
    local_from_world: DAffine3,
    core: Option<[DVec3; 2]>,
    /// Least range at which it can be met, meters.
    near_m: f32,
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
}

/// Returns the first surface of bodies that each ray meets up to a range.
pub(super) fn cast(
    rays: &LidarRays,
    bodies: &[Body],
    solids: &Solids<'_>,
    far_m: f64,
) -> Vec<Option<LidarHit>> {
    let fan = Fan::of(rays.directions.iter().copied());
    let candidate = |body| candidate(body, rays, &fan, solids);
    let mut candidates: Vec<Candidate<'_>> = bodies.iter().filter_map(candidate).collect();
    candidates.sort_by(|a, b| a.near_m.total_cmp(&b.near_m));
    let mut far: Vec<f32> = vec![far_m as f32; rays.directions.len()];
    let mut found = vec![None; far.len()];
    for candidate in &candidates {
        let searched: Vec<f32> =
            far.iter().map(|far| if candidate.near_m > *far { -1.0 } else { *far }).collect();
        if searched.iter().all(|far| *far < 0.0) {
            break;
        }
        let frame = candidate.local_from_world;
        let origin = frame.transform_point3(rays.origin);
        let is_turned = frame.matrix3 != DMat3::IDENTITY;
        let turned = || Fan::of(rays.directions.iter().map(|direction| frame.transform_vector3(*direction)));
        let turned = is_turned.then(turned);
        let fan = turned.as_ref().unwrap_or(&fan);
        for Hit { ray, t, class } in candidate.solid.meet(origin.as_vec3a(), fan, &searched) {
            far[ray] = t as f32;
            found[ray] = Some(LidarHit { range_m: t, class, instance: candidate.number });
        }
        let Some(core) = candidate.core else { continue };
        for (ray, direction) in rays.directions.iter().enumerate().filter(|(ray, _)| searched[*ray] >= 0.0) {
            let entered = enter(core, origin, frame.transform_vector3(*direction));
            if let Some(t) = entered.map(|t| t as f32).filter(|t| *t < far[ray]) {
                (far[ray], found[ray]) = (t, None);
            }
        }
    }
    found
}

/// Returns a body as a candidate; `None` if no ray can meet it.
fn candidate<'b>(body: &Body, rays: &LidarRays, fan: &Fan, solids: &'b Solids<'_>) -> Option<Candidate<'b>> {
    let solid = solids.get(body.cloud)?;
    let world_from_local = body.world_from_local(rays.after_s);
    let offset = world_from_local.transform_point3(body.center) - rays.origin;
    let near_m = fan.reach_of(offset, world_from_local.matrix3, body.half)?.near;
    let local_from_world = world_from_local.inverse();
    Some(Candidate { number: body.number, solid, local_from_world, core: body.core, near_m })
}

/// Returns where a ray from outside of a box enters it, in lengths of its direction.
fn enter([min, max]: [DVec3; 2], origin: DVec3, direction: DVec3) -> Option<f64> {
    let [a, b] = [min, max].map(|corner| (corner - origin) / direction);
    let (first, last) = (a.min(b).max_element(), a.max(b).min_element());
    (first > 0.0 && first < last).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::super::motion::Motion;
    use super::*;
    use crate::cloud::Point;
    use crate::geometry::{Cuboid, Pose};
    use crate::scene::SceneState;

    /// Points of a wall across x every 4 cm: y from -2 to 2 m, z from 0 to 2 m.
    fn wall(x: f32) -> Vec<Point> {
        let grid = (-50..=50).flat_map(|y| (0..=50).map(move |z| [y as f32 * 0.04, z as f32 * 0.04]));
        grid.map(|[y, z]| Point::new([x, y, z], [0; 3], 0)).collect()
    }

    /// The left side of a car of 4 by 2 by 1.5 m, in its frame; its right side and its roof were not seen.
    fn side() -> Vec<Point> {
        let grid = (-50..=50).flat_map(|x| (-18..=18).map(move |z| [x as f32 * 0.04, z as f32 * 0.04]));
        grid.map(|[x, z]| Point::new([x, 1.0, z], [0; 3], 1)).collect()
    }

    fn state(car_y: f64, class: Class) -> SceneState {
        let pose = Pose::from_yaw(0.0, DVec3::new(5.0, car_y, 0.75));
        let actor = ActorState {
            track: "car".into(),
            category: "vehicle.car".into(),
            class,
            cuboid: Cuboid::new(pose, DVec3::new(4.0, 2.0, 1.5)).unwrap(),
            appearance: None,
        };
        SceneState {
            name: "0".into(),
            t_us: 0,
            global_from_ego: Pose::IDENTITY,
            cameras: Vec::new(),
            actors: vec![actor],
            map: None,
        }
    }

    /// Returns what rays along x and from the side at a height of 1 m meet, a time after the state's.
    fn met(
        car_y: f64,
        class: Class,
        directions: &[DVec3],
        origin: DVec3,
        after_s: f64,
    ) -> Vec<Option<LidarHit>> {
        let (wall, side) = (wall(9.0), side());
        let mut solids = Solids::new(vec![(&wall).into(), (&side).into()]);
        let (now, mut other) = (state(car_y, class), state(car_y + 1.0, class));
        other.t_us = 100_000;
        let motion = Motion::new(&now, Some(&other));
        let instance = |cloud: usize, number: u32| Instance {
            cloud,
            world_from_local: if number == 0 {
                DAffine3::IDENTITY
            } else {
                now.actors[0].cuboid.pose.affine()
            },
            number,
        };
        solids.make([0, 1].into_iter()).unwrap();
        let paths = motion.paths();
        let bodies = [
            Body::new(&instance(0, 0), &solids.bounds(0).unwrap(), None),
            Body::new(&instance(1, 1), &solids.bounds(1).unwrap(), Some((&now.actors[0], paths[0]))),
        ];
        cast(&LidarRays { after_s, origin, directions: directions.to_vec() }, &bodies, &solids, 50.0)
    }

    #[test]
    fn rays_meet_what_is_nearest_at_their_time() {
        let (from, along) = (DVec3::new(0.0, 0.0, 1.0), [DVec3::X, DVec3::NEG_X]);
        let found = met(20.0, Class::MotorVehicle, &along, from, 0.0);
        let hit = found[0].unwrap();
        assert!((hit.range_m - 9.0).abs() < 1e-5 && found[1].is_none(), "{found:?}");
        assert_eq!((hit.class, hit.instance), (0, 0));
        // From its left, the side of the car is at y = car_y + 1, and moves 10 m/s.
        let (left, right) = (DVec3::new(5.0, 6.0, 1.0), [DVec3::NEG_Y]);
        for after_s in [0.0, 0.05] {
            let hit = met(0.0, Class::MotorVehicle, &right, left, after_s)[0].unwrap();
            let expected = 6.0 - 1.0 - after_s * 10.0;
            assert!((hit.range_m - expected).abs() < 1e-4 && (hit.class, hit.instance) == (1, 1), "{hit:?}");
        }
    }

    /// From its right, the side of a car is seen from within: rays end in a car, and pass other objects.
    #[test]
    fn no_ray_passes_a_vehicle() {
        let (right, left) = (DVec3::new(5.0, -6.0, 0.6), [DVec3::Y]);
        assert_eq!(met(0.0, Class::MotorVehicle, &left, right, 0.0), [None]);
        let hit = met(0.0, Class::Object, &left, right, 0.0)[0].unwrap();
        assert!((hit.range_m - 7.0).abs() < 1e-4 && hit.instance == 1, "{hit:?}");
        let above = met(0.0, Class::MotorVehicle, &left, DVec3::new(5.0, -6.0, 1.3), 0.0)[0].unwrap();
        assert!((above.range_m - 7.0).abs() < 1e-4, "{above:?}");
    }

    /// A fan of rays finds the same as each ray alone.
    #[test]
    fn fans_leave_no_body_out() {
        let origin = DVec3::new(0.0, 0.0, 1.0);
        let fan: Vec<DVec3> = (-40..=40)
            .map(|i| DVec3::new(1.0, 0.02 * f64::from(i % 7), f64::from(i) * 0.0025).normalize())
            .collect();
        let together = met(2.0, Class::MotorVehicle, &fan, origin, 0.0);
        let alone: Vec<_> = fan
            .iter()
            .map(|direction| met(2.0, Class::MotorVehicle, &[*direction], origin, 0.0)[0])
            .collect();
        assert!(together == alone && together.iter().flatten().count() > 20);
    }
}
