use glam::{DVec2, DVec3};
use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{EgoTrack, LogLocator, LogReader, Recording};
use pskel_sim::{
    ActorPolicy, Committed, EgoPolicy, EndReason, Instant, Rates, Scenario, SimError, SimOptions, Simulation,
    scene_state,
};
use pskel_testing::shared::shared;
use pskel_testing::winding_road;

fn all(sim: &mut Simulation<'_>) -> Vec<Instant> {
    let mut instants = vec![sim.committed().get().to_owned().clone()];
    while sim.step().unwrap().is_some() {
        let now: Committed<&Instant> = sim.committed();
        instants.push((*now.get()).clone());
    }
    instants
}

fn assert_is_the_log(log: &Recording, instants: &[Instant]) {
    let ego = EgoTrack::new(log);
    for (step, instant) in instants.iter().enumerate() {
        assert_eq!(instant.step, step);
        assert_eq!(Some(instant.ego.pose), ego.at(instant.t_us), "step {step}");
        let boxes: Vec<_> = instant.actors.iter().map(|a| a.track_box()).collect();
        assert_eq!(boxes, log.boxes_at(instant.t_us), "step {step}");
    }
}

#[test]
fn replay_at_logged_times_equals_the_log_bit_for_bit() {
    let log = winding_road::log(6);
    let options = SimOptions { steps: 60, ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    let instants = all(&mut sim);
    assert_eq!((instants.len(), sim.ended()), (61, Some(EndReason::Steps)));
    for (instant, frame) in instants.iter().zip(&log.frames) {
        assert_eq!((instant.t_us, instant.ego.pose), (frame.t_us, frame.global_from_ego));
        let boxes: Vec<_> = instant.actors.iter().map(|a| a.track_box()).collect();
        assert_eq!(boxes, frame.boxes);
        // Constant speed along the heading, which is uphill.
        assert!((instant.ego.speed_mps - 8.0).abs() < 0.02, "{}", instant.ego.speed_mps);
        assert!(instant.ego.acceleration_mps2.abs() < 0.2);
    }
    assert_eq!(instants[49].lights[0].color, "red");
    assert_eq!(instants[50].lights[0].color, "green");
    let metrics = sim.metrics();
    assert!(metrics.collisions.is_empty() && metrics.off_road.is_none() && metrics.comfort.comfortable);
    assert!((metrics.progress_m - metrics.log_progress_m).abs() < 1e-6);
    assert!(metrics.lateral_deviation_m.max < 1e-6 && metrics.heading_deviation_rad.max < 1e-6);
}

#[test]
fn steps_between_frames_are_interpolated_and_the_log_ends() {
    let log = winding_road::log(3);
    let options = SimOptions { steps: 1000, sim_hz: Some(12.0), plan_hz: Some(6.0), ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    let instants = all(&mut sim);
    assert_is_the_log(&log, &instants);
    assert_eq!((instants.len(), sim.ended()), (37, Some(EndReason::LogEnded)));
    assert_eq!(instants[36].t_us, winding_road::FIRST_US + 3_000_000);
    // The rollout stays ended.
    assert_eq!(sim.step().unwrap(), None);
    assert_eq!(sim.committed().get().step, 36);
}

#[test]
fn forecasts_of_a_replay_equal_the_log() {
    let log = winding_road::log(4);
    let options = SimOptions { steps: 40, ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    loop {
        // At any step, including the first, and up to the end of the log.
        let step = sim.committed().get().step;
        let forecast = sim.forecast(5);
        assert_eq!(forecast.len(), 5.min((40 - step) / 2), "step {step}");
        assert!(sim.forecast(0).is_empty() && sim.forecast(3) == forecast[..3.min(forecast.len())]);
        for (k, forecast) in forecast.iter().enumerate() {
            let instant = forecast.get();
            assert_eq!(instant.step, step + 2 * (k + 1));
            assert_eq!(instant.ego.pose, log.frames[instant.step].global_from_ego);
        }
        let Some(outcome) = sim.step().unwrap() else { break };
        assert_eq!(outcome.plan, None);
    }
    assert_eq!((sim.committed().get().step, sim.steps_per_plan()), (40, 2));
}

/// Forecasts of self-driving actors come true although the ego has no plan.
#[test]
fn forecasts_during_a_replay_match() {
    for actors in [ActorPolicy::Idm, ActorPolicy::Reactive] {
        let log = winding_road::log(4);
        let options = SimOptions { steps: 30, actors, ..SimOptions::default() };
        let mut sim = winding_road::start(&log, &options);
        let mut expected = sim.forecast(4);
        let mut seen = 0;
        while sim.step().unwrap().is_some() {
            let now: Instant = (*sim.committed().get()).clone();
            for forecast in expected.iter().filter(|forecast| forecast.get().step == now.step) {
                assert_eq!(*forecast.get(), now);
                seen += 1;
            }
            expected.extend(sim.forecast(4));
        }
        assert!(seen > 40, "{seen}");
    }
}

#[test]
fn options_that_do_not_fit_are_usage_errors() {
    let log = winding_road::log(2);
    let fails = |options: SimOptions| {
        let error = Simulation::new(&winding_road::scenario(&log), options).err().unwrap();
        assert!(error.is_usage(), "{error}");
        error.to_string()
    };
    assert!(fails(SimOptions { steps: 0, ..SimOptions::default() }).contains("at least one step"));
    let message = fails(SimOptions { sim_hz: Some(12.0), ..SimOptions::default() });
    assert!(message.contains("12 Hz and 5 Hz"), "{message}");
    let before = SimOptions { start_us: Some(winding_road::FIRST_US - 1), ..SimOptions::default() };
    assert!(fails(before).contains("made"));
    assert!(fails(SimOptions { start_us: Some(i64::MAX), ..SimOptions::default() }).contains("made"));
    let nothing = Recording::default();
    let error = Simulation::new(&winding_road::scenario(&nothing), SimOptions::default()).err().unwrap();
    assert!(matches!(error, SimError::NoFrames { .. }));
}

#[test]
fn logs_with_gaps_or_missing_parts_work() {
    for policy in [EgoPolicy::Replay, EgoPolicy::LaneChange, EgoPolicy::Straight, EgoPolicy::Cosine] {
        for actors in [ActorPolicy::Replay, ActorPolicy::Idm, ActorPolicy::Reactive] {
            let options = SimOptions { steps: 30, ego: policy.clone(), actors, ..SimOptions::default() };
            // A single frame: replay ends at once, the other policies drive on.
            let single = winding_road::log_at(&[0]);
            let mut sim = winding_road::start(&single, &options);
            let instants = all(&mut sim);
            let replay = policy == EgoPolicy::Replay;
            assert_eq!(instants.len(), if replay { 1 } else { 31 }, "{policy:?}");
            assert_eq!(sim.ended(), Some(if replay { EndReason::LogEnded } else { EndReason::Steps }));
            assert!(
                instants.iter().all(|i| i.ego.pose.translation.is_finite() && i.ego.speed_mps.is_finite())
            );
            // A gap, and no boxes.
            let mut gap = winding_road::log_at(&[0, 100_000, 200_000, 2_400_000, 2_500_000]);
            gap.frames.iter_mut().for_each(|f| f.boxes.clear());
            let mut sim = winding_road::start(&gap, &options);
            assert!(all(&mut sim).iter().all(|i| i.ego.pose.translation.is_finite()));
            let notes: Vec<_> = sim.notes().into_iter().collect();
            assert_eq!(
                notes,
                [
                    ("gaps of more than 1 s between frames".to_owned(), 1),
                    ("logs without boxes".to_owned(), 1)
                ]
            );
        }
    }
}

#[test]
fn replayed_actors_are_removed_when_their_track_ends() {
    let log = winding_road::log(2);
    let options = SimOptions { steps: 40, ego: EgoPolicy::Straight, ..SimOptions::default() };
    let instants = all(&mut winding_road::start(&log, &options));
    // A sixth actor appears in the last frame.
    let counts = [19, 20, 21].map(|step| instants[step].actors.len());
    assert_eq!((counts, instants.len()), ([5, 6, 0], 41));
    assert_eq!(instants[40].lights, log.lights[20..]);
}

#[test]
fn conditions_are_created_from_instants() {
    let log = winding_road::log(2);
    let sim = winding_road::start(&log, &SimOptions::default());
    let instant = sim.committed().get().to_owned().clone();
    let state = scene_state(&log, &instant, None);
    assert_eq!((state.name.as_str(), state.t_us), ("000000", winding_road::FIRST_US));
    assert_eq!(state.global_from_ego, instant.ego.pose);
    let tracks: Vec<&str> = state.actors.iter().map(|a| a.track.as_str()).collect();
    assert_eq!(tracks, ["cone", "lead", "oncoming", "parked", "walker"]);
    assert_eq!(state.actors[1].cuboid, instant.actors[1].cuboid);
}

#[test]
fn the_ego_box_is_placed_relative_to_its_rear_axle() {
    let log = winding_road::log(1);
    let ego = winding_road::start(&log, &SimOptions::default()).committed().get().ego;
    let local = ego.pose.inverse() * ego.cuboid().pose;
    assert!((local.translation - DVec3::new(1.461, 0.0, 1.777 / 2.0)).length() < 1e-9);
    assert_eq!(ego.cuboid().size.truncate(), DVec2::new(5.176, 2.297));
}

#[test]
fn a_real_drive_is_replayed_exactly() {
    let Some(shared) = shared("the PandaSet drive") else { return };
    let locator = LogLocator::new(
        &point_skeleton::dataset::nuscenes::FORMAT,
        shared.join("data/pandaset-002/nuscenes"),
    );
    let drive = NuScenes::open(&locator).unwrap();
    let scenario = Scenario {
        log: drive.recording(),
        map: None,
        rates: Rates::of(&point_skeleton::dataset::nuscenes::FORMAT, drive.recording()),
    };
    assert_eq!(scenario.rates, Rates::NUSCENES);
    let mut sim = Simulation::new(&scenario, SimOptions { steps: 500, ..SimOptions::default() }).unwrap();
    let instants = all(&mut sim);
    assert_is_the_log(drive.recording(), &instants);
    assert_eq!(sim.ended(), Some(EndReason::LogEnded));
    let seconds =
        (drive.recording().frames.last().unwrap().t_us - drive.recording().frames[0].t_us) as f64 / 1e6;
    assert_eq!(instants.len(), (seconds * 12.0) as usize + 1);
    assert!(instants.iter().any(|i| !i.actors.is_empty()));
}
