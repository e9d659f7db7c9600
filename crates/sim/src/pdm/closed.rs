//! PDM-Closed, the planner of NAVSIM whose progress is the reference for that of plans: fifteen drives by the
//! Intelligent Driver Model along the center line and beside it, of which the best one is taken.
//!
//! Facts from NAVSIM's `PDMGenerator`, `BatchIDMPolicy` and metric cache, with their peculiarities: the first
//! step sees a leader at the start of the path, and values of a leader that is not set are those of the drive
//! before.

use glam::DVec2;
use point_skeleton::geometry::wrap_angle;

use super::path::Path;
use super::roads::{Roads, Route, ring};
use super::score::{Parts, progress};
use super::shape;
use super::state::{PdmState, STEP_S};
use super::traffic::Traffic;
use super::{SAMPLES, tracker};
use crate::EGO_SIZE_M;

/// Distances of the paths from the center line to the left, meters, in the order of the drives.
const OFFSETS_M: [f64; 3] = [0.0, -1.0, 1.0];
/// Shares of the speed limit.
const SPEED_SHARES: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Speed limit of lanes without one, meters per second.
const FALLBACK_MPS: f64 = 15.0;
/// Parameters of the Intelligent Driver Model: gap (m), headway (s), acceleration, deceleration (m/s²),
/// exponent.
const GAP_M: f64 = 1.0;
const HEADWAY_S: f64 = 1.5;
const ACCELERATION_MPS2: f64 = 1.5;
const DECELERATION_MPS2: f64 = 3.0;
const EXPONENT: i32 = 10;
/// Duration over which the corridor of a path extends at the speed limit, seconds.
const CORRIDOR_S: f64 = 5.0;

/// Leader of a drive: station and rear length in meters, speed in meters per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Leader {
    station_m: f64,
    speed_mps: f64,
    rear_m: f64,
}

/// Drive along a path.
#[derive(Clone, Debug)]
struct Drive {
    limit_mps: f64,
    station_m: f64,
    speed_mps: f64,
    leader: Leader,
    poses: Vec<(DVec2, f64)>,
}

/// Something in the corridor of a path: a road user, or a red light without speed and heading.
struct Obstacle {
    ring: Vec<DVec2>,
    station_m: f64,
    motion: Option<(f64, f64)>,
}

/// Returns the poses of the best drive from a state, [`SAMPLES`] of them.
pub(super) fn plan(ego: &PdmState, traffic: &Traffic, roads: &Roads<'_>, route: &Route) -> Vec<(DVec2, f64)> {
    let limit_mps = route.limit_mps.unwrap_or(FALLBACK_MPS);
    let paths = OFFSETS_M.iter().filter_map(|offset_m| route.centerline.beside(*offset_m));
    let drives: Vec<Vec<(DVec2, f64)>> =
        paths.flat_map(|path| unrolled(ego, &path, limit_mps, traffic, roads)).collect();
    let driven = drives.iter().map(|poses| tracker::track(*ego, poses));
    let parts: Vec<Parts> = driven.map(|states| Parts::of(&states, traffic, roads, route)).collect();
    let score = |(parts, progress): (&Parts, f64)| {
        // Without a history, the comfort is full.
        let weighted = 5.0 * progress + 5.0 * parts.time_to_collision + 2.0 * parts.lane_keeping + 2.0;
        parts.penalty() * weighted / 14.0
    };
    let scores: Vec<f64> = parts.iter().zip(progress(&parts)).map(score).collect();
    // The first one of the best.
    let mut best = 0;
    for (number, score) in scores.iter().enumerate() {
        if *score > scores[best] {
            best = number;
        }
    }
    drives.into_iter().nth(best).unwrap_or_default()
}

/// Drives along a path with all shares of the speed limit.
fn unrolled(
    ego: &PdmState,
    path: &Path,
    limit_mps: f64,
    traffic: &Traffic,
    roads: &Roads<'_>,
) -> Vec<Vec<(DVec2, f64)>> {
    let station_m = path.station_m(ego.place_m);
    let corridor = path.part(station_m, station_m + limit_mps * CORRIDOR_S);
    let start = |share: f64| Drive {
        limit_mps: share * limit_mps,
        station_m,
        speed_mps: ego.velocity_mps.x,
        leader: Leader::default(),
        poses: vec![path.at(station_m)],
    };
    let mut drives = SPEED_SHARES.map(start);
    for sample in 1..SAMPLES {
        if sample % 2 == 0 {
            let obstacles = obstacles(&corridor, path, traffic, roads, sample);
            let mut leader = Leader::default();
            for drive in &mut drives {
                drive.find_leader(&obstacles, path, &mut leader);
                drive.leader = leader;
            }
        }
        for drive in &mut drives {
            drive.step(path);
        }
    }
    drives.map(|drive| drive.poses).into()
}

/// Returns what is in a corridor at a sample.
fn obstacles(
    corridor: &[DVec2],
    path: &Path,
    traffic: &Traffic,
    roads: &Roads<'_>,
    sample: usize,
) -> Vec<Obstacle> {
    let objects = traffic.objects[sample].iter().filter(|object| !traffic.ignored.contains(&object.track));
    let objects = objects.map(|object| {
        let first = &traffic.first[&object.track];
        let motion = first.is_agent().then_some((first.heading_rad, first.speed_mps));
        (object.body.corners().to_vec(), object.body.center, motion.or(Some((0.0, 0.0))))
    });
    let red = traffic.red.get(sample).into_iter().flatten();
    let red = red.filter(|lane| !traffic.entered.contains(lane)).map(|lane| {
        let ring = ring(roads, *lane).to_vec();
        let center = shape::centroid(&ring);
        (ring, center, None)
    });
    let inside =
        objects.chain(red).filter(|(ring, ..)| shape::is_in_corridor(ring, corridor, EGO_SIZE_M.y / 2.0));
    inside
        .map(|(ring, center, motion)| Obstacle { station_m: path.station_m(center), ring, motion })
        .collect()
}

impl Drive {
    /// Updates the leader: the nearest obstacle ahead, or else the end of the path.
    fn find_leader(&self, obstacles: &[Obstacle], path: &Path, leader: &mut Leader) {
        let (place_m, heading_rad) = self.poses[self.poses.len() - 1];
        let corners = PdmState { place_m, heading_rad, ..PdmState::default() }.body().corners();
        let ahead = obstacles.iter().filter(|obstacle| obstacle.station_m > self.station_m);
        let distances = ahead.map(|obstacle| (shape::distance_m(&corners, &obstacle.ring), obstacle));
        match distances.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((distance_m, obstacle)) => {
                leader.station_m = self.station_m + distance_m;
                if let Some((heading, speed_mps)) = obstacle.motion {
                    leader.speed_mps = speed_mps * wrap_angle(heading - heading_rad).cos();
                }
            }
            None => {
                leader.station_m = path.length_m();
                leader.rear_m = EGO_SIZE_M.x / 2.0;
            }
        }
    }

    /// Moves by the Intelligent Driver Model (Euler).
    fn step(&mut self, path: &Path) {
        let Leader { station_m, speed_mps, rear_m } = self.leader;
        let speed = self.speed_mps;
        let wanted_m = GAP_M
            + speed * HEADWAY_S
            + speed * (speed - speed_mps) / (2.0 * (ACCELERATION_MPS2 * DECELERATION_MPS2).sqrt());
        let gap_m = (station_m - self.station_m - rear_m).max(GAP_M);
        let free = (speed / self.limit_mps).powi(EXPONENT);
        let acceleration = ACCELERATION_MPS2 * (1.0 - free - (wanted_m / gap_m).powi(2));
        self.station_m += STEP_S * speed;
        self.speed_mps += STEP_S * acceleration.clamp(-DECELERATION_MPS2, ACCELERATION_MPS2);
        self.poses.push(path.at(self.station_m));
    }
}
