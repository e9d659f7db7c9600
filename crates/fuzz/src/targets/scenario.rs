//! Scenario files: parsed, applied to a log, and simulated.

use std::cell::RefCell;

use point_skeleton::Log;
use point_skeleton::dataset::ActorEdits;
use point_skeleton::geometry::Cuboid;
use pskel_sim::{ActorPolicy, EgoPolicy, Rates, Scenario, SimOptions, Simulation};
use serde_json::{Value, json};

use super::{LARGE, Scratch, edit_seeds, seed};
use crate::check::{assert_names_file, short};
use crate::edits::json_file;
use crate::synthetic_log::SyntheticLog;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 1] =
    [Target { name: "scenario", run: scenario, seeds, max_len: 4096, memory: LARGE }];

const FRAMES: usize = 20;
/// Largest coordinate of a box after a path of minutes at the highest speed, meters.
const MAX_M: f64 = 1e8;

thread_local! {
    static BASE: RefCell<(Scratch, Value, Log)> =
        RefCell::new((Scratch::new(), base(), Log::new(Box::new(SyntheticLog::new(FRAMES)))));
}

/// Returns a scenario with every action and condition.
fn base() -> Value {
    let near = json!({"ego_within": {"distance_m": 9.0, "track": "car"}});
    let place = json!({"in": {"ego": {"after_s": 0.5}}, "x_m": 9.0, "y_m": 3.0, "yaw_deg": 10.0});
    let point = |x_m: f64, speed_mps: f64| json!({"x_m": x_m, "y_m": 0.0, "speed_mps": speed_mps});
    let path = json!({"in": "actor", "points": [point(0.0, 0.0), point(4.0, 3.0), point(9.0, 3.0)]});
    let insert = json!({"category": "vehicle.car", "size_m": [4.5, 1.9, 1.5], "at": place});
    json!({
        "hold": {"cone": 1_600_000_000_200_000_i64},
        "replace": {"cone": "template"},
        "size_m": {"cone": [0.5, 0.5, 1.0]},
        "changes": [
            {"track": "new", "action": {"insert": insert}, "start": {"after_s": 0.3}},
            {"track": "new", "action": {"path": path}, "start": near, "end": {"after_s": 1.5}},
            {"track": "new", "action": "idm", "start": {"after_s": 1.0}},
            {"track": "car", "action": {"shift": {"left_m": 1.0}},
             "end": {"t_us": 1_600_000_000_900_000_i64}},
            {"track": "car", "action": {"move": {"in": "global", "x_m": 1010.0, "y_m": 500.0}},
                "start": {"ego_within": {"distance_m": 5.0, "point_m": [1002.0, 500.0]}}},
            {"track": "cone", "action": "remove", "start": {"after_s": 0.8}},
            {"track": "car", "action": {"resize": [5.0, 2.0, 1.8]}, "start": near, "end": {"after_s": 1.7}},
            {"track": "new", "action": {"replace": "car"},
                "start": {"after_s": 0.4}, "end": {"after_s": 0.9}},
            {"track": "car", "action": {"replace": "template"}}
        ]
    })
}

fn scenario(data: &[u8]) {
    BASE.with_borrow(|(scratch, base, log)| {
        let path = scratch.put("scenario.json", &json_file(data, base));
        let edits = match ActorEdits::read(&path) {
            Err(error) => return assert_names_file(error, &path, data),
            Ok(edits) => edits,
        };
        let edited = match log.edited(&edits) {
            Err(error) => return short(&error.to_string(), data),
            Ok(edited) => edited,
        };
        let recording = edited.recording();
        for frame in &recording.frames {
            assert!(frame.boxes.is_sorted_by(|a, b| a.track < b.track), "boxes in the order of tracks");
            for item in &frame.boxes {
                let Cuboid { pose, size } = item.cuboid;
                assert!(pose.translation.is_finite() && pose.translation.abs().max_element() < MAX_M);
                assert!(size.min_element() > 0.0 && (pose.rotation.length() - 1.0).abs() < 1e-6);
            }
        }
        let scenario = Scenario { log: recording, map: None, rates: Rates::default() };
        let options = SimOptions {
            steps: 12,
            sim_hz: Some(10.0),
            plan_hz: Some(5.0),
            ego: EgoPolicy::Straight,
            actors: ActorPolicy::Idm,
            ..SimOptions::default()
        };
        let mut simulation = Simulation::new(&scenario, options.clone()).expect("a rollout");
        for _ in 0..6 {
            simulation.step().expect("a step");
        }
        let saved = serde_json::to_string(&simulation.save()).expect("JSON");
        let again = serde_json::from_str(&saved).expect("a state that was saved");
        let resumed = Simulation::resume(&scenario, options, &again).expect("a state to go on with");
        assert_eq!(resumed.save(), simulation.save());
    });
}

fn seeds() -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", base().to_string()));
    seeds
}
