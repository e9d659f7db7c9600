//! LiDAR simulation: casts the beams of a rotation against triangles, while ego and actors move.
//!
//! # How it works
//! All beams of a column fire at once. Columns follow one another clockwise from behind, the last one at the
//! sweep's time stamp. Each column uses the poses of LiDAR and actors at its own time. Points are in the
//! LiDAR's frame at the stamp: the ego's motion is compensated, as in data sets, the actors' motion is not.
//! The static town is one tree of triangles (`solid`); bodies have their own trees, and a column tests only
//! those in its reach. `echo` computes the return of a beam.

mod echo;
mod solid;

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};
use point_skeleton::dataset::SweepPoint;
use point_skeleton::geometry::Pose;
use rayon::prelude::*;

use self::echo::{Noise, echo};
use self::solid::{Hit, Solid};
use super::mesh::Mesh;
use super::model::Body;
use super::plan::Motion;

/// Minimum and maximum range of a return, meters.
pub(super) const RANGE_M: [f64; 2] = [0.9, 100.0];

/// Spinning LiDAR.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lidar {
    pub(super) beams: u16,
    /// Duration of a rotation, seconds.
    pub(super) turn_s: f64,
    pub(super) columns: usize,
    /// Elevations of the lowest and the highest beam, radians; the others are evenly spaced between.
    elevation_rad: [f64; 2],
}

/// Moving body in one pose of its limbs, which is fixed during a rotation.
pub(super) struct Mover<'a> {
    pub(super) body: Body,
    pub(super) limbs: usize,
    /// `town_from_body` over time.
    pub(super) motion: &'a Motion,
}

/// Ray-casting structures of the static town and of all bodies.
pub(super) struct Scanner {
    static_meshes: Solid,
    bodies: BTreeMap<(Body, usize), Solid>,
}

/// Where a ray meets a town.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TownHit {
    /// Meters along the ray: no noise.
    pub range_m: f64,
    /// Cosine of the angle between the ray and the surface's normal, 0 to 1.
    pub facing: f64,
    /// Whether the surface is glass, of which most beams of a sweep have no return.
    pub is_glass: bool,
}

/// One rotation.
pub(super) struct Turn<'a, F> {
    pub(super) lidar: Lidar,
    /// Time of the last column, seconds.
    pub(super) end_s: f64,
    /// `town_from_lidar` at a time in seconds; the LiDAR looks forward along x.
    pub(super) town_from_lidar: F,
    pub(super) movers: &'a [Mover<'a>],
    /// Seed of the noise; `None` for exact ranges of every beam.
    pub(super) seed: Option<u64>,
}

impl Lidar {
    /// Creates a LiDAR with 32 (as Velodyne's HDL-32E) or 64 beams (as its HDL-64E) and a rotation rate in
    /// Hz.
    pub(super) fn new(beams: u16, turns_hz: f64) -> Self {
        let elevation_deg: [f64; 2] = if beams == 32 { [-30.67, 10.67] } else { [-24.9, 2.0] };
        // A column every third or fifth of a degree.
        let columns = if turns_hz > 15.0 { 1080 } else { 1800 };
        Self { beams, turn_s: 1.0 / turns_hz, columns, elevation_rad: elevation_deg.map(f64::to_radians) }
    }

    /// Returns the azimuth of a column to the left of forward (radians), and its time before the end of the
    /// rotation (seconds).
    fn column(&self, index: usize) -> (f64, f64) {
        let share = (index + 1) as f64 / self.columns as f64;
        (PI - TAU * share, self.turn_s * (1.0 - share))
    }

    /// Returns the unit direction of a beam in the LiDAR's frame.
    fn direction(&self, ring: u16, azimuth_rad: f64) -> DVec3 {
        let share = f64::from(ring) / f64::from(self.beams - 1);
        let elevation = self.elevation_rad[0] + (self.elevation_rad[1] - self.elevation_rad[0]) * share;
        (DVec2::from_angle(azimuth_rad) * elevation.cos()).extend(elevation.sin())
    }
}

impl Scanner {
    /// Creates a scanner. In one thread: it is called by the first of several jobs, for which the others
    /// wait.
    pub(super) fn new(static_meshes: &[Mesh], bodies: &BTreeMap<(Body, usize), Mesh>) -> Self {
        let bodies = bodies.iter().map(|(key, mesh)| (*key, Solid::new([mesh]))).collect();
        Self { static_meshes: Solid::new(static_meshes), bodies }
    }

    /// Returns the points of a rotation, column by column, from the lowest beam up.
    pub(super) fn sweep<F: Fn(f64) -> Pose + Sync>(&self, turn: &Turn<'_, F>) -> Vec<SweepPoint> {
        let lidar_from_town = (turn.town_from_lidar)(turn.end_s).inverse();
        let columns = (0..turn.lidar.columns).into_par_iter();
        columns.flat_map_iter(|column| self.column(turn, column, &lidar_from_town)).collect()
    }

    /// Returns where a ray in the town's frame meets a surface at a time in seconds; `None` without one
    /// within [`RANGE_M`].
    pub(super) fn hit(
        &self,
        movers: &[Mover<'_>],
        t_s: f64,
        origin: DVec3,
        direction: DVec3,
    ) -> Option<TownHit> {
        let near = self.in_reach(movers, t_s, origin, direction);
        let (hit, facing) = self.meet(&near, origin, direction)?;
        let hit = TownHit { range_m: hit.t, facing: facing.abs(), is_glass: echo::is_glass(&hit) };
        (hit.range_m >= RANGE_M[0]).then_some(hit)
    }

    fn column<F: Fn(f64) -> Pose>(
        &self,
        turn: &Turn<'_, F>,
        index: usize,
        lidar_from_town: &Pose,
    ) -> Vec<SweepPoint> {
        let (azimuth_rad, before_s) = turn.lidar.column(index);
        let t_s = turn.end_s - before_s;
        let town_from_lidar = (turn.town_from_lidar)(t_s);
        let origin = town_from_lidar.translation;
        let ahead = town_from_lidar.rotation * DVec2::from_angle(azimuth_rad).extend(0.0);
        let near = self.in_reach(turn.movers, t_s, origin, ahead);
        let point = |ring: u16| {
            let direction = town_from_lidar.rotation * turn.lidar.direction(ring, azimuth_rad);
            let (hit, facing) = self.meet(&near, origin, direction)?;
            let beam = index as i64 * i64::from(turn.lidar.beams) + i64::from(ring);
            let noise = turn.seed.map_or(Noise::None, Noise::Seeded);
            let (range_m, intensity) = echo(&hit, facing, noise, beam)?;
            let at = lidar_from_town.transform_point(origin + direction * range_m);
            let position = at.as_vec3().to_array();
            (hit.t >= RANGE_M[0]).then_some(SweepPoint { position, intensity, ring })
        };
        (0..turn.lidar.beams).filter_map(point).collect()
    }

    /// Returns the bodies that a column may reach, with `body_from_town`.
    fn in_reach(&self, movers: &[Mover<'_>], t_s: f64, origin: DVec3, ahead: DVec3) -> Vec<(&Solid, Pose)> {
        let ahead = ahead.truncate().normalize_or_zero();
        let reach = |mover: &Mover<'_>| {
            let solid = self.bodies.get(&(mover.body, mover.limbs))?;
            let town_from_body = mover.motion.pose(t_s);
            let (middle, radius_m) = solid.ball;
            let to = (town_from_body.transform_point(middle) - origin).truncate();
            let along_m = ahead.dot(to);
            let meets = along_m > -radius_m
                && along_m < RANGE_M[1] + radius_m
                && ahead.perp_dot(to).abs() <= radius_m;
            meets.then(|| (solid, town_from_body.inverse()))
        };
        movers.iter().filter_map(reach).collect()
    }

    /// Returns the nearest hit, and the cosine of the angle between beam and normal.
    fn meet(&self, near: &[(&Solid, Pose)], origin: DVec3, direction: DVec3) -> Option<(Hit, f64)> {
        let own = self.static_meshes.meet(origin, direction, RANGE_M[1]);
        let mut best = own.map(|hit| (hit, hit.normal.dot(direction)));
        for (solid, body_from_town) in near {
            let t_max = best.map_or(RANGE_M[1], |(hit, _)| hit.t);
            let (local, turned) =
                (body_from_town.transform_point(origin), body_from_town.rotation * direction);
            if let Some(hit) = solid.meet(local, turned, t_max) {
                best = Some((hit, hit.normal.dot(turned)));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests;
