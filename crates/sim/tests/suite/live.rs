use point_skeleton::dataset::Recording;
use pskel_sim::{
    ActorPolicy, Controls, EgoPolicy, EndReason, Instant, PathAnchor, SimError, SimOptions, Simulation,
    TrajectoryFile, Waypoint, Wheel,
};
use pskel_testing::winding_road;

/// Options of a rollout that follows the log until a takeover.
fn live(actors: ActorPolicy) -> SimOptions {
    SimOptions {
        steps: usize::MAX,
        warmup_frames: usize::MAX,
        sim_hz: Some(10.0),
        plan_hz: Some(10.0),
        ego: EgoPolicy::Caller,
        actors,
        ..SimOptions::default()
    }
}

/// Follows the log for some steps.
fn warm_up<'a>(log: &'a Recording, options: &SimOptions, steps: usize) -> Simulation<'a> {
    let mut sim = winding_road::start(log, options);
    for _ in 0..steps {
        assert!(!sim.needs_plan() && sim.step().unwrap().is_some());
    }
    sim
}

/// Drives by a person's controls; returns the waypoints and all states.
fn drive(sim: &mut Simulation<'_>, steps: usize) -> (Vec<Waypoint>, Vec<Instant>) {
    let mut wheel = Wheel::new(&sim.committed().get().ego);
    let (mut waypoints, mut states) = (Vec::new(), vec![(*sim.committed().get()).clone()]);
    for step in 0..steps {
        let (now, next_us) = ((*sim.committed().get()).clone(), sim.next_us());
        let steer = (step as f64 / 7.0).sin() / 3.0;
        let controls = Controls { throttle: 0.3, brake: 0.0, steer };
        let waypoint = wheel.drive(&now.ego, controls, now.t_us, next_us);
        sim.follow_waypoints(vec![waypoint]).unwrap();
        assert!(sim.step().unwrap().is_some());
        waypoints.push(waypoint);
        states.push((*sim.committed().get()).clone());
    }
    (waypoints, states)
}

#[test]
fn takeover_equals_a_warm_up_that_ends_there() {
    let log = winding_road::log(5);
    for actors in [ActorPolicy::Replay, ActorPolicy::Idm] {
        for step in [0, 7, 50] {
            let mut sim = warm_up(&log, &live(actors), step);
            sim.take_over().unwrap();
            sim.take_over().unwrap();
            let planned = SimOptions { warmup_frames: step + 1, ..live(actors) };
            let mut expected = warm_up(&log, &planned, step);
            for steps in [0, 20] {
                assert_eq!(drive(&mut sim, steps), drive(&mut expected, steps), "{actors:?} {step}");
                let text = |sim: &Simulation<'_>| serde_json::to_string(&sim.save()).unwrap();
                assert_eq!(text(&sim), text(&expected));
                assert_eq!(sim.metrics(), expected.metrics());
            }
        }
    }
}

#[test]
fn the_end_of_the_log_allows_a_takeover() {
    let log = winding_road::log(1);
    let mut sim = warm_up(&log, &live(ActorPolicy::Idm), 10);
    assert_eq!((sim.step().unwrap(), sim.ended()), (None, Some(EndReason::LogEnded)));
    sim.take_over().unwrap();
    assert!(sim.ended().is_none() && sim.needs_plan());
    assert_eq!(drive(&mut sim, 5).1[5].step, 15);
}

#[test]
fn takeover_and_policies_need_their_steps() {
    let log = winding_road::log(2);
    let options = SimOptions { plan_hz: Some(5.0), ..live(ActorPolicy::Replay) };
    let mut sim = warm_up(&log, &options, 3);
    assert!(matches!(sim.take_over(), Err(SimError::Takeover { step: 3, steps_per_plan: 2 })));
    assert!(matches!(sim.plan_by(&EgoPolicy::Straight), Err(SimError::Policy { .. })));
    sim.step().unwrap();
    sim.take_over().unwrap();
    assert!(matches!(sim.plan_by(&EgoPolicy::Replay), Err(SimError::Policy { .. })));
    for policy in [EgoPolicy::Straight, EgoPolicy::Cosine, EgoPolicy::LaneChange] {
        sim.plan_by(&policy).unwrap();
        let before = sim.committed().get().ego.position_m();
        assert!(sim.step().unwrap().unwrap().plan.is_some());
        assert!(sim.committed().get().ego.position_m().distance(before) < 1.5, "{policy:?}");
        sim.step().unwrap();
    }
    sim.plan_by(&EgoPolicy::Caller).unwrap();
    assert!(sim.needs_plan());
    let short = sim.recorded_waypoint(sim.next_us()).unwrap();
    assert!(matches!(sim.follow_waypoints(vec![short]), Err(SimError::Plan(_))));
}

#[test]
fn waypoints_of_a_drive_give_the_same_states() {
    let log = winding_road::log(5);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.json");
    for actors in [ActorPolicy::Replay, ActorPolicy::Idm] {
        let mut sim = warm_up(&log, &live(actors), 7);
        sim.take_over().unwrap();
        let (waypoints, states) = drive(&mut sim, 60);
        TrajectoryFile::new(waypoints.clone()).unwrap().write(&path).unwrap();
        assert_eq!(TrajectoryFile::read(&path).unwrap().waypoints(), waypoints);
        let ego = EgoPolicy::read(&path, PathAnchor::Takeover).unwrap();
        assert_eq!(ego.name(), "file");
        let options = SimOptions { steps: 67, warmup_frames: 8, ego, ..live(actors) };
        let mut again = warm_up(&log, &options, 7);
        for state in &states {
            assert_eq!(*again.committed().get(), state);
            again.step().unwrap();
        }
        assert_eq!(again.metrics(), sim.metrics());
        assert!(again.is_done());
        let error = EgoPolicy::read(&path, PathAnchor::EachPlan).unwrap_err().to_string();
        assert!(error.contains("waypoints with times") && error.ends_with("drive.json"), "{error}");
    }
}

#[test]
fn rejects_invalid_waypoints_and_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.json");
    let point = |t: i64, x: f64, v: f64| {
        format!("{{\"t_us\": {t}, \"x_m\": {x}, \"y_m\": 0, \"heading_rad\": 0, \"speed_mps\": {v}}}")
    };
    for (points, part) in [
        (String::new(), "found 0"),
        (format!("{}, {}", point(5, 0.0, 0.0), point(5, 0.0, 0.0)), "5 us at waypoint 1"),
        (format!("{}, {}", point(0, 0.0, 0.0), point(1_000_000, 101.0, 0.0)), "101 m/s to waypoint 1"),
        (point(0, 0.0, 101.0), "up to 100 m/s"),
        ("{\"t_us\": 0}".to_owned(), "heading_rad"),
    ] {
        std::fs::write(&path, format!("{{\"waypoints\": [{points}]}}")).unwrap();
        let error = EgoPolicy::read(&path, PathAnchor::Takeover).unwrap_err().to_string();
        assert!(error.contains(part) && error.ends_with("bad.json"), "{error}\nexpected {part}");
    }
}
