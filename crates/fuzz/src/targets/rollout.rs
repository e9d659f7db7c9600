//! Rollouts to resume: saved states, lines of steps.

use std::cell::RefCell;

use point_skeleton::dataset::LogReader;
use pskel_sim::report::{Phase, StateFile, StepObservations, StepRow};
use pskel_sim::{ActorPolicy, EgoPolicy, Rates, SavedState, Scenario, SimOptions, Simulation, Tracking};
use serde_json::Value;

use super::clouds::written;
use super::{LARGE, SMALL, Scratch, edit_seeds, seed};
use crate::check::{assert_names_file, short};
use crate::edits::json_file;
use crate::synthetic_log::SyntheticLog;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 2] = [
    Target { name: "saved_state", run: saved_state, seeds: saved_seeds, max_len: 8192, memory: LARGE },
    Target { name: "states", run: states, seeds: state_seeds, max_len: 8192, memory: SMALL },
];

const FRAMES: usize = 20;

thread_local! {
    static SAVED: RefCell<(SyntheticLog, Value)> = RefCell::new((SyntheticLog::new(FRAMES), saved()));
    static ROWS: RefCell<(Scratch, Value)> = RefCell::new((Scratch::new(), row(0)));
}

fn options() -> SimOptions {
    SimOptions {
        steps: 12,
        sim_hz: Some(10.0),
        plan_hz: Some(5.0),
        warmup_frames: 2,
        ego: EgoPolicy::Straight,
        tracking: Tracking::Bicycle,
        actors: ActorPolicy::Idm,
        ..SimOptions::default()
    }
}

fn scenario(synthetic: &SyntheticLog) -> Scenario<'_> {
    Scenario { log: synthetic.recording(), map: None, rates: Rates::default() }
}

fn saved() -> Value {
    let synthetic = SyntheticLog::new(FRAMES);
    let mut sim = Simulation::new(&scenario(&synthetic), options()).expect("a rollout");
    for _ in 0..6 {
        sim.step().expect("a step");
    }
    serde_json::to_value(sim.save()).expect("JSON")
}

fn saved_state(data: &[u8]) {
    SAVED.with_borrow(|(synthetic, base)| {
        let saved: SavedState = match serde_json::from_slice(&json_file(data, base)) {
            Ok(saved) => saved,
            Err(_) => return,
        };
        let scenario = scenario(synthetic);
        if let Err(error) = saved.committed(&scenario, &options()) {
            short(&error.to_string(), data);
        }
        let mut sim = match Simulation::resume(&scenario, options(), &saved) {
            Err(error) => return short(&error.to_string(), data),
            Ok(sim) => sim,
        };
        assert_eq!(sim.save(), saved);
        for _ in 0..4 {
            let _ = sim.forecast(2);
            assert!(matches!(sim.step(), Ok(Some(_)) | Ok(None)), "a step that fails");
        }
        serde_json::to_string(&sim.metrics()).expect("JSON");
        let again = serde_json::to_string(&sim.save()).expect("JSON");
        let again: SavedState = serde_json::from_str(&again).expect("a state that was saved");
        assert!(
            Simulation::resume(&scenario, options(), &again).is_ok(),
            "a state that cannot be gone on with"
        );
    });
}

fn saved_seeds() -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", saved().to_string()));
    seeds
}

fn rows(count: usize) -> Vec<StepRow> {
    let synthetic = SyntheticLog::new(FRAMES);
    let mut sim = Simulation::new(&scenario(&synthetic), options()).expect("a rollout");
    let mut rows = Vec::new();
    for _ in 0..count {
        rows.push(StepRow::new(
            synthetic.recording(),
            sim.committed().get(),
            Phase::Policy,
            &StepObservations::default(),
            None,
        ));
        sim.step().expect("a step");
    }
    rows
}

fn row(index: usize) -> Value {
    serde_json::to_value(&rows(index + 1)[index]).expect("JSON")
}

fn states(data: &[u8]) {
    ROWS.with_borrow(|(scratch, base)| {
        let mut bytes = json_file(data, base);
        if data.first() == Some(&0) {
            bytes.push(b'\n');
        }
        let path = scratch.put("states.jsonl", &bytes);
        match StateFile::read(&path) {
            Err(error) => assert_names_file(error, &path, data),
            Ok(rows) => {
                assert!(rows.iter().enumerate().all(|(number, row)| row.step == number));
                StateFile::create(&path, &rows).expect("rows to write");
                assert_eq!(StateFile::read(&path).expect("rows that were written"), rows);
            }
        }
    });
}

fn state_seeds() -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", written("s", |path| StateFile::create(path, &rows(3)).map(|_| ()))));
    seeds
}
