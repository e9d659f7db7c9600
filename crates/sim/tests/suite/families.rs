//! Families of scenarios: an ego that keeps its motion collides, one that brakes at once does not.

use point_skeleton::Log;
use point_skeleton::dataset::{Action, LogLocator};
use point_skeleton::geometry::Polyline;
use pskel_sim::families::{Family, FamilyError, TRACK, family_scenario};
use pskel_sim::{EgoPolicy, SimOptions, Waypoint};
use pskel_testing::shared::shared;
use pskel_testing::winding_road;
use pskel_town::Town;

use crate::scenario::Reader;

/// Steps per second: others than those with which scenarios are tried.
const HZ: f64 = 12.0;

fn options(start_us: i64, seconds: f64, ego: EgoPolicy) -> SimOptions {
    let steps = (seconds * HZ) as usize;
    let (sim_hz, plan_hz) = (Some(HZ), Some(HZ));
    SimOptions { steps, sim_hz, plan_hz, start_us: Some(start_us), ego, ..SimOptions::default() }
}

/// Returns whether the recorded ego collides with the target within 4 s.
fn kept(log: &Log, start_us: i64) -> bool {
    let mut simulation = winding_road::start(log.recording(), &options(start_us, 4.0, EgoPolicy::Replay));
    while simulation.step().unwrap().is_some() {}
    simulation.metrics().collisions.iter().any(|collision| collision.track == TRACK)
}

/// Returns whether an ego that brakes with 5 m/s² from the start on, along its recorded path, collides with
/// the target within 7 s.
fn braked(log: &Log, start_us: i64) -> bool {
    let mut simulation = winding_road::start(log.recording(), &options(start_us, 7.0, EgoPolicy::Caller));
    let times_us = (start_us..).step_by(50_000);
    let places = times_us.map_while(|t_us| simulation.recorded_waypoint(t_us));
    let path = Polyline::new(places.map(|waypoint| waypoint.position_m())).unwrap();
    let first_mps = simulation.committed().get().ego.speed_mps;
    while !simulation.is_done() {
        let t_us = simulation.next_us();
        let t_s = ((t_us - start_us) as f64 / 1e6).min(first_mps / 5.0);
        let (place, forward) = path.at(first_mps * t_s - 2.5 * t_s * t_s);
        let speed_mps = first_mps - 5.0 * t_s;
        let heading_rad = forward.to_angle();
        let plan = Waypoint { t_us, x_m: place.x, y_m: place.y, heading_rad, speed_mps };
        simulation.follow_waypoints(vec![plan]).unwrap();
        simulation.step().unwrap();
    }
    simulation.metrics().collisions.iter().any(|collision| collision.track == TRACK)
}

/// Checks some seeds of all families, and returns the reasons of refusals.
fn check(log: &Log, seeds: u64) -> Vec<String> {
    let mut refused = Vec::new();
    for family in Family::ALL {
        for seed in 0..seeds {
            let made = match family_scenario(log, family, seed, None) {
                Ok(made) => made,
                Err(error @ (FamilyError::Blocked { .. } | FamilyError::Slow { .. })) => {
                    refused.push(error.to_string());
                    continue;
                }
                Err(error) => panic!("{error}"),
            };
            let edited = log.edited(&made.edits).unwrap();
            assert!(kept(&edited, made.start_us), "{} {seed}", family.name());
            assert!(!braked(&edited, made.start_us), "{} {seed}", family.name());
            assert!((0..=4_000_000).contains(&(made.collision_us - made.start_us)));
            assert_eq!(family_scenario(log, family, seed, None).unwrap(), made, "again");
        }
    }
    refused
}

#[test]
fn towns() {
    for seed in [7, 11] {
        let town = Town::new(&format!("seed={seed},frames=60,hz=5,size=90x160").parse().unwrap()).unwrap();
        let log = Log::new(Box::new(town));
        let refused = check(&log, 2);
        assert!(refused.is_empty(), "{refused:?}");
    }
}

#[test]
fn recorded_log() {
    let Some(folder) = shared("PandaSet") else { return };
    let locator = format!("nuscenes:{}@v1.0-mini", folder.join("data/pandaset-002/nuscenes").display());
    let locator: LogLocator = locator.parse().unwrap();
    let log = Log::new(point_skeleton::dataset::open(&locator).unwrap());
    let refused = check(&log, 2);
    assert!(refused.is_empty(), "{refused:?}");
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
    assert!(error.starts_with("expected an ego with 3 m/s or more about 3 s"), "{error}");
}
