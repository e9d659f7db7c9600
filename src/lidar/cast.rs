//! Rays against the solids of a scene.

use glam::{DMat3, DVec3};

use super::bodies::Bodies;
use super::fan::Fan;
use super::rays::{LidarHit, LidarRays};
use super::search::{Hit, Search};
use super::solids::Solids;

/// Returns the first surface of bodies that each ray meets up to a range.
pub(super) fn cast(
    rays: &LidarRays,
    bodies: &Bodies,
    solids: &Solids<'_>,
    far_m: f64,
) -> Vec<Option<LidarHit>> {
    let fan = Fan::of(rays.directions.iter().copied());
    let candidates = bodies.candidates(rays, &fan, solids);
    let mut far: Vec<f32> = vec![far_m as f32; rays.directions.len()];
    let mut found = vec![None; far.len()];
    let (mut search, mut searched) = (Search::default(), Vec::with_capacity(far.len()));
    for candidate in &candidates {
        searched.clear();
        searched.extend(far.iter().map(|far| if candidate.near_m > *far { -1.0 } else { *far }));
        if searched.iter().all(|far| *far < 0.0) {
            break;
        }
        let frame = candidate.local_from_world;
        let origin = frame.transform_point3(rays.origin);
        let is_turned = frame.matrix3 != DMat3::IDENTITY;
        let turned = is_turned.then(|| fan.turned(frame.matrix3));
        let fan = turned.as_ref().unwrap_or(&fan);
        search.start(fan, &searched);
        candidate.solid.meet(origin.as_vec3a(), fan, &mut search);
        for Hit { ray, t, class } in search.hits(fan) {
            far[ray] = t as f32;
            found[ray] = Some(LidarHit { range_m: t, class, instance: candidate.body.number });
        }
        let Some(core) = candidate.body.core else { continue };
        for ray in fan.rays_to(core, origin) {
            let number = fan.order[ray] as usize;
            let direction = fan.direction(ray).as_dvec3();
            let entered = enter(core, origin, direction).map(|t| t as f32);
            if let Some(t) = entered.filter(|t| searched[number] >= 0.0 && *t < far[number]) {
                (far[number], found[number]) = (t, None);
            }
        }
    }
    found
}

/// Returns where a ray from outside of a box enters it, in lengths of its direction.
fn enter([min, max]: [DVec3; 2], origin: DVec3, direction: DVec3) -> Option<f64> {
    let [a, b] = [min, max].map(|corner| (corner - origin) / direction);
    let (first, last) = (a.min(b).max_element(), a.max(b).min_element());
    (first > 0.0 && first < last).then_some(first)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::super::bodies::Body;
    use super::super::motion::Motion;
    use super::*;
    use crate::cloud::Point;
    use crate::dataset::Class;
    use crate::geometry::{Cuboid, Pose};
    use crate::raster::Instance;
    use crate::scene::{ActorState, SceneState};

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
        let bodies = vec![
            Body::new(&instance(0, 0), &solids.bounds(0).unwrap(), None),
            Body::new(&instance(1, 1), &solids.bounds(1).unwrap(), Some((&now.actors[0], paths[0]))),
        ];
        let rays = LidarRays { after_s, origin, directions: directions.to_vec() };
        let bodies = Bodies::of(bodies, std::slice::from_ref(&rays));
        cast(&rays, &bodies, &solids, 50.0)
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
