//! Families of scenarios: an ego that keeps its motion collides, one that brakes by a rule does not.

use glam::DVec3;
use point_skeleton::Log;
use point_skeleton::dataset::{Action, LogLocator, Track, TrackBox};
use point_skeleton::geometry::{Cuboid, Footprint, Polyline};
use pskel_sim::families::{Family, FamilyError, TRACK, family_scenario};
use pskel_sim::{EGO_SIZE_M, EgoPolicy, Instant, REAR_AXLE_TO_CENTER_M, SimOptions, Simulation, Waypoint};
use pskel_testing::shared::shared;
use pskel_testing::winding_road;
use pskel_town::Town;
use rayon::prelude::*;

use crate::scenario::Reader;

/// Steps per second: others than those with which scenarios are tried.
const HZ: f64 = 12.0;
/// Number of draws that a refusal counts.
const DRAWS: usize = 60;
/// Seeds of each family and log.
const SEEDS: u64 = 20;

fn options(start_us: i64, seconds: f64, ego: EgoPolicy) -> SimOptions {
    let steps = (seconds * HZ) as usize;
    let (sim_hz, plan_hz) = (Some(HZ), Some(HZ));
    SimOptions { steps, sim_hz, plan_hz, start_us: Some(start_us), ego, ..SimOptions::default() }
}

fn has_hit(simulation: &Simulation<'_>) -> bool {
    simulation.metrics().collisions.iter().any(|collision| collision.track == TRACK)
}

/// Returns whether an ego that keeps its plan, the recorded motion, collides with the target within 4 s.
fn kept(log: &Log, start_us: i64) -> bool {
    let mut simulation = winding_road::start(log.recording(), &options(start_us, 4.0, EgoPolicy::Replay));
    while simulation.step().unwrap().is_some() {}
    has_hit(&simulation)
}

/// An ego on its recorded path that brakes with 5 m/s² as soon as it would meet an actor within 4 s.
struct Brake {
    path: Polyline,
    way_m: f64,
    speed_mps: f64,
    is_on: bool,
}

impl Brake {
    /// Begins at a time, absolute microseconds, with the recorded path from there on.
    fn new(simulation: &Simulation<'_>, start_us: i64) -> Self {
        let places = (start_us..).step_by(50_000).map_while(|t_us| simulation.recorded_waypoint(t_us));
        let path = Polyline::new(places.map(|waypoint| waypoint.position_m())).unwrap();
        Self { path, way_m: 0.0, speed_mps: simulation.committed().get().ego.speed_mps, is_on: false }
    }

    /// Returns whether the ego would overlap an actor within 4 s, both at their present speeds.
    fn is_needed(&self, now: &Instant) -> bool {
        (0..=40).map(|tenth| f64::from(tenth) / 10.0).any(|t_s| {
            let (place, forward) = self.path.at(self.way_m + self.speed_mps * t_s);
            let center = place + forward * REAR_AXLE_TO_CENTER_M;
            let ego = Footprint { center, forward, half_m: EGO_SIZE_M.truncate() / 2.0 };
            now.actors.iter().any(|actor| {
                let body = Footprint::from(&actor.cuboid);
                let there = Footprint { center: body.center + actor.velocity_mps() * t_s, ..body };
                let reach_m = ego.radius_m() + body.radius_m() + 1.0;
                ego.center.distance(there.center) < reach_m && ego.grown(0.3).overlaps(&there)
            })
        })
    }

    /// Returns the waypoint at the next step, absolute microseconds.
    fn plan(&mut self, simulation: &Simulation<'_>) -> Waypoint {
        let (now, t_us) = ((*simulation.committed().get()).clone(), simulation.next_us());
        self.is_on |= self.is_needed(&now);
        if !self.is_on
            && let Some(recorded) = simulation.recorded_waypoint(t_us)
        {
            (self.way_m, self.speed_mps) = (self.path.nearest(recorded.position_m()).0, recorded.speed_mps);
            return recorded;
        }
        let dt_s = (t_us - now.t_us) as f64 / 1e6;
        let slower_mps = (self.speed_mps - 5.0 * dt_s).max(0.0);
        self.way_m += (self.speed_mps + slower_mps) / 2.0 * dt_s;
        self.speed_mps = slower_mps;
        let (place, forward) = self.path.at(self.way_m);
        let heading_rad = forward.to_angle();
        Waypoint { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps: slower_mps }
    }
}

/// Returns whether an ego that brakes by the rule collides with the target within 7 s.
fn braked(log: &Log, start_us: i64) -> bool {
    let mut simulation = winding_road::start(log.recording(), &options(start_us, 7.0, EgoPolicy::Caller));
    let mut brake = Brake::new(&simulation, start_us);
    while !simulation.is_done() {
        let plan = brake.plan(&simulation);
        simulation.follow_waypoints(vec![plan]).unwrap();
        simulation.step().unwrap();
    }
    has_hit(&simulation)
}

/// Checks all seeds of a family. Returns the number of scenarios; each other seed is refused with the name of
/// the log and what was in the way of each draw.
fn check(log: &Log, family: Family) -> u64 {
    let mut count = 0;
    for seed in 0..SEEDS {
        let made = match family_scenario(log, family, seed, None) {
            Ok(made) => made,
            Err(error) => {
                let FamilyError::Blocked { found, .. } = &error else { panic!("{error}") };
                assert_eq!(found.values().sum::<usize>(), DRAWS, "{error}");
                let name = log.recording().shown_name();
                let text = format!("expected free space for a {} scenario of log {name}", family.name());
                assert!(error.to_string().starts_with(&text), "{error}");
                continue;
            }
        };
        let edited = log.edited(&made.edits).unwrap();
        assert!(kept(&edited, made.start_us), "{} {seed}", family.name());
        assert!(!braked(&edited, made.start_us), "{} {seed}", family.name());
        assert!((0..=4_000_000).contains(&(made.collision_us - made.start_us)));
        count += 1;
    }
    count
}

/// Checks all families of a log, each with a scenario for most seeds.
fn check_all(log: &Log) {
    let counts: Vec<u64> = Family::ALL.into_par_iter().map(|family| check(log, family)).collect();
    assert!(counts.iter().all(|count| *count >= SEEDS * 9 / 10), "{counts:?}");
}

fn town(seed: u64) -> Log {
    let town = Town::new(&format!("seed={seed},frames=60,hz=5,size=90x160").parse().unwrap()).unwrap();
    Log::new(Box::new(town))
}

#[test]
fn town_7() {
    check_all(&town(7));
}

#[test]
fn town_11() {
    check_all(&town(11));
}

#[test]
fn recorded_log() {
    let Some(folder) = shared("PandaSet") else { return };
    let locator = format!("nuscenes:{}@v1.0-mini", folder.join("data/pandaset-002/nuscenes").display());
    let locator: LogLocator = locator.parse().unwrap();
    check_all(&Log::new(point_skeleton::dataset::open(&locator).unwrap()));
}

#[test]
fn scenarios_are_the_same_again() {
    let log = town(7);
    for family in Family::ALL {
        let [first, second] = [0, 0].map(|seed| family_scenario(&log, family, seed, None).unwrap());
        assert_eq!(first, second);
        assert_ne!(first, family_scenario(&log, family, 1, None).unwrap());
    }
}

#[test]
fn refusals_name_the_log_and_count_what_is_in_the_way() {
    let mut recording = winding_road::log(6);
    // More bodies over all of the road than a scenario removes.
    for number in 0..5 {
        let track = recording.tracks.len();
        let car = recording.tracks[2].clone();
        recording.tracks.push(Track { id: format!("wall-{number}"), ..car });
        let size = DVec3::new(300.0, 300.0, 2.0);
        for frame in &mut recording.frames {
            let cuboid = Cuboid { pose: frame.global_from_ego, size };
            frame.boxes.push(TrackBox { track, cuboid });
        }
    }
    let log = Log::new(Box::new(Reader(recording)));
    let error = family_scenario(&log, Family::Stationary, 0, None).unwrap_err();
    let FamilyError::Blocked { found, .. } = &error else { panic!("{error}") };
    assert_eq!(found.values().sum::<usize>(), DRAWS);
    let text =
        "expected free space for a stationary scenario of log made, found in the way of 60 draws: track ";
    let message = error.to_string();
    assert!(message.starts_with(text) && message.contains("track wall-"), "{message}");
}

#[test]
fn actors_in_the_way_are_removed_and_short_logs_refused() {
    // A car drives 25 m ahead at the same speed: over any place where something could stand.
    let log = Log::new(Box::new(Reader(winding_road::log(6))));
    let made = family_scenario(&log, Family::Stationary, 0, None).unwrap();
    let removed = made.edits.changes.iter().filter(|change| change.action == Action::Remove);
    assert_eq!(removed.map(|change| change.track.as_str()).collect::<Vec<_>>(), ["lead"]);
    let short = Log::new(Box::new(Reader(winding_road::log(3))));
    let error = family_scenario(&short, Family::Side, 0, None).unwrap_err().to_string();
    let slow =
        "expected an ego with 3 m/s or more about 3 s after a time that is 4.2 s before the end of log";
    assert!(error.starts_with(slow), "{error}");
}
