use proptest::prelude::*;
use pskel_sim::{
    ActorPolicy, EgoPolicy, Instant, LocalPath, PathAnchor, SavedState, SimError, SimOptions, Simulation,
    Tracking,
};
use pskel_testing::winding_road;
use serde_json::{Value, json};

fn policies() -> Vec<EgoPolicy> {
    let path = LocalPath::new(vec![[3.0, 0.1], [20.0, 1.0], [60.0, -4.0]]).unwrap();
    use EgoPolicy::{Cosine, File, LaneChange, Replay, RightThenBack, Straight};
    let anchors = [PathAnchor::Takeover, PathAnchor::EachPlan];
    let files = anchors.map(|anchor| File(path.clone(), anchor));
    [Replay, Straight, RightThenBack, Cosine, LaneChange].into_iter().chain(files).collect()
}

/// Returns everything that a rollout reports from its current step on, as text.
fn rest(sim: &mut Simulation<'_>) -> Vec<String> {
    let mut reported = Vec::new();
    while let Some(outcome) = sim.step().unwrap() {
        let now: Instant = (*sim.committed().get()).clone();
        reported.push(format!("{now:?} {outcome:?} {:?}", sim.forecast(2)));
    }
    reported.push(serde_json::to_string(&sim.metrics()).unwrap());
    reported.push(serde_json::to_string(&sim.save()).unwrap());
    reported
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn resuming_equals_an_uninterrupted_run(
        policy in 0usize..6,
        actors in prop::sample::select(vec![ActorPolicy::Replay, ActorPolicy::Idm, ActorPolicy::Reactive]),
        tracking in prop::sample::select(vec![Tracking::Perfect, Tracking::Bicycle]),
        seed: u64,
        cut in 0usize..50,
        warmup_frames in 0usize..6,
        ratio in 1usize..4,
    ) {
        let log = winding_road::log(5);
        let options = SimOptions {
            seed,
            steps: 50,
            sim_hz: Some(12.0),
            plan_hz: Some(12.0 / ratio as f64),
            warmup_frames,
            ego: policies()[policy].clone(),
            tracking,
            actors,
            ..SimOptions::default()
        };
        let mut sim = winding_road::start(&log, &options);
        for _ in 0..cut {
            sim.step().unwrap();
        }
        let saved = serde_json::to_string(&sim.save()).unwrap();
        let through = rest(&mut sim);
        let saved: SavedState = serde_json::from_str(&saved).unwrap();
        prop_assert_eq!(saved.step(), cut);
        let mut resumed = Simulation::resume(&winding_road::scenario(&log), options, &saved).unwrap();
        prop_assert_eq!(rest(&mut resumed), through);
    }
}

#[test]
fn more_steps_may_follow() {
    let log = winding_road::log(6);
    let options = SimOptions { steps: 20, ego: EgoPolicy::LaneChange, ..SimOptions::default() };
    let mut short = winding_road::start(&log, &options);
    rest(&mut short);
    let longer = SimOptions { steps: 40, ..options };
    let mut resumed =
        Simulation::resume(&winding_road::scenario(&log), longer.clone(), &short.save()).unwrap();
    let mut through = winding_road::start(&log, &longer);
    assert_eq!(rest(&mut resumed), rest(&mut through)[20..]);
}

#[test]
fn rejects_states_of_other_rollouts_and_damaged_states() {
    let log = winding_road::log(6);
    let options =
        SimOptions { steps: 20, actors: ActorPolicy::Idm, ego: EgoPolicy::Straight, ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    for _ in 0..10 {
        sim.step().unwrap();
    }
    let saved = serde_json::to_value(sim.save()).unwrap();
    let resume = |saved: Value, options: &SimOptions| -> Result<(), String> {
        let state: SavedState = serde_json::from_value(saved).map_err(|e| e.to_string())?;
        match Simulation::resume(&winding_road::scenario(&log), options.clone(), &state) {
            Ok(_) => Ok(()),
            Err(error @ SimError::Saved { .. }) => Err(error.to_string()),
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!(resume(saved.clone(), &options), Ok(()));
    let other = SimOptions { seed: 5, ..options.clone() };
    assert!(resume(saved.clone(), &other).unwrap_err().contains("seed 5, found 0"));
    let other = SimOptions { ego: EgoPolicy::Cosine, ..options.clone() };
    assert!(resume(saved.clone(), &other).unwrap_err().contains("cosine"));
    let changes = [
        ("/version", json!(1)),
        ("/log", json!("elsewhere")),
        ("/ego/pose/3", json!(4.0)),
        ("/ego/speed_mps", json!(null)),
        ("/foot_m/0", json!(null)),
        ("/actors/0/track", json!(99)),
        ("/actors/1/track", json!(0)),
        ("/actors/0/size_m/0", json!(-1.0)),
        ("/movers/0/0", json!(1)),
        ("/movers/0/1/idm/joined_us", json!(5)),
        ("/movers/0/1/idm/way_m", json!(-5.0)),
        ("/plan/waypoints", json!([])),
        ("/plan/waypoints/1/t_us", json!(0)),
        ("/tally/instants", json!("many")),
        ("/tally", json!({})),
    ];
    for (pointer, value) in changes {
        let mut damaged = saved.clone();
        *damaged.pointer_mut(pointer).unwrap_or_else(|| panic!("{pointer} in {saved}")) = value;
        assert!(resume(damaged, &options).is_err(), "{pointer}");
    }
    // Content that would be lost silently is refused, too.
    let mut damaged = saved.clone();
    damaged["options"]["wind"] = json!(3);
    assert!(resume(damaged, &options).unwrap_err().contains("wind none, found 3"));
    let mut damaged = saved.clone();
    let mover = damaged["movers"][0].clone();
    damaged["movers"].as_array_mut().unwrap().push(mover);
    assert!(resume(damaged, &options).unwrap_err().contains("valid actors"));
}
