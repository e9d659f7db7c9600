use glam::DVec3;

use super::Network;
use crate::geometry::Pose;
use crate::town::model::{Body, BodyKind};

/// Seconds between the steps of a [`Motion`].
const STEP_S: f64 = 0.1;

/// Who is on the streets.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// The recording car: on the ground below the middle of its rear axle.
    pub ego: Motion,
    /// Everybody else, in the order of ids.
    pub actors: Vec<Actor>,
}

/// Somebody, or something with a box.
#[derive(Clone, Debug)]
pub struct Actor {
    /// Track id, 32 hexadecimal digits.
    pub id: String,
    /// What it looks like.
    pub body: Body,
    /// `town_from_actor`: on the ground below the middle of its box.
    pub motion: Motion,
}

/// Poses every 0.1 s from time 0 on; what stands still may have a single one.
#[derive(Clone, Debug)]
pub struct Motion {
    /// One a step.
    pub poses: Vec<Pose>,
    /// Metres from the start, one a step: where legs and wheels are.
    pub travelled_m: Vec<f64>,
}

impl Motion {
    /// At a time in seconds; beyond the ends it stands still.
    pub fn pose(&self, t_s: f64) -> Pose {
        let (i, share) = self.place(t_s);
        let next = (i + 1).min(self.poses.len() - 1);
        self.poses[i].interpolate(&self.poses[next], share)
    }

    /// Metres from the start at a time in seconds.
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

    fn straight(start: DVec3, yaw: f64, speed: f64, duration_s: f64) -> Self {
        let steps = (duration_s / STEP_S).ceil() as usize + 1;
        let travelled_m: Vec<f64> = (0..steps).map(|i| speed * STEP_S * i as f64).collect();
        let ahead = DVec3::new(yaw.cos(), yaw.sin(), 0.0);
        let poses = travelled_m.iter().map(|s| Pose::from_yaw(yaw, start + ahead * *s)).collect();
        Self { poses, travelled_m }
    }
}

impl Traffic {
    /// Who drives, walks and parks in a town for so many seconds.
    pub fn new(_network: &Network, seed: u64, duration_s: f64) -> Self {
        let ego = Motion::straight(DVec3::new(0.0, -1.75, 0.0), 0.0, 6.0, duration_s);
        let mut actors = Vec::new();
        let mut add = |kind, start, yaw, speed| {
            let motion = Motion::straight(start, yaw, speed, duration_s);
            let id = format!("{:032x}", actors.len() + 1);
            actors.push(Actor { id, body: Body { kind, seed: seed + actors.len() as u64 }, motion });
        };
        for i in 0..8 {
            add(BodyKind::Sedan, DVec3::new(8.0 * f64::from(i), -4.6, 0.0), 0.0, 0.0);
        }
        add(BodyKind::Suv, DVec3::new(60.0, 1.75, 0.0), std::f64::consts::PI, 7.0);
        add(BodyKind::Walker, DVec3::new(12.0, -7.0, super::KERB_M), 0.0, 1.3);
        Self { ego, actors }
    }
}
