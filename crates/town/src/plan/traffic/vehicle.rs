use glam::{DVec2, DVec3};
use point_skeleton::geometry::{Footprint, Pose};
use point_skeleton::idm::{Idm, Leader};

use super::footprint::on_path;
use super::route::{BRAKING_MPS2, Route};
use crate::model::Body;

/// Driving style.
#[derive(Clone, Copy, Debug)]
pub(super) struct Driver {
    /// Speed on a free road, m/s.
    pub(super) free_mps: f64,
    /// Maximum acceleration, m/s².
    pub(super) rise_mps2: f64,
    /// Maximum deceleration, m/s².
    pub(super) brake_mps2: f64,
}

impl Driver {
    fn idm(&self) -> Idm {
        Idm {
            desired_mps: self.free_mps,
            acceleration_mps2: self.rise_mps2,
            braking_mps2: BRAKING_MPS2,
            headway_s: 1.2,
            min_gap_m: 2.2,
            gap_floor_m: 0.1,
            keeps_min_gap: true,
        }
    }
}

/// Simulated vehicle.
#[derive(Clone, Debug)]
pub(super) struct Vehicle {
    /// Its body; `None` for the ego.
    pub(super) body: Option<Body>,
    /// Length and width, meters.
    pub(super) size_m: DVec2,
    pub(super) driver: Driver,
    pub(super) route: Route,
    /// Position of its middle along its route, meters.
    pub(super) along_m: f64,
    pub(super) speed_mps: f64,
    /// Index in the route's lanes of the last path through a junction that it may take.
    pub(super) granted: Option<usize>,
    /// Time since which it has waited at a stop line, seconds; `None` if it does not wait.
    pub(super) waits_since_s: Option<f64>,
    /// Initial position along its route, meters.
    pub(super) began_m: f64,
}

impl Vehicle {
    pub(super) fn front_m(&self) -> f64 {
        self.along_m + self.size_m.x / 2.0
    }

    pub(super) fn rear_m(&self) -> f64 {
        self.along_m - self.size_m.x / 2.0
    }

    /// Returns whether it is a truck or bus, which sweeps a larger area than other vehicles.
    pub(super) fn is_long(&self) -> bool {
        self.size_m.x > 6.2
    }

    /// Returns the wheelbase, meters.
    fn base_m(&self) -> f64 {
        0.6 * self.size_m.x
    }

    pub(super) fn rect(&self) -> Footprint {
        on_path(&self.route.path, self.along_m, self.base_m(), self.size_m)
    }

    /// Returns the pose on the ground below its middle.
    pub(super) fn pose(&self) -> Pose {
        let rect = self.rect();
        Pose::from_yaw(rect.forward.to_angle(), rect.center.extend(0.0))
    }

    /// Returns the pose on the ground `behind_m` meters behind the middle of its box.
    pub(super) fn pose_behind(&self, behind_m: f64) -> Pose {
        let pose = self.pose();
        Pose { translation: pose.transform_point(DVec3::X * -behind_m), ..pose }
    }

    /// Advances by one step. `stop_m` is the position along its route that its front must not pass.
    pub(super) fn step(&mut self, leader: Option<Leader>, stop_m: f64, dt_s: f64) {
        let v = self.speed_mps;
        let rise = self.driver.idm().acceleration_mps2(v, leader);
        let mut next = (v + rise * dt_s).min(self.route.cap_mps(self.along_m + v * dt_s));
        next = next.min(halting_mps(stop_m - self.front_m(), BRAKING_MPS2, dt_s));
        if let Some(leader) = leader {
            let brake = 0.8 * self.driver.brake_mps2;
            let room = leader.gap_m - 1.0 + leader.speed_mps.powi(2) / (2.0 * brake);
            next = next.min(halting_mps(room, brake, dt_s));
        }
        let least = (v - self.driver.brake_mps2 * dt_s).max(0.0);
        // Braking is limited to `brake_mps2`, even before a stop line.
        self.speed_mps = next.max(least).min(v + self.driver.rise_mps2 * dt_s);
        self.along_m += self.speed_mps * dt_s;
    }
}

/// Returns the maximum speed in the next step that still lets it halt within a distance.
fn halting_mps(room_m: f64, brake_mps2: f64, dt_s: f64) -> f64 {
    let step = brake_mps2 * dt_s;
    (step * step + 2.0 * brake_mps2 * room_m.max(0.0)).sqrt() - step
}
