//! Traffic: motion of vehicles and pedestrians, and parked vehicles.
//!
//! # How it works
//! The ego's start is chosen first ([`start`]). Vehicles around it and walkers are simulated for some seconds
//! before time 0, so that queues have formed when the recording begins ([`world`], [`walker`]). At time 0 the
//! ego and some vehicles around it are added. From then on all motion is recorded. Parked vehicles are placed
//! in the parking strips ([`park`]).

mod bodies;
mod clash;
mod footprint;
mod junction_path;
mod lanes;
mod park;
mod pavement;
mod people;
mod route;
mod start;
#[cfg(test)]
mod tests;
mod vehicle;
mod walker;
mod world;

use glam::{DVec2, DVec3};
use point_skeleton::geometry::{Footprint, Pose};

use self::bodies::Bodies;
use self::footprint::of_pose;
use self::lanes::Lanes;
use self::people::People;
use self::start::{EGO_AHEAD_M, EGO_M, Start};
use self::vehicle::Vehicle;
use self::walker::Walker;
use self::world::{STEP_S, World};
use super::Network;
use super::line::polyline;
use super::random::Random;
use crate::model::Body;

/// Simulated time before time 0, seconds.
const SETTLES_S: f64 = 12.0;

/// Motion of the ego and of all actors.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// Motion of the recording car: pose on the ground below the middle of its rear axle.
    pub ego: Motion,
    /// All other actors, sorted by id.
    pub actors: Vec<Actor>,
}

/// Vehicle, pedestrian or object with a box.
#[derive(Clone, Debug)]
pub struct Actor {
    /// Track id, 32 hexadecimal digits.
    pub id: String,
    /// Body that it is rendered with.
    pub body: Body,
    /// `town_from_actor`: pose on the ground below the middle of its box.
    pub motion: Motion,
}

/// Poses every 0.1 s from time 0 on; a static actor may have a single one.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Pose at each step.
    pub poses: Vec<Pose>,
    /// Distance from the start at each step, meters; selects the pose of legs.
    pub travelled_m: Vec<f64>,
}

impl Motion {
    /// Returns the interpolated pose at a time in seconds, clamped to the recorded range.
    pub fn pose(&self, t_s: f64) -> Pose {
        let (i, share) = self.place(t_s);
        let next = (i + 1).min(self.poses.len() - 1);
        self.poses[i].interpolate(&self.poses[next], share)
    }

    /// Returns the distance from the start at a time in seconds, meters.
    pub fn travelled_m(&self, t_s: f64) -> f64 {
        let (i, share) = self.place(t_s);
        let next = (i + 1).min(self.travelled_m.len() - 1);
        self.travelled_m[i] + (self.travelled_m[next] - self.travelled_m[i]) * share
    }

    fn place(&self, t_s: f64) -> (usize, f64) {
        let last = (self.poses.len() - 1) as f64;
        let at = (t_s / STEP_S).clamp(0.0, last);
        (at.floor() as usize, at.fract())
    }

    fn push(&mut self, pose: Pose, travelled_m: f64) {
        self.poses.push(pose);
        self.travelled_m.push(travelled_m);
    }
}

impl Traffic {
    /// Simulates the traffic of a town for a duration in seconds.
    pub fn new(network: &Network, seed: u64, duration_s: f64) -> Self {
        Self::draw(network, seed, duration_s).0
    }

    /// Returns the traffic, and the number of actors removed because they would have overlapped another.
    fn draw(network: &Network, seed: u64, duration_s: f64) -> (Self, usize) {
        let lanes = Lanes::new(network);
        let bodies = Bodies::new(seed);
        let random = |purpose| Random::new(seed, purpose, 0);
        let whole_s = SETTLES_S + duration_s;
        let mut start =
            Start { lanes: &lanes, bodies: &bodies, random: random("vehicles"), duration_s: whole_s };
        let ego = start.ego();
        let drive = drive(&ego, duration_s);
        let mut world = World::new(&lanes, -SETTLES_S);
        world.vehicles = start.around(&drive);
        let people = People { network, bodies: &bodies, random: random("people"), duration_s: whole_s };
        let mut walkers = { people }.around(&drive);
        let parked = park::parked(network, &bodies, &drive, &mut random("parked"));

        while world.t_s < -STEP_S / 2.0 {
            walker::step(&mut walkers, &mut world);
            world.step();
        }
        start.join(&mut world, ego);
        world.t_s = 0.0;
        let motions = record(&mut world, &mut walkers, duration_s);
        let mut movers: Vec<(Body, Motion)> = Vec::new();
        let mut ego = Motion::default();
        let bodies = world.vehicles.iter().map(|v| v.body).chain(walkers.iter().map(|w| Some(w.body)));
        for (body, motion) in bodies.zip(motions) {
            match body {
                Some(body) => movers.push((body, motion)),
                None => ego = motion,
            }
        }
        let stand = |(body, pose)| (body, Motion { poses: vec![pose], travelled_m: vec![0.0] });
        movers.extend(parked.into_iter().map(stand));
        let all = movers.len();
        keep_apart(&ego, &mut movers);
        let dropped = all - movers.len();
        let actor = |(i, (body, motion))| Actor { id: id(seed, i), body, motion };
        let mut actors: Vec<Actor> = movers.into_iter().enumerate().map(actor).collect();
        actors.sort_by(|a, b| a.id.cmp(&b.id));
        (Self { ego, actors }, dropped)
    }
}

/// Returns points every 15 m along the route that the ego is expected to drive.
fn drive(ego: &Vehicle, duration_s: f64) -> Vec<DVec2> {
    let length_m = (ego.driver.free_mps * duration_s).min(ego.route.length_m() - ego.along_m).max(1.0);
    polyline(&ego.route.path.part(ego.along_m, ego.along_m + length_m)).resampled(15.0)
}

/// Simulates some seconds and records all motion: vehicles, then walkers.
fn record(world: &mut World<'_>, walkers: &mut [Walker], duration_s: f64) -> Vec<Motion> {
    let steps = (duration_s.max(0.0) / STEP_S).ceil() as usize;
    let mut motions = vec![Motion::default(); world.vehicles.len() + walkers.len()];
    for vehicle in &mut world.vehicles {
        vehicle.began_m = vehicle.along_m;
    }
    let began_m: Vec<f64> = walkers.iter().map(|walker| walker.along_m).collect();
    for step in 0..=steps {
        for (motion, vehicle) in motions.iter_mut().zip(&world.vehicles) {
            let pose = match vehicle.body {
                Some(_) => vehicle.pose(),
                None => vehicle.pose_behind(EGO_AHEAD_M),
            };
            motion.push(pose, vehicle.along_m - vehicle.began_m);
        }
        let of_walkers = motions.iter_mut().skip(world.vehicles.len());
        for ((motion, walker), began_m) in of_walkers.zip(walkers.iter()).zip(&began_m) {
            motion.push(walker.pose(), walker.along_m - began_m);
        }
        if step < steps {
            walker::step(walkers, world);
            world.step();
        }
    }
    motions
}

/// Removes actors that ever overlap an earlier actor or the ego; a last resort.
fn keep_apart(ego: &Motion, movers: &mut Vec<(Body, Motion)>) {
    let ego_at = |pose: &Pose| {
        let middle = pose.transform_point(DVec3::X * EGO_AHEAD_M);
        of_pose(&Pose { translation: middle, ..*pose }, EGO_M)
    };
    let mut swept = vec![Swept::new(ego.poses.iter().map(ego_at).collect())];
    movers.retain(|(body, motion)| {
        let size_m = body.size_m().truncate();
        let own = Swept::new(motion.poses.iter().map(|pose| of_pose(pose, size_m)).collect());
        let alone = !swept.iter().any(|other| own.meets(other));
        if alone {
            swept.push(own);
        }
        alone
    });
}

/// Boxes of an actor over time; a single one if it is static.
struct Swept {
    rects: Vec<Footprint>,
    min: DVec2,
    max: DVec2,
}

impl Swept {
    fn new(rects: Vec<Footprint>) -> Self {
        let middles = || rects.iter().map(|rect| rect.center);
        let reach = DVec2::splat(rects.first().map_or(0.0, |rect| rect.half_m.length()));
        let min = middles().fold(DVec2::INFINITY, DVec2::min) - reach;
        let max = middles().fold(DVec2::NEG_INFINITY, DVec2::max) + reach;
        Self { rects, min, max }
    }

    fn meets(&self, other: &Self) -> bool {
        let near = self.min.cmple(other.max).all() && other.min.cmple(self.max).all();
        let steps = self.rects.len().max(other.rects.len());
        let at = |rects: &[Footprint], step: usize| rects[step.min(rects.len() - 1)];
        near && (0..steps).any(|step| at(&self.rects, step).overlaps(&at(&other.rects, step)))
    }
}

/// Returns a track id that depends only on the seed and a number.
fn id(seed: u64, number: usize) -> String {
    let mut random = Random::new(seed, "track", number as u64);
    format!("{:016x}{:016x}", random.bits(), random.bits())
}
