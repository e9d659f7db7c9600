//! Planners in Python: the example, and what planners see.

mod failures;

use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

use glam::DVec2;
use point_skeleton::dataset::{MapFiles, NavigationRoute, Recording};
use point_skeleton::geometry::{Polyline, Pose};
use pskel_sim::{
    EgoPolicy, EndReason, PlannerAddress, PlannerSpec, SavedState, SimOptions, Simulation, Tracking,
};
use pskel_testing::winding_road;

const HELLO: &str = r#"print('{"protocol": "pskel-planner", "version": 1}', flush=True)"#;

fn example() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/planner.py")
}

fn options(address: PlannerAddress, timeout_s: f64) -> SimOptions {
    let ego = EgoPolicy::External(PlannerSpec { address, timeout_s });
    SimOptions { steps: 60, warmup_frames: 3, ego, ..SimOptions::default() }
}

fn command(text: String) -> PlannerAddress {
    PlannerAddress::Command(text)
}

/// Planner that runs some lines of Python; `see()` returns the next message.
fn script(folder: &Path, lines: &str) -> PlannerAddress {
    let path = folder.join("planner.py");
    let head = "import json, sys, time\ndef see():\n    return json.loads(sys.stdin.readline())\n";
    std::fs::write(&path, format!("{head}{lines}\n")).unwrap();
    command(format!("exec python3 {}", path.display()))
}

/// Drives with the example planner; returns a description of every step.
fn assert_drives(log: &Recording, options: SimOptions) -> Vec<String> {
    let mut sim = Simulation::new(&winding_road::scenario(log), options).unwrap();
    let mut reported = Vec::new();
    while let Some(outcome) = sim.step().unwrap() {
        reported.push(format!("{:?} {outcome:?}", sim.committed()));
    }
    assert_eq!(sim.ended(), Some(EndReason::Steps));
    let metrics = sim.metrics();
    assert!(metrics.lateral_deviation_m.max < 0.5, "{metrics:?}");
    assert!(metrics.progress_m > 25.0 && metrics.collisions.is_empty(), "{metrics:?}");
    reported
}

#[test]
fn the_example_drives_over_pipes() {
    let log = winding_road::log(6);
    let address = command(format!("exec python3 {}", example().display()));
    let reported = assert_drives(&log, options(address.clone(), 20.0));
    // With a planner that depends only on its observations, rollouts can be repeated and resumed.
    let mut sim = Simulation::new(&winding_road::scenario(&log), options(address.clone(), 20.0)).unwrap();
    for _ in 0..21 {
        sim.step().unwrap();
    }
    let saved: SavedState = serde_json::from_value(serde_json::to_value(sim.save()).unwrap()).unwrap();
    let mut resumed =
        Simulation::resume(&winding_road::scenario(&log), options(address.clone(), 20.0), &saved).unwrap();
    for line in &reported[21..] {
        let outcome = resumed.step().unwrap().unwrap();
        assert_eq!(&format!("{:?} {outcome:?}", resumed.committed()), line);
    }
    assert_drives(&log, SimOptions { tracking: Tracking::Bicycle, ..options(address, 20.0) });
}

struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_example_drives_over_sockets() {
    let log = winding_road::log(6);
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("planner");
    // A port that was free just before.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let cases = [
        (format!("unix:{}", socket.display()), PlannerAddress::Unix(socket.clone())),
        (format!("tcp:127.0.0.1:{port}"), PlannerAddress::Tcp(format!("127.0.0.1:{port}"))),
    ];
    // A stale socket of an earlier run is in the way; no process listens on it.
    drop(UnixListener::bind(&socket).unwrap());
    for (argument, address) in cases {
        assert_eq!(argument.parse::<PlannerAddress>().unwrap(), address, "the same name on both sides");
        // The client waits until the server listens.
        let mut server = Server(Command::new("python3").arg(example()).arg(argument).spawn().unwrap());
        assert_drives(&log, options(address, 20.0));
        assert!(server.0.wait().unwrap().success(), "it ends with the connection");
    }
}

#[test]
fn the_example_stops_at_the_end_of_the_path() {
    let log = winding_road::log(4);
    let end = log.frames[40].global_from_ego;
    let options =
        SimOptions { steps: 140, ..options(command(format!("exec python3 {}", example().display())), 20.0) };
    let mut sim = Simulation::new(&winding_road::scenario(&log), options.clone()).unwrap();
    while sim.step().unwrap().is_some() {}
    let ego = sim.committed().get().ego;
    let local = end.inverse().transform_point(ego.pose.translation);
    assert!(ego.speed_mps < 0.01 && local.x.abs() < 2.0 && local.y.abs() < 0.5, "{local} {}", ego.speed_mps);
    assert!(sim.metrics().lateral_deviation_m.max < 0.5, "{:?}", sim.metrics().lateral_deviation_m);
    // Started at the end of the path at full speed, it brakes on a straight line.
    let late =
        SimOptions { steps: 80, start_us: Some(winding_road::FIRST_US + 3_600_000), ..options.clone() };
    let mut sim = Simulation::new(&winding_road::scenario(&log), late).unwrap();
    while sim.step().unwrap().is_some() {}
    let ego = sim.committed().get().ego;
    let local = end.inverse().transform_point(ego.pose.translation);
    assert!(ego.speed_mps < 0.01 && (5.0..20.0).contains(&local.x), "{local} {}", ego.speed_mps);
    assert!(local.y.abs() < 0.5, "{local}");
}

/// Planner that appends its messages to the file `seen` of a folder, and drives straight on at 8 m/s with
/// trajectories in the ego frame.
fn recorder(folder: &Path) -> PlannerAddress {
    let lines = format!(
        "out = open({:?}, 'a')\nwhile True:\n    m = see()\n    print(json.dumps(m), file=out, flush=True)\
            \n    \
         print(json.dumps({{'frame': 'ego', 'trajectory': [{{'t': 0, 'x': 9, 'y': 9, 'heading': 9, 'v': 9}}, \
         {{'t': 3, \
         'x': 24, 'y': 0, 'heading': 0, 'v': 8}}]}}) if 'type' in m else '{{\"protocol\": \"pskel-planner\", \
         \"version\": 1}}', flush=True)",
        folder.join("seen").display().to_string()
    );
    script(folder, &lines)
}

/// Returns the messages that [`recorder`] received.
fn seen(folder: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(folder.join("seen")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn planners_receive_the_documented_messages() {
    let log = winding_road::log(6);
    let folder = tempfile::tempdir().unwrap();
    let options = SimOptions { steps: 8, seed: 77, ..options(recorder(folder.path()), 20.0) };
    let mut sim = Simulation::new(&winding_road::scenario(&log), options).unwrap();
    sim.show(vec!["a.png".into()]);
    while sim.step().unwrap().is_some() {}
    let start = log.frames[4].global_from_ego;
    let local = start.inverse().transform_point(sim.committed().get().ego.pose.translation);
    assert!((local.x - 3.2).abs() < 0.01 && local.y.abs() < 0.01, "8 m/s along its own x: {local}");
    let messages = seen(folder.path());
    assert_eq!(messages.len(), 3);
    assert_eq!(
        (&messages[0]["seed"], &messages[0]["step"], &messages[0]["log"]),
        (&77.into(), &0.into(), &"made".into())
    );
    assert_eq!((&messages[0]["plan_hz"], &messages[0]["ego"]["wheelbase"]), (&5.0.into(), &3.089.into()));
    let see = &messages[1];
    assert_eq!((&see["step"], &see["plan_dt"]), (&4.into(), &0.2.into()));
    assert_eq!(see["t_us"], winding_road::FIRST_US + 400_000);
    assert_eq!((&see["history"][0]["files"][0], &see["files"]), (&"a.png".into(), &serde_json::json!([])));
    assert_eq!(see["ego"]["x"], start.translation.x);
    assert_eq!((&see["lights"][0]["color"], &see["actors"][1]["track"]), (&"red".into(), &"lead".into()));
    assert_eq!(
        (&see["actors"][1]["class"], &see["actors"][1]["length"]),
        (&"motor_vehicle".into(), &4.4.into())
    );
    let path = see["path"].as_array().unwrap();
    assert_eq!(path.len(), 46, "44.8 m are left of 48");
    assert!((path[0][0].as_f64().unwrap() - start.translation.x).abs() < 1e-6);
}

/// States of the last 2 s come with the first observation, of the log before the start; then those since the
/// last one.
#[test]
fn planners_receive_the_past_once() {
    let log = winding_road::log(6);
    let folder = tempfile::tempdir().unwrap();
    let start_us = winding_road::FIRST_US + 1_800_000;
    let options = SimOptions { steps: 9, start_us: Some(start_us), ..options(recorder(folder.path()), 20.0) };
    let scenario = winding_road::scenario(&log);
    let mut sim = Simulation::new(&scenario, options.clone()).unwrap();
    let (mut states, mut saved) = (Vec::new(), Vec::new());
    loop {
        let step = sim.committed().get().step;
        states.push(Clone::clone(*sim.committed().get()));
        saved.push((sim.save(), vec![PathBuf::from(format!("{step}.png"))]));
        sim.show(saved[step].1.clone());
        if step == 7 || sim.step().unwrap().is_none() {
            break;
        }
    }
    let steps = |see: &serde_json::Value| -> Vec<i64> {
        see["history"].as_array().unwrap().iter().map(|past| past["step"].as_i64().unwrap()).collect()
    };
    let messages = seen(folder.path());
    assert_eq!(messages.len(), 3);
    assert_eq!(steps(&messages[1]), (-16..4).collect::<Vec<_>>(), "2 s before step 4");
    assert_eq!((steps(&messages[2]), &messages[2]["step"]), (vec![5], &6.into()));
    for past in
        messages[1]["history"].as_array().unwrap().iter().chain(messages[2]["history"].as_array().unwrap())
    {
        let step = past["step"].as_i64().unwrap();
        let t_us = start_us + step * 100_000;
        assert_eq!(past["t_us"], t_us);
        // The made log has a frame at each step.
        let frame = log.frames.iter().find(|frame| frame.t_us == t_us).unwrap();
        let pose = if step == 5 { states[5].ego.pose } else { frame.global_from_ego };
        assert_eq!(
            (&past["ego"]["x"], &past["ego"]["y"]),
            (&pose.translation.x.into(), &pose.translation.y.into())
        );
        let centers: Vec<serde_json::Value> =
            frame.boxes.iter().map(|b| b.cuboid.pose.translation.x.into()).collect();
        let reported: Vec<_> =
            past["actors"].as_array().unwrap().iter().map(|actor| actor["x"].clone()).collect();
        assert_eq!(reported, centers);
        let files = if step < 0 { serde_json::json!([]) } else { serde_json::json!([format!("{step}.png")]) };
        assert_eq!(past["files"], files);
    }
    // A resumed rollout has a new planner, which sees the past again.
    let last = saved.pop().unwrap();
    let mut resumed = Simulation::resume(&scenario, options, &last.0).unwrap();
    resumed.restore_history(saved).unwrap();
    while resumed.step().unwrap().is_some() {}
    let again = &seen(folder.path())[4];
    assert_eq!((steps(again), &again["step"]), ((-12..8).collect(), &8.into()));
    assert_eq!(again["history"].as_array().unwrap()[..16], messages[1]["history"].as_array().unwrap()[4..]);
    assert_eq!(again["history"][17], messages[2]["history"][0]);
}

/// Velocities belong to the synthetic actors, also to one that comes towards the ego on a curve.
#[test]
fn planners_receive_velocities() {
    let log = winding_road::log(6);
    let folder = tempfile::tempdir().unwrap();
    // At 1.4 s the log surrounds the 0.6 s window for fitting lines.
    let start_us = Some(winding_road::FIRST_US + 1_000_000);
    let options = SimOptions { start_us, ..options(recorder(folder.path()), 20.0) };
    let mut sim = Simulation::new(&winding_road::scenario(&log), options).unwrap();
    for _ in 0..5 {
        sim.step().unwrap();
    }
    let see = &seen(folder.path())[1];
    assert_eq!(see["step"], 4);
    for (track, actor) in (1..).zip(see["actors"].as_array().unwrap()) {
        let number = |key: &str| actor[key].as_f64().unwrap();
        let velocity = DVec2::new(number("vx"), number("vy"));
        // A central difference between the boxes of the frames before and after.
        let [before, after] = [13, 15].map(|frame: usize| log.frames[frame].cuboid_of(track).unwrap().pose);
        let moved = (after.translation - before.translation).truncate() / 0.2;
        assert!((velocity - moved).length() < 0.02, "{actor}: {velocity}, expected {moved}");
        assert!((velocity.dot(DVec2::from_angle(number("heading"))) - number("v")).abs() < 1e-9);
        let turned = point_skeleton::geometry::wrap_angle(after.yaw_rad() - before.yaw_rad()) / 0.2;
        assert!((number("yaw_rate") - turned).abs() < 0.01, "{actor}: expected {turned}");
    }
}

/// The route of the first plan comes with the hello; other logs have none.
#[test]
fn planners_receive_route_and_map() {
    let plain = winding_road::log(2);
    let goal = Pose::from_yaw(0.5, glam::DVec3::new(1.0, 2.0, 3.0));
    let route = |frame: usize, id: &str, goal| NavigationRoute { frame, roadblocks: vec![id.into()], goal };
    let routed = Recording {
        routes: vec![route(0, "1", None), route(3, "2", Some(goal)), route(8, "3", None)],
        map_files: Some(MapFiles { name: "town".into(), root: "/maps".into() }),
        ..plain.clone()
    };
    let hello = |log: &Recording| {
        let folder = tempfile::tempdir().unwrap();
        drop(Simulation::new(&winding_road::scenario(log), options(recorder(folder.path()), 20.0)).unwrap());
        seen(folder.path()).swap_remove(0)
    };
    let reported = |log: &Recording| {
        let hello = hello(log);
        ["route", "goal", "map"].map(|key| hello[key].clone())
    };
    let json = |value| -> serde_json::Value { value };
    assert_eq!(reported(&plain), [json(serde_json::json!([])), json(().into()), json(().into())]);
    let [route, goal, map] = reported(&routed);
    assert_eq!(route, serde_json::json!(["2"]), "the route at step 4");
    assert_eq!((&goal["x"], &goal["y"]), (&1.0.into(), &2.0.into()));
    assert!((goal["heading"].as_f64().unwrap() - 0.5).abs() < 1e-12);
    assert_eq!(map, serde_json::json!({"name": "town", "root": "/maps"}));
}

/// The path that a planner sees continues in driving order, also where it crosses itself.
#[test]
fn self_crossing_paths_are_sent_in_order() {
    // East, around to the left, and south, crossing its own path at 20 m.
    let corners = [(0.0, 0.0), (40.0, 0.0), (40.0, 20.0), (20.0, 20.0), (20.0, -20.0)].map(DVec2::from);
    let line = Polyline::new(corners).unwrap();
    let mut log = winding_road::log(15);
    for (i, frame) in log.frames.iter_mut().enumerate() {
        let (place, direction) = line.at(0.8 * i as f64);
        frame.global_from_ego = Pose::from_yaw(direction.to_angle(), place.extend(0.0));
    }
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    // Drives to where the first part of the path is nearer than the last, and records the path it sees there.
    let lines = format!(
        "see()\n{HELLO}\nwhile True:\n    m = see()\n    open({:?}, 'w').write(json.dumps(m['path']))\n    \
         print(json.dumps({{'trajectory': [{{'t': 0.2, 'x': 20.9, 'y': 0.1, 'heading': -1.57, 'v': 4}}]}}), \
         flush=True)",
        seen.display().to_string()
    );
    let takeover = 124; // 0.8 m before the crossing
    let options = SimOptions {
        steps: takeover + 3,
        warmup_frames: takeover / 2 + 1,
        ..options(script(folder.path(), &lines), 20.0)
    };
    let mut sim = Simulation::new(&winding_road::scenario(&log), options).unwrap();
    while sim.step().unwrap().is_some() {}
    let path: Vec<[f64; 2]> = serde_json::from_slice(&std::fs::read(&seen).unwrap()).unwrap();
    assert_eq!(path.len(), 22, "20.1 m are left: {path:?}");
    let near = |[x, y]: [f64; 2], place: [f64; 2]| (x - place[0]).abs() < 1e-6 && (y - place[1]).abs() < 1e-6;
    assert!(near(path[0], [20.0, 0.1]) && near(path[5], [20.0, -4.9]) && near(path[21], [20.0, -20.0]));
}
