use std::collections::BTreeMap;

use glam::DVec2;
use point_skeleton::dataset::{Frame, Recording};
use point_skeleton::idm::Leader;
use pskel_sim::{
    ActorPolicy, EgoPolicy, Instant, LocalPath, PathAnchor, SimActor, SimOptions, Simulation, idm_step,
};
use pskel_testing::shared::fixtures;
use pskel_testing::winding_road;
use serde_json::Value;

fn all(sim: &mut Simulation<'_>) -> Vec<Instant> {
    let mut instants = vec![(*sim.committed().get()).clone()];
    while sim.step().unwrap().is_some() {
        instants.push((*sim.committed().get()).clone());
    }
    instants
}

fn track(name: &str) -> usize {
    winding_road::TRACKS.iter().position(|(id, _)| *id == name).unwrap()
}

fn actor(instant: &Instant, name: &str) -> Option<SimActor> {
    instant.actors.iter().find(|a| a.track == track(name)).copied()
}

fn place(actor: &SimActor) -> DVec2 {
    actor.cuboid.pose.translation.truncate()
}

#[test]
fn the_driver_model_matches_nuplan() {
    let Some(folder) = fixtures("the runs of nuPlan's driver model") else { return };
    let file: Value = serde_json::from_slice(&std::fs::read(folder.join("sim/idm.json")).unwrap()).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let runs = file["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 24);
    for run in runs {
        let dt = number(&run["dt"]);
        let (lead_start, lead_speed) = (number(&run["lead_start"]), number(&run["lead_velocity"]));
        let mut state = (number(&run["start"][0]), number(&run["start"][1]));
        for (step, expected) in run["trace"].as_array().unwrap().iter().enumerate() {
            let lead = lead_start + lead_speed * dt * step as f64;
            let gap_m = lead - state.0 - number(&run["lead_half_length"]);
            state = idm_step(state, Some(Leader { gap_m, speed_mps: lead_speed }), dt);
            let expected = (number(&expected[0]), number(&expected[1]));
            let off = (state.0 - expected.0).abs().max((state.1 - expected.1).abs());
            assert!(off < 1e-9, "step {step}: {state:?} instead of {expected:?}");
        }
    }
}

#[test]
fn a_free_road_is_driven_at_the_target_speed() {
    let (mut state, mut before) = ((0.0, 0.0), 0.0);
    for _ in 0..600 {
        state = idm_step(state, None, 0.1);
        assert!(state.1 >= before && state.1 <= 10.0);
        before = state.1;
    }
    assert!((state.1 - 10.0).abs() < 1e-3);
}

#[test]
fn vehicles_leave_the_log_and_others_do_not() {
    let log = winding_road::log(8);
    let options = SimOptions {
        steps: 80,
        warmup_frames: 6,
        ego: EgoPolicy::Replay,
        actors: ActorPolicy::Idm,
        ..SimOptions::default()
    };
    let instants = all(&mut winding_road::start(&log, &options));
    for (instant, frame) in instants.iter().zip(&log.frames) {
        let logged = |name: &str| frame.cuboid_of(track(name));
        for name in ["cone", "walker", "parked"] {
            assert_eq!(actor(instant, name).map(|a| a.cuboid), logged(name), "{name} at {}", instant.step);
        }
        if instant.step <= 10 {
            assert_eq!(instant.actors.len(), frame.boxes.len());
            assert_eq!(actor(instant, "lead").map(|a| a.cuboid), logged("lead"));
        }
    }
    // On a free road the lead car accelerates along its recorded path, without a jump.
    let lead = |step: usize| actor(&instants[step], "lead").unwrap();
    assert!(lead(80).speed_mps > 9.0 && lead(80).speed_mps < 10.0, "{}", lead(80).speed_mps);
    for step in 10..80 {
        let moved = place(&lead(step)).distance(place(&lead(step + 1)));
        assert!((moved - lead(step).speed_mps * 0.1).abs() < 0.01);
        let on_road = (0..4000).map(|i| winding_road::road(f64::from(i) * 0.1, 0.0).translation.truncate());
        if step % 20 == 0 {
            let off = on_road.map(|p| p.distance(place(&lead(step)))).fold(f64::INFINITY, f64::min);
            assert!(off < 0.06, "{off}");
        }
    }
}

#[test]
fn a_follower_stops_behind_a_stopping_ego() {
    // The ego brakes in its own log at 2 m/s² from 1 s to 5 s, as hard as an IDM follower can; "brief" drives
    // behind it from 2 s on.
    let mut log = winding_road::log(12);
    let stop = winding_road::road(24.0, 0.0);
    for (i, frame) in log.frames.iter_mut().enumerate() {
        let t = i as f64 / 10.0;
        let braking = (t - 1.0).clamp(0.0, 4.0);
        let station = winding_road::SPEED_MPS * (t.min(1.0) + braking) - braking * braking;
        frame.global_from_ego = winding_road::road(station, 0.0);
        frame.boxes.retain(|b| b.track == track("brief"));
    }
    let run = |actors: ActorPolicy| {
        let options = SimOptions { steps: 120, actors, ..SimOptions::default() };
        let mut sim = winding_road::start(&log, &options);
        let instants = all(&mut sim);
        (instants, sim.metrics())
    };
    // In replay it drives into the ego.
    assert_eq!(run(ActorPolicy::Replay).1.collisions.len(), 1);
    for policy in [ActorPolicy::Idm, ActorPolicy::Reactive] {
        let (instants, metrics) = run(policy);
        assert!(metrics.collisions.is_empty(), "{policy:?} {:?}", metrics.collisions);
        // It outlives its track and stops behind the ego.
        let last = actor(&instants[120], "brief").unwrap();
        assert!(last.speed_mps < 0.3, "{policy:?} {}", last.speed_mps);
        let gap = place(&last).distance(stop.translation.truncate()) - 2.2 - (5.176 / 2.0 - 1.461);
        assert!((0.5..5.0).contains(&gap), "{policy:?} {gap}");
    }
}

#[test]
fn distant_actors_follow_the_log_or_are_removed() {
    let log = winding_road::log(20);
    // The ego turns away and leaves the vicinity of the lead car.
    let away = LocalPath::new(vec![[0.0, 0.0], [0.0, 900.0]]).unwrap();
    for actors in [ActorPolicy::Idm, ActorPolicy::Reactive] {
        let options = SimOptions {
            steps: 190,
            ego: EgoPolicy::File(away.clone(), PathAnchor::Takeover),
            actors,
            ..SimOptions::default()
        };
        let instants = all(&mut winding_road::start(&log, &options));
        let mut near_before = true;
        for instant in &instants[1..] {
            let lead = actor(instant, "lead");
            let near = lead.is_some_and(|a| place(&a).distance(instant.ego.position_m()) <= 100.0);
            // A removed actor never reappears.
            assert!(lead.is_none() || (near && near_before), "{actors:?} step {}", instant.step);
            near_before = lead.is_some();
        }
        assert!(!near_before);
        // The oncoming truck, over 100 m from the start, follows the log.
        for (instant, frame) in instants.iter().zip(&log.frames).take(10) {
            assert_eq!(actor(instant, "oncoming").map(|a| a.cuboid), frame.cuboid_of(track("oncoming")));
        }
    }
}

#[test]
fn track_order_does_not_affect_the_result() {
    let log = winding_road::log(6);
    // The same log with its tracks in reverse order.
    let flip = |i: usize| winding_road::TRACKS.len() - 1 - i;
    let mut tracks = log.tracks.clone();
    tracks.reverse();
    let frames = log.frames.iter().map(|frame| {
        let mut boxes: Vec<_> = frame.boxes.clone();
        boxes.iter_mut().for_each(|b| b.track = flip(b.track));
        boxes.sort_by_key(|b| b.track);
        Frame { boxes, ..frame.clone() }
    });
    let flipped = Recording { tracks, frames: frames.collect(), ..log.clone() };
    for actors in [ActorPolicy::Idm, ActorPolicy::Reactive] {
        let options = SimOptions { steps: 60, ego: EgoPolicy::LaneChange, actors, ..SimOptions::default() };
        let by_name = |log: &Recording, of: &dyn Fn(usize) -> usize| -> Vec<BTreeMap<usize, SimActor>> {
            let named = |a: &SimActor| (of(a.track), SimActor { track: of(a.track), ..*a });
            all(&mut winding_road::start(log, &options))
                .iter()
                .map(|i| i.actors.iter().map(named).collect())
                .collect()
        };
        assert_eq!(by_name(&log, &|i| i), by_name(&flipped, &flip));
    }
}
