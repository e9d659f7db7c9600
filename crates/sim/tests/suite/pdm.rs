//! PDM scores against NAVSIM's own scorer: `pdm.json` is written by `tests/peers/navsim_scores.py`. If
//! `PSKEL_NAVSIM` names a clone of NAVSIM at 0a380a9, and `PSKEL_DEVKIT_PYTHON` a Python with the packages of
//! nuplan-devkit, the table is also computed anew.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use glam::{DVec2, DVec3};
use point_skeleton::Log;
use pskel_sim::pdm::{PdmResult, PdmScene, PdmScorer, PdmScores, PdmState};
use pskel_testing::shared::{shared, skip};
use serde::Deserialize;

/// Maximum difference between a sub-score and NAVSIM's.
const TOLERANCE: f64 = 1e-6;

#[derive(Deserialize)]
struct Expected {
    starts: Vec<Start>,
    /// First and second frame, number of the plan, whether both are consistent.
    two_frame_comfort: Vec<(usize, usize, usize, bool)>,
}

#[derive(Deserialize)]
struct Start {
    frame: usize,
    red: Option<Vec<u64>>,
    /// x, y, yaw relative to the last one, velocities, accelerations; 2 Hz.
    history: Vec<[f64; 7]>,
    plans: Vec<Plan>,
}

#[derive(Deserialize)]
struct Plan {
    poses: Vec<[f64; 3]>,
    scores: [f64; 8],
    filtered: [f64; 8],
    score: f64,
    comfort: bool,
    /// Last state of the ego, relative to the first one.
    end: [f64; 3],
}

fn expected() -> Expected {
    serde_json::from_str(include_str!("pdm.json")).unwrap()
}

/// Runs NAVSIM; `None` without it or without data.
fn of_peer() -> Option<Expected> {
    let Some(navsim) = std::env::var_os("PSKEL_NAVSIM").map(PathBuf::from) else {
        skip("NAVSIM is not given (set PSKEL_NAVSIM)");
        return None;
    };
    let shared = shared("PandaSet in nuPlan's layout, and nuplan-devkit")?;
    let data = shared.join("data/pandaset-002/nuplan");
    let databases = std::fs::read_dir(data.join("nuplan-v1.1/splits/mini")).unwrap();
    let mut databases = databases.map(|entry| entry.unwrap().path());
    let database = databases.find(|path| path.extension().is_some_and(|end| end == "db")).unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("pdm.json");
    let path = std::env::join_paths([navsim, shared.join("interop/nuplan-devkit")]).unwrap();
    let python = std::env::var_os("PSKEL_DEVKIT_PYTHON").unwrap_or("python3".into());
    let mut command = Command::new(python);
    command.arg(root.join("tests/peers/navsim_scores.py")).arg(database).arg(data.join("maps"));
    let done = command.arg("--out").arg(&out).env("PYTHONPATH", path).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    Some(serde_json::from_slice(&std::fs::read(out).unwrap()).unwrap())
}

/// Returns the states of the ego that NAVSIM reads from the database; ours are estimated from poses.
fn past(scene: &PdmScene<'_, '_>, rows: &[[f64; 7]]) -> Vec<PdmState> {
    let start = scene.start();
    let forward = DVec2::from_angle(start.heading_rad);
    let state = |[x, y, yaw, vx, vy, ax, ay]: &[f64; 7]| PdmState {
        place_m: start.place_m + forward.rotate(DVec2::new(*x, *y)),
        heading_rad: start.heading_rad + yaw,
        velocity_mps: DVec2::new(*vx, *vy),
        acceleration_mps2: DVec2::new(*ax, *ay),
        ..PdmState::default()
    };
    rows.iter().map(state).collect()
}

fn values(scores: &PdmScores) -> [f64; 8] {
    [
        scores.no_at_fault_collisions,
        scores.drivable_area_compliance,
        scores.driving_direction_compliance,
        scores.traffic_light_compliance,
        scores.ego_progress,
        scores.time_to_collision_within_bound,
        scores.lane_keeping,
        scores.history_comfort,
    ]
}

fn largest_difference(found: &[f64], expected: &[f64]) -> f64 {
    found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Scores all plans of the table on PandaSet in nuPlan's layout.
fn scored(expected: &Expected) -> Option<Vec<(usize, Vec<PdmResult>)>> {
    let root =
        shared("PandaSet in nuPlan's layout")?.join("data/pandaset-002/nuplan/nuplan-v1.1/splits/mini");
    let log = Log::open(&format!("nuplan:{}", root.display())).unwrap();
    let map = log.map().unwrap();
    let scorer = PdmScorer::new(log.recording(), map.vector_map()).unwrap();
    let score = |start: &Start| {
        let scene = scorer.scene(log.recording().frames[start.frame].t_us).unwrap();
        let past = past(&scene, &start.history);
        let scene = scene.with_past(past);
        let scene = match &start.red {
            Some(red) => scene.with_red(&red.iter().map(u64::to_string).collect::<BTreeSet<_>>()),
            None => scene,
        };
        let plan = |plan: &Plan| plan.poses.iter().map(|pose| DVec3::from(*pose)).collect::<Vec<_>>();
        let mut plans: Vec<_> = start.plans.iter().map(plan).collect();
        plans.push(scene.recorded_plan());
        (start.frame, scene.score(&plans, 0.5).unwrap())
    };
    Some(expected.starts.iter().map(score).collect())
}

#[test]
fn sub_scores_equal_those_of_navsim() {
    compare(&expected());
}

#[test]
fn sub_scores_equal_those_of_navsim_now() {
    let Some(expected) = of_peer() else { return };
    compare(&expected);
    let shipped = self::expected();
    let scores = |table: &Expected| -> Vec<[f64; 8]> {
        table.starts.iter().flat_map(|start| &start.plans).map(|plan| plan.scores).collect()
    };
    let (now, shipped) = (scores(&expected), scores(&shipped));
    assert_eq!(now.len(), shipped.len());
    assert!(now.iter().zip(&shipped).all(|(a, b)| largest_difference(a, b) < TOLERANCE));
}

/// Compares all plans of a table, if the data is there.
fn compare(expected: &Expected) {
    let Some(found) = scored(expected) else { return };
    let (mut plans, mut wrong) = (0, Vec::new());
    for (start, (frame, results)) in expected.starts.iter().zip(&found) {
        let recorded = &results[start.plans.len()].scores;
        for (number, (plan, result)) in start.plans.iter().zip(results).enumerate() {
            let (first, last) = (result.states[0], result.states[40]);
            let arm = DVec2::from_angle(-first.heading_rad).rotate(last.place_m - first.place_m);
            let end = [arm.x, arm.y, last.heading_rad - first.heading_rad];
            let comfort = f64::from(u8::from(plan.comfort));
            let scores = values(&result.scores);
            let compared = [
                ("end", largest_difference(&end, &plan.end)),
                ("sub-scores", largest_difference(&scores, &plan.scores)),
                ("filtered", largest_difference(&values(&result.scores.forgiven(recorded)), &plan.filtered)),
                ("EPDMS", (result.scores.epdms - plan.score).abs()),
                ("comfort", (result.scores.comfort - comfort).abs()),
            ];
            for (what, _) in compared.iter().filter(|(_, off)| off.is_nan() || *off > TOLERANCE) {
                let expected = &plan.scores;
                wrong
                    .push(format!("{what} of plan {number}, frame {frame}: {scores:?}, NAVSIM {expected:?}"));
            }
            plans += 1;
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(plans >= 50, "{plans}");
}

#[test]
fn two_frame_comfort_equals_that_of_navsim() {
    let expected = expected();
    let Some(found) = scored(&expected) else { return };
    for (before, after, number, consistent) in &expected.two_frame_comfort {
        let results = |frame: &usize| &found.iter().find(|(found, _)| found == frame).unwrap().1[*number];
        let samples = 2 * (after - before);
        let scores = results(after).after(results(before), samples);
        let flag = f64::from(u8::from(*consistent));
        assert_eq!(scores.two_frame_extended_comfort, Some(flag), "plan {number}, {before} to {after}");
    }
    assert!(expected.two_frame_comfort.iter().any(|pair| pair.3));
}

/// Each sub-score has plans with and without it, so the comparison above can fail.
#[test]
fn the_table_has_plans_that_fail_each_sub_score() {
    let expected = expected();
    let plans = || expected.starts.iter().flat_map(|start| &start.plans);
    for score in 0..8 {
        let full = plans().filter(|plan| plan.scores[score] == 1.0).count();
        assert!((1..plans().count()).contains(&full), "{score}: {full}");
    }
}
