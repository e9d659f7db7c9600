//! What stands along the street, and who moves on it.

use glam::DVec3;

use super::hash::{between, hash, unit};
use super::material::Material;
use super::models::{self, CYCLIST_SIZE, CarKind, WALKER_SIZE};
use super::shape::Shape;
use super::world::{Part, Thing};
use crate::geometry::Pose;

/// Half the road, metres: lanes of 3.5 m and parking of 2 m to either side.
const CURB_M: f64 = 5.5;
/// Where the houses begin, metres from the middle.
const HOUSES_M: f64 = 8.8;
/// The street's ends, metres.
const ENDS_M: [f64; 2] = [-60.0, 110.0];

const PAINTS: [[f64; 3]; 7] = [
    [0.75, 0.12, 0.12],
    [0.15, 0.28, 0.55],
    [0.86, 0.87, 0.88],
    [0.16, 0.17, 0.19],
    [0.55, 0.58, 0.60],
    [0.20, 0.40, 0.30],
    [0.85, 0.65, 0.20],
];

fn thing(parts: Vec<Part>, street_from_thing: Pose) -> Thing {
    Thing { street_from_thing, parts }
}

fn at(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::from_yaw(yaw, DVec3::new(x, y, 0.0))
}

/// Sidewalks, houses, trees, lamps.
pub(super) fn standing(seed: u64) -> Vec<Thing> {
    let mut things = Vec::new();
    for side in [-1.0, 1.0] {
        let (near, far) = (side * CURB_M, side * HOUSES_M);
        let (low, high) =
            (DVec3::new(ENDS_M[0], near.min(far), 0.0), DVec3::new(ENDS_M[1], near.max(far), 0.12));
        let part = Part { shape: Shape::block(low, high), material: Material::Sidewalk };
        things.push(thing(vec![part], Pose::IDENTITY));
        let (mut x, mut number) = (ENDS_M[0], 0);
        while x < ENDS_M[1] {
            let draw = |k: i64, low: f64, high: f64| between(seed, &[side as i64, number, k], low, high);
            let length = draw(0, 9.0, 17.0);
            let gap = if draw(1, 0.0, 1.0) < 0.25 { 2.5 } else { 0.0 };
            things.push(house(seed, [x + length / 2.0, side], length, number));
            x += length + gap;
            number += 1;
        }
        for i in 0..12 {
            let x = ENDS_M[0] + 14.0 * f64::from(i) + 3.0 * side;
            let spot = at(x, side * 6.4, if side > 0.0 { std::f64::consts::PI } else { 0.0 });
            let parts = if i % 4 == 1 {
                models::lamp()
            } else {
                models::tree(hash(seed, &[i64::from(i), side as i64]), 5.2 + unit(seed, &[i64::from(i)]))
            };
            things.push(thing(parts, spot));
        }
    }
    things
}

/// A house at `[x, side]`, in front of the sidewalk's end.
fn house(seed: u64, [x, side]: [f64; 2], length: f64, number: i64) -> Thing {
    const DEPTH_M: f64 = 9.0;
    let draw = |k: i64, low: f64, high: f64| between(seed, &[side as i64, number, k], low, high);
    let height = 3.8 + 3.1 * draw(2, 1.0, 4.0).floor() + 0.9;
    let wall = [draw(3, 0.55, 0.85), draw(4, 0.45, 0.70), draw(5, 0.38, 0.60)];
    let half = DVec3::new(length / 2.0, DEPTH_M / 2.0, 0.0);
    let shape = Shape::block(-half, half + DVec3::Z * height);
    let house_seed = hash(seed, &[side as i64, number]) >> 1;
    let material = Material::Facade { seed: house_seed, wall, height, length, depth: DEPTH_M };
    let place = Pose::from_yaw(0.0, DVec3::new(x, side * (HOUSES_M + DEPTH_M / 2.0), 0.0));
    thing(vec![Part { shape, material }], place)
}

/// Somebody or something with a box.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    /// Track id.
    pub(super) id: String,
    /// Category name as nuScenes has it.
    pub(super) category: &'static str,
    /// Length, width, height of the box, metres.
    pub(super) size: DVec3,
    kind: Kind,
    /// Where it stands at time 0, street frame.
    start: DVec3,
    yaw: f64,
    /// Metres per second along its heading.
    pub(super) speed: f64,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Car(CarKind, [f64; 3]),
    Walker([f64; 3], [f64; 3]),
    Cyclist([f64; 3]),
    Cone,
}

impl Actor {
    /// `street_from_actor` on the ground at a time, seconds.
    pub(super) fn pose(&self, t_s: f64) -> Pose {
        let heading = DVec3::new(self.yaw.cos(), self.yaw.sin(), 0.0);
        Pose::from_yaw(self.yaw, self.start + heading * (self.speed * t_s))
    }

    /// Its parts at a time; people move their limbs.
    pub(super) fn thing(&self, t_s: f64) -> Thing {
        let phase = 4.2 * self.speed * t_s;
        let parts = match self.kind {
            Kind::Car(kind, paint) => models::car(kind, paint),
            Kind::Walker(coat, trousers) => models::walker(phase, coat, trousers),
            Kind::Cyclist(jersey) => models::cyclist(phase, jersey),
            Kind::Cone => models::cone(),
        };
        thing(parts, self.pose(t_s))
    }
}

/// Parked and moving cars, people, a cyclist, cones.
pub(super) fn actors(seed: u64) -> Vec<Actor> {
    let mut actors = Vec::new();
    let mut add = |category, size, kind, start: [f64; 3], yaw, speed| {
        // As long as a token of nuScenes.
        let id = format!("{:032x}", actors.len() + 1);
        actors.push(Actor { id, category, size, kind, start: start.into(), yaw, speed });
    };
    let back = std::f64::consts::PI;
    for (side, yaw) in [(-1.0, 0.0), (1.0, back)] {
        for slot in 0..9 {
            let draw = |k: i64| unit(seed, &[900, side as i64, slot, k]);
            if draw(0) < 0.3 {
                continue;
            }
            let kind = [CarKind::Sedan, CarKind::Suv, CarKind::Van][(draw(1) * 2.6) as usize];
            let paint = PAINTS[(draw(2) * 7.0) as usize];
            let x = -18.0 + 6.6 * slot as f64 + draw(3);
            // Nobody parks on the crossing.
            if !(20.0..31.0).contains(&x) {
                add("vehicle.car", kind.size(), Kind::Car(kind, paint), [x, side * 4.5, 0.0], yaw, 0.0);
            }
        }
    }
    let (sedan, suv) = (CarKind::Sedan, CarKind::Suv);
    add("vehicle.car", suv.size(), Kind::Car(suv, PAINTS[2]), [13.0, -1.75, 0.0], 0.0, 5.5);
    add("vehicle.car", sedan.size(), Kind::Car(sedan, PAINTS[0]), [38.0, 1.75, 0.0], back, 7.0);
    let (coat, trousers) = ([0.62, 0.18, 0.20], [0.20, 0.22, 0.30]);
    let walker = "human.pedestrian.adult";
    add(walker, WALKER_SIZE, Kind::Walker(coat, trousers), [8.0, -7.4, 0.12], 0.0, 1.4);
    add(walker, WALKER_SIZE, Kind::Walker([0.25, 0.35, 0.2], trousers), [17.0, 7.2, 0.12], back, 1.2);
    add("vehicle.bicycle", CYCLIST_SIZE, Kind::Cyclist([0.9, 0.75, 0.1]), [7.0, 2.9, 0.0], back, 3.0);
    let size = DVec3::new(0.42, 0.42, 0.72);
    for i in 0..3 {
        let x = 21.0 + 0.9 * f64::from(i);
        add("movable_object.trafficcone", size, Kind::Cone, [x, -4.0 - 0.3 * f64::from(i), 0.0], 0.0, 0.0);
    }
    actors
}
