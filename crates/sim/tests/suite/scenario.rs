//! Scenarios in simulations: conditions of the simulated ego, hand-over to a driver model, and resuming.

use glam::DVec3;
use point_skeleton::Log;
use point_skeleton::dataset::{
    ActorEdits, DatasetError, ImageRecord, LogReader, Recording, Sweep, SweepRecord,
};
use point_skeleton::geometry::Cuboid;
use point_skeleton::scene::{EgoOffset, state_of_frame};
use pskel_sim::{
    ActorPolicy, EgoPolicy, Instant, SavedState, SimActor, SimError, SimOptions, Simulation, scene_state,
};
use pskel_testing::winding_road;
use serde_json::{Value, json};

pub(crate) struct Reader(pub(crate) Recording);

impl LogReader for Reader {
    fn recording(&self) -> &Recording {
        &self.0
    }

    fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
        unreachable!("the log has no sweeps")
    }

    fn read_image(&self, _: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        unreachable!("the log has no images")
    }
}

fn log() -> Log {
    Log::new(Box::new(Reader(winding_road::log(6))))
}

fn edited(scenario: Value) -> Log {
    let edits: ActorEdits = serde_json::from_value(scenario).unwrap();
    log().edited(&edits).unwrap()
}

fn options(ego: EgoPolicy, actors: ActorPolicy) -> SimOptions {
    SimOptions { steps: 50, ego, actors, ..SimOptions::default() }
}

fn run(log: &Log, options: &SimOptions) -> Vec<Instant> {
    let mut simulation = winding_road::start(log.recording(), options);
    let mut instants = vec![(*simulation.committed().get()).clone()];
    while simulation.step().unwrap().is_some() {
        instants.push((*simulation.committed().get()).clone());
    }
    instants
}

/// Returns the distance of an actor from its first place and its speed, at a step.
fn moved(log: &Log, instants: &[Instant], id: &str, step: usize) -> Option<(f64, f64)> {
    let track = log.recording().tracks.iter().position(|track| track.id == id).unwrap();
    let of = |instant: &Instant| instant.actors.iter().find(|actor| actor.track == track).copied();
    let place = |actor: &SimActor| actor.cuboid.pose.translation.truncate();
    let first = place(&instants.iter().find_map(of)?);
    let actor = of(&instants[step])?;
    Some((place(&actor).distance(first), actor.speed_mps))
}

/// A parked car that pulls out when the ego is within 40 m of it, and is handed to the driver model 1 s later
/// by the clock of the log.
fn pulling_out() -> Value {
    let point = |x_m: f64, speed_mps: f64| json!({"x_m": x_m, "y_m": 0.0, "speed_mps": speed_mps});
    let path = json!({"path": {"in": "actor", "points": [point(0.0, 0.0), point(10.0, 5.0)]}});
    json!({"changes": [
        {"track": "parked", "action": path, "start": {"ego_within": {"distance_m": 40.0}}},
        {"track": "parked", "action": "idm", "start": {"after_s": 4.0}},
        {"track": "lead", "action": "remove", "start": {"after_s": 1.0}},
        {"track": "oncoming", "action": {"resize": [9.0, 2.5, 3.0]}, "start": {"after_s": 1.5},
         "end": {"after_s": 3.0}},
    ]})
}

#[test]
fn an_empty_scenario_changes_nothing() {
    let all = options(EgoPolicy::LaneChange, ActorPolicy::Idm);
    let (plain, empty) = (log(), edited(json!({"changes": []})));
    assert_eq!(run(&plain, &all), run(&empty, &all));
    let saved =
        |log: &Log| serde_json::to_string(&winding_road::start(log.recording(), &all).save()).unwrap();
    assert_eq!(saved(&plain), saved(&empty));
}

#[test]
fn conditions_are_those_of_the_simulated_ego() {
    let log = edited(pulling_out());
    let replayed = run(&log, &options(EgoPolicy::Replay, ActorPolicy::Replay));
    // About 20 m from its start.
    let parked = winding_road::road(60.0, -6.0).translation.truncate();
    let near = replayed.iter().position(|now| now.ego.position_m().distance(parked) <= 40.0).unwrap();
    assert!((24..28).contains(&near), "{near}");
    assert_eq!(moved(&log, &replayed, "parked", near - 1), Some((0.0, 0.0)));
    // 0 to 5 m/s over 10 m: 1.25 m/s².
    let (distance_m, speed_mps) = moved(&log, &replayed, "parked", near + 10).unwrap();
    assert!((distance_m - 0.625).abs() < 1e-3, "{distance_m}");
    assert!((speed_mps - 1.25 * 1.05).abs() < 1e-3, "{speed_mps}"); // the mean over the next 0.1 s
    // As in the log, whose ego is the same.
    let track = 4;
    for instant in &replayed[..40] {
        let frame = log.recording().frames.iter().find(|frame| frame.t_us == instant.t_us).unwrap();
        let actor = instant.actors.iter().find(|actor| actor.track == track).unwrap();
        assert_eq!(frame.cuboid_of(track), Some(actor.cuboid), "step {}", instant.step);
    }
    assert!(replayed[9].actors.iter().any(|actor| actor.track == 2));
    assert!(replayed[10..].iter().all(|instant| instant.actors.iter().all(|actor| actor.track != 2)));
    // An ego that stops never comes near.
    let mut stopped = winding_road::start(
        log.recording(),
        &SimOptions {
            steps: 50,
            sim_hz: Some(10.0),
            plan_hz: Some(10.0),
            ..options(EgoPolicy::Caller, ActorPolicy::Replay)
        },
    );
    while !stopped.is_done() {
        let place = stopped.recorded_waypoint(winding_road::FIRST_US).unwrap();
        let plan = pskel_sim::Waypoint { t_us: stopped.next_us(), speed_mps: 0.0, ..place };
        stopped.follow_waypoints(vec![plan]).unwrap();
        stopped.step().unwrap();
    }
    let last = (*stopped.committed().get()).clone();
    assert_eq!(moved(&log, &[replayed[0].clone(), last], "parked", 1), Some((0.0, 0.0)));
}

#[test]
fn a_driver_model_goes_on_along_the_path() {
    let log = edited(pulling_out());
    let instants = run(&log, &options(EgoPolicy::Replay, ActorPolicy::Replay));
    // From 4 s on it accelerates by 1 m/s² at most, instead of by the path's 1.25 m/s².
    let speed = |step: usize| moved(&log, &instants, "parked", step).unwrap().1;
    let gained = speed(48) - speed(43);
    assert!(gained > 0.3 && gained <= 0.5 + 1e-9, "{gained}");
    assert_eq!(log.recording().edits.first_simulated(), Some(2));
}

#[test]
fn an_inserted_car_is_a_leader() {
    // 12 m ahead of the car that leads the ego, in its lane.
    let at = winding_road::road(45.0, 0.0);
    let place = json!({"in": "global", "x_m": at.translation.x, "y_m": at.translation.y,
        "yaw_deg": at.yaw_rad().to_degrees()});
    let insert = json!({"insert": {"category": "vehicle.car", "size_m": [4.4, 1.8, 1.5], "at": place}});
    let log = edited(json!({"changes": [{"track": "broken", "action": insert}]}));
    let idm = options(EgoPolicy::Replay, ActorPolicy::Idm);
    let (free, held) = (run(&self::log(), &idm), run(&log, &idm));
    let plain = self::log();
    let speeds = |log: &Log, instants: &[Instant]| moved(log, instants, "lead", 30).unwrap().1;
    assert!(speeds(&plain, &free) > 7.0 && speeds(&log, &held) < 4.0);
    let broken = moved(&log, &held, "broken", 30);
    assert_eq!(broken, Some((0.0, 0.0)));
}

/// Returns the size and the lower edge of an actor at all steps, meters.
fn extents(log: &Log, instants: &[Instant], id: &str) -> Vec<([f64; 3], f64)> {
    let track = log.recording().tracks.iter().position(|track| track.id == id).unwrap();
    let of = |instant: &Instant| {
        let Cuboid { pose, size } = instant.actors.iter().find(|actor| actor.track == track).unwrap().cuboid;
        let down = pose.rotation * DVec3::new(0.0, 0.0, -size.z / 2.0);
        (size.to_array(), (pose.translation + down).z)
    };
    instants.iter().map(of).collect()
}

#[test]
fn sizes_change_at_times_on_the_same_ground() {
    let (car, bus) = ([4.4, 1.8, 1.5], [12.0, 2.5, 3.2]);
    let near = json!({"ego_within": {"distance_m": 40.0}});
    let log = edited(json!({"changes": [
        {"track": "lead", "action": {"resize": bus}, "start": {"after_s": 1.0}, "end": {"after_s": 2.0}},
        {"track": "parked", "action": {"resize": bus}, "start": near},
    ]}));
    let plain = self::log();
    for actors in [ActorPolicy::Replay, ActorPolicy::Idm, ActorPolicy::Reactive] {
        let options = options(EgoPolicy::Replay, actors);
        let (changed, same) = (run(&log, &options), run(&plain, &options));
        let lead = extents(&log, &changed, "lead");
        let sizes: Vec<[f64; 3]> = lead.iter().map(|(size, _)| *size).collect();
        let expected = (0..51).map(|step| if (10..20).contains(&step) { bus } else { car });
        assert_eq!(sizes, expected.collect::<Vec<_>>(), "{actors:?}");
        // It moves as before, apart from its driver's view of what is ahead.
        let ground = extents(&plain, &same, "lead");
        let rises = lead.iter().zip(&ground).map(|((_, found), (_, expected))| (found - expected).abs());
        assert!(rises.fold(0.0, f64::max) < 0.02, "{actors:?}");
        let parked = extents(&log, &changed, "parked");
        let near = parked.iter().position(|(size, _)| *size == bus).unwrap();
        assert!((24..28).contains(&near) && parked[near..].iter().all(|(size, _)| *size == bus), "{near}");
        assert!(parked.iter().all(|(_, ground)| (ground - parked[0].1).abs() < 1e-9), "{actors:?}");
    }
}

#[test]
fn looks_change_at_times() {
    let log = edited(json!({"changes": [
        {"track": "lead", "action": {"replace": "oncoming"},
            "start": {"after_s": 1.0}, "end": {"after_s": 2.0}},
        {"track": "parked", "action": {"replace": "template"}, "start": {"after_s": 3.0}},
    ]}));
    let instants = run(&log, &options(EgoPolicy::Replay, ActorPolicy::Replay));
    let look = |step: usize, id: &str| {
        let state = scene_state(log.recording(), &instants[step], None);
        let actor = state.actors.iter().find(|actor| actor.track == id).unwrap();
        (actor.asset().map(str::to_owned), actor.category.clone())
    };
    for (step, expected) in [(9, "lead"), (10, "oncoming"), (19, "oncoming"), (20, "lead")] {
        let category = if expected == "lead" { "vehicle.car" } else { "vehicle.truck" };
        assert_eq!(look(step, "lead"), (Some(expected.to_owned()), category.to_owned()), "{step}");
    }
    let parked = [29, 30, 50].map(|step| look(step, "parked").0.is_some());
    assert_eq!(parked, [true, false, false]);
    // In the log as in the simulation.
    let in_log = state_of_frame(log.recording(), 15, EgoOffset::default()).unwrap();
    let in_step = scene_state(log.recording(), &instants[15], None);
    assert_eq!(in_log.actors, in_step.actors);
}

#[test]
fn impossible_sizes_and_looks_are_refused() {
    let near = json!({"ego_within": {"distance_m": 4.0}});
    let refused = |change: Value| {
        let edits: ActorEdits = serde_json::from_value(json!({"changes": [change]})).unwrap();
        log().edited(&edits).err().unwrap().to_string()
    };
    for (change, expected) in [
        (
            json!({"track": "lead", "action": {"resize": [0.0, 1.0, 1.0]}}),
            "expected the size of a box in change 1",
        ),
        (
            json!({"track": "lead", "action": {"replace": "walker"}}),
            "expected the look of a track with the actor's class in change 1, of track lead, found \
                \"walker\"",
        ),
        (json!({"track": "lead", "action": {"replace": "nobody"}}), "expected the look of a track"),
        (
            json!({"track": "lead", "action": {"replace": {"file": "a.ply"}}}),
            "expected a track of the log, or template: files are for the whole log",
        ),
        (
            json!({"track": "lead", "action": {"replace": "template"}, "start": near}),
            "expected replace from a time on, to a time in change 1",
        ),
    ] {
        let message = refused(change);
        assert!(message.starts_with(expected), "{message}");
    }
}

#[test]
fn resuming_equals_an_uninterrupted_run() {
    let log = edited(pulling_out());
    for (ego, actors) in [
        (EgoPolicy::Replay, ActorPolicy::Replay),
        (EgoPolicy::LaneChange, ActorPolicy::Idm),
        (EgoPolicy::Straight, ActorPolicy::Reactive),
    ] {
        let options = options(ego, actors);
        let mut through = winding_road::start(log.recording(), &options);
        let mut states = vec![serde_json::to_string(&through.save()).unwrap()];
        while through.step().unwrap().is_some() {
            states.push(serde_json::to_string(&through.save()).unwrap());
        }
        for cut in [0, 12, 27, 41, 47] {
            let saved: SavedState = serde_json::from_str(&states[cut]).unwrap();
            let scenario = winding_road::scenario(log.recording());
            let mut resumed = Simulation::resume(&scenario, options.clone(), &saved).unwrap();
            while resumed.step().unwrap().is_some() {}
            assert_eq!(serde_json::to_string(&resumed.save()).unwrap(), *states.last().unwrap(), "{cut}");
        }
        // Another scenario, or none.
        let saved: SavedState = serde_json::from_str(&states[30]).unwrap();
        let plain = self::log();
        let scenario = winding_road::scenario(plain.recording());
        let other = Simulation::resume(&scenario, options.clone(), &saved);
        assert!(matches!(other.err(), Some(SimError::Saved { .. })));
    }
}
