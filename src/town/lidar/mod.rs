//! The LiDAR: a turn of beams among triangles, while ego and actors move.
//!
//! # How it works
//! A column of beams is fired at once, columns one after the other, clockwise from behind, the last one at the sweep's
//! time stamp. Each column stands where the LiDAR is at its own time and meets actors where they are then. Points are
//! told in the LiDAR's frame at the stamp: the ego's own motion is taken out, as data sets do it, the motion of the
//! actors is not. The standing town is one tree of triangles (`solid`); bodies have trees of their own, and a column
//! asks only those that it may reach. What comes back of a beam says `echo`.

mod echo;
mod solid;

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use self::echo::{Noise, echo};
use self::solid::{Hit, Solid};
use super::mesh::Mesh;
use super::model::Body;
use super::plan::Motion;
use crate::dataset::SweepPoint;
use crate::geometry::Pose;

/// Nearest and farthest return, metres.
pub(super) const RANGE_M: [f64; 2] = [0.9, 100.0];

/// A spinning LiDAR.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lidar {
    pub(super) beams: u16,
    /// A turn, seconds.
    pub(super) turn_s: f64,
    pub(super) columns: usize,
    /// Of the lowest and the highest beam, radians; the others lie evenly between.
    elevation_rad: [f64; 2],
}

/// A body at its places, in one pose of its limbs (they do not move within a turn).
pub(super) struct Mover<'a> {
    pub(super) body: Body,
    pub(super) limbs: usize,
    /// `town_from_body` by time.
    pub(super) motion: &'a Motion,
}

/// All that beams can meet.
pub(super) struct Scanner {
    standing: Solid,
    bodies: BTreeMap<(Body, usize), Solid>,
}

/// One turn.
pub(super) struct Turn<'a, F> {
    pub(super) lidar: Lidar,
    /// Time of the last column, seconds.
    pub(super) end_s: f64,
    /// `town_from_lidar` at a time in seconds; the LiDAR looks forward along x.
    pub(super) town_from_lidar: F,
    pub(super) movers: &'a [Mover<'a>],
    /// `None` for exact ranges of every beam.
    pub(super) seed: Option<u64>,
}

impl Lidar {
    /// Of 32 (as Velodyne's HDL-32E) or 64 beams (as its HDL-64E), at so many turns a second.
    pub(super) fn new(beams: u16, turns_hz: f64) -> Self {
        let elevation_deg: [f64; 2] = if beams == 32 { [-30.67, 10.67] } else { [-24.9, 2.0] };
        // A fifth or a third of a degree.
        let columns = if turns_hz > 15.0 { 1080 } else { 1800 };
        Self { beams, turn_s: 1.0 / turns_hz, columns, elevation_rad: elevation_deg.map(f64::to_radians) }
    }

    /// Azimuth to the left of forward (radians) of a column, and its time before the end of the turn (seconds).
    fn column(&self, index: usize) -> (f64, f64) {
        let share = (index + 1) as f64 / self.columns as f64;
        (PI - TAU * share, self.turn_s * (1.0 - share))
    }

    /// Unit direction of a beam in the LiDAR's frame.
    fn direction(&self, ring: u16, azimuth_rad: f64) -> DVec3 {
        let share = f64::from(ring) / f64::from(self.beams - 1);
        let elevation = self.elevation_rad[0] + (self.elevation_rad[1] - self.elevation_rad[0]) * share;
        (DVec2::from_angle(azimuth_rad) * elevation.cos()).extend(elevation.sin())
    }
}

impl Scanner {
    pub(super) fn new(standing: &[Mesh], bodies: &BTreeMap<(Body, usize), Mesh>) -> Self {
        let bodies = bodies.par_iter().map(|(key, mesh)| (*key, Solid::new([mesh]))).collect();
        Self { standing: Solid::new(standing), bodies }
    }

    /// The points of a turn, column by column, from the lowest beam up.
    pub(super) fn sweep<F: Fn(f64) -> Pose + Sync>(&self, turn: &Turn<'_, F>) -> Vec<SweepPoint> {
        let lidar_from_town = (turn.town_from_lidar)(turn.end_s).inverse();
        let columns = (0..turn.lidar.columns).into_par_iter();
        columns.flat_map_iter(|column| self.column(turn, column, &lidar_from_town)).collect()
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

    /// Bodies that a column may reach, with `body_from_town`.
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

    /// The nearest of all, and the cosine of the angle at which the beam meets it.
    fn meet(&self, near: &[(&Solid, Pose)], origin: DVec3, direction: DVec3) -> Option<(Hit, f64)> {
        let own = self.standing.meet(origin, direction, RANGE_M[1]);
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
