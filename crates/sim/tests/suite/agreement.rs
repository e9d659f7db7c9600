//! An inserted car is the same for all that see it: boxes, maps, LiDAR sweeps, the driver model, metrics and
//! the MCAP file.

use std::path::Path;

use glam::DVec3;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::conditions::{CameraConditions, ConditionOptions};
use point_skeleton::dataset::{Class, Recording, TrackBox};
use point_skeleton::geometry::{Cuboid, Pose};
use point_skeleton::lidar::{LidarRays, LidarSpec, Motion};
use point_skeleton::raster::RasterizerKind;
use point_skeleton::scene::{SceneCamera, SceneState};
use point_skeleton::skeleton::{BuildOptions, Skeleton};
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_sim::rollout::{InputPaths, Rollout, RolloutInputs, RolloutOptions};
use pskel_sim::{ActorPolicy, Instant, Rates, Scenario, SimOptions, Simulation, scene_state};
use pskel_testing::shared::{WithLog, skeleton_of};
use pskel_town::Town;
use serde_json::{Value, json};

const TOWN: &str = "seed=7,frames=10,hz=5,lidar_hz=10,beams=32,size=90x160";
const CAR: &str = "broken-down";
/// Length, width and height of the car, meters.
const SIZE: DVec3 = DVec3::new(4.5, 1.9, 1.5);
/// A driver that follows a path to the place of the car.
const FOLLOWER: &str = "follower";

/// Returns the town's log with a follower, with or without the car.
fn edited(log: &Log, has_car: bool) -> Log {
    let anchor = json!({"ego": {"after_s": 0.0}});
    let insert = |x_m: f64, y_m: f64, yaw_deg: f64| {
        let at = json!({"in": anchor, "x_m": x_m, "y_m": y_m, "yaw_deg": yaw_deg});
        json!({"insert": {"category": "vehicle.car", "size_m": SIZE.to_array(), "at": at}})
    };
    let point = |(x_m, y_m): (f64, f64)| json!({"x_m": x_m, "y_m": y_m, "speed_mps": 6.0});
    let points: Vec<Value> =
        [(3.0, 3.6), (7.0, 2.4), (10.0, 0.9), (14.0, 0.3), (60.0, 0.3)].map(point).into();
    let path = json!({"path": {"in": anchor, "points": points}});
    let mut changes = vec![
        json!({"track": FOLLOWER, "action": insert(3.0, 3.6, 0.0)}),
        json!({"track": FOLLOWER, "action": path}),
        json!({"track": FOLLOWER, "action": "idm"}),
    ];
    // Nothing else is in the way or hides the car.
    changes.extend(ahead(log.recording()).map(|track| json!({"track": track, "action": "remove"})));
    if has_car {
        changes.push(json!({"track": CAR, "action": insert(14.0, 0.3, 5.0)}));
    }
    log.edited(&serde_json::from_value(json!({"changes": changes})).unwrap()).unwrap()
}

/// Iterates over the tracks that are in the lanes ahead of the first ego at some time.
fn ahead(log: &Recording) -> impl Iterator<Item = &str> {
    let ego = log.frames[0].global_from_ego.inverse();
    let is_ahead = move |item: &TrackBox| {
        let place = ego.transform_point(item.cuboid.pose.translation);
        (-10.0..60.0).contains(&place.x) && place.y.abs() < 6.0
    };
    let tracks = log.tracks.iter().enumerate();
    let there = move |track: usize| {
        let boxes = log.frames.iter().flat_map(|frame| &frame.boxes);
        boxes.filter(|item| item.track == track).any(is_ahead)
    };
    tracks.filter(move |(track, _)| there(*track)).map(|(_, track)| track.id.as_str())
}

/// Returns where the car is to be: on the ground of the ego, 14 m ahead of its first place.
fn expected(log: &Recording) -> Cuboid {
    let ego = log.frames[0].global_from_ego;
    let level = Pose::from_yaw(ego.yaw_rad(), ego.translation);
    let center = level.transform_point(DVec3::new(14.0, 0.3, SIZE.z / 2.0));
    Cuboid::new(Pose::from_yaw(ego.yaw_rad() + 5_f64.to_radians(), center), SIZE).unwrap()
}

fn is_near(found: &Cuboid, expected: &Cuboid) -> bool {
    let apart = found.pose.translation - expected.pose.translation;
    // The ground is the height of the ego's path.
    apart.truncate().length() < 1e-6
        && apart.z.abs() < 0.3
        && found.size == expected.size
        && (found.pose.yaw_rad() - expected.pose.yaw_rad()).abs() < 1e-9
}

fn track_of(log: &Recording, id: &str) -> usize {
    log.tracks.iter().position(|track| track.id == id).unwrap()
}

fn options() -> SimOptions {
    SimOptions {
        steps: 9,
        sim_hz: Some(5.0),
        plan_hz: Some(5.0),
        actors: ActorPolicy::Replay,
        ..SimOptions::default()
    }
}

/// Simulates a log; returns the instants and the tracks that the ego collides with.
fn run(log: &Log) -> (Vec<Instant>, Vec<String>) {
    let scenario = Scenario { log: log.recording(), map: None, rates: Rates::default() };
    let mut simulation = Simulation::new(&scenario, options()).unwrap();
    let mut instants = vec![(*simulation.committed().get()).clone()];
    while simulation.step().unwrap().is_some() {
        instants.push((*simulation.committed().get()).clone());
    }
    let hit = simulation.metrics().collisions.iter().map(|collision| collision.track.clone()).collect();
    (instants, hit)
}

fn renderer(skeleton: &Skeleton) -> Renderer<'_> {
    let maps = "depth,class,instance,boxes".parse().unwrap();
    let conditions = ConditionOptions { maps, ..ConditionOptions::default() };
    let rasterizer = RasterizerKind::Cpu.into();
    Renderer::new(skeleton, RenderOptions { conditions, rasterizer, ..RenderOptions::default() }).unwrap()
}

/// Returns the global position of a pixel at a depth, meters.
fn position(camera: &SceneCamera, pixel: usize, depth_m: f32) -> DVec3 {
    let (width, view) = (camera.view.camera.width as usize, &camera.view);
    let image = DVec3::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5, 1.0);
    let local = view.camera.intrinsics.inverse() * image * f64::from(depth_m);
    view.camera_from_world.inverse().transform_point3(local)
}

fn is_inside(cuboid: &Cuboid, position: DVec3, margin_m: f64) -> bool {
    cuboid.contains_local(cuboid.pose.inverse().transform_point(position), margin_m)
}

/// Checks the car in the maps of a camera; returns its number of pixels.
fn check_camera(camera: &SceneCamera, maps: &CameraConditions, number: u32, cuboid: &Cuboid) -> usize {
    let [instances, depths] = [maps.instance.as_ref().unwrap().len(), maps.depth_m.as_ref().unwrap().len()];
    assert_eq!(instances, depths);
    let pixels = maps.instance.iter().flatten().enumerate().filter(|(_, found)| **found == number);
    let pixels: Vec<usize> = pixels.map(|(pixel, _)| pixel).collect();
    for pixel in &pixels {
        let place = position(camera, *pixel, maps.depth_m.as_ref().unwrap()[*pixel]);
        assert!(is_inside(cuboid, place, 0.5), "{place}");
        assert_eq!(maps.class.as_ref().unwrap()[*pixel], Class::MotorVehicle as u8);
    }
    pixels.len()
}

/// Checks a state's maps, sweep and rays against the car's box.
fn check_state(renderer: &mut Renderer<'_>, state: &SceneState, without: &SceneState, cuboid: &Cuboid) {
    let number = 1 + state.actors.iter().position(|actor| actor.track == CAR).unwrap() as u32;
    let [maps, plain] = [state, without].map(|state| renderer.render(state).unwrap());
    let cameras = || state.cameras.iter().zip(maps.cameras());
    let pixels: usize = cameras().map(|(camera, maps)| check_camera(camera, maps, number, cuboid)).sum();
    assert!(pixels > 100, "{pixels}");
    // Lines of its box, where it is seen and nowhere else.
    for ((_, maps), plain) in cameras().zip(plain.cameras()) {
        let [with, without] = [maps, plain].map(|maps| maps.boxes.as_ref().unwrap());
        let is_seen = maps.instance.as_ref().unwrap().contains(&number);
        assert!(is_seen == (with != without), "{}", maps.name);
    }

    let spec = LidarSpec::named("hdl-32e").unwrap().mounted_at(DVec3::new(0.94, 0.0, 1.84));
    let sweep = renderer.lidar(&spec, &Motion::new(state, None)).unwrap();
    let of_car: Vec<_> = sweep.returns().filter(|found| found.instance == number).collect();
    assert!(of_car.len() > 100 && sweep.tracks[number as usize - 1] == CAR, "{}", of_car.len());
    for found in &of_car {
        let place = sweep.global_from_ego.transform_point(DVec3::from(found.position.map(f64::from)));
        assert!(is_inside(cuboid, place, 0.3) && found.class == Class::MotorVehicle as u8, "{place}");
    }

    let origin = state.global_from_ego.transform_point(DVec3::new(3.0, 0.0, 1.0));
    let target = cuboid.pose.transform_point(DVec3::new(-SIZE.x / 2.0, 0.0, 0.0));
    let rays = LidarRays { after_s: 0.0, origin, directions: vec![(target - origin).normalize()] };
    let hits = renderer.cast(&[rays], &Motion::new(state, None), 60.0).unwrap();
    let hit = hits[0][0].unwrap();
    assert_eq!((hit.instance, hit.class), (number, Class::MotorVehicle as u8));
    let apart_m = hit.range_m - target.distance(origin);
    assert!(apart_m.abs() < 0.6, "{apart_m}");
}

#[test]
fn an_inserted_car_agrees_everywhere() {
    let source = Log::new(Box::new(Town::new(&TOWN.parse().unwrap()).unwrap()));
    let frames: Vec<usize> = (0..source.recording().frames.len()).collect();
    let folder = tempfile::tempdir().unwrap();
    let gray = WithLog::grey(source.reader(), &frames);
    let path = folder.path().join("s");
    let skeleton = skeleton_of(&path, &gray, &frames, &BuildOptions::default());
    let [log, plain] = [true, false].map(|has_car| edited(&source, has_car));
    let (recording, expected) = (log.recording(), expected(source.recording()));
    let track = track_of(recording, CAR);

    // Boxes in the log and in the simulation.
    let cuboid = recording.frames[0].cuboid_of(track).unwrap();
    assert!(is_near(&cuboid, &expected), "{cuboid:?} {expected:?}");
    assert!(recording.frames.iter().all(|frame| frame.cuboid_of(track) == Some(cuboid)));
    let ((instants, hit), (free, missed)) = (run(&log), run(&plain));
    let in_step = |instant: &Instant| instant.actors.iter().find(|a| a.track == track).map(|a| a.cuboid);
    assert!(instants.iter().all(|instant| in_step(instant) == Some(cuboid)));

    // The ego collides with it, and the driver behind brakes for it.
    assert!(hit.iter().any(|track| track == CAR) && !missed.iter().any(|track| track == CAR), "{hit:?}");
    let speed = |log: &Log, instants: &[Instant]| {
        let follower = track_of(log.recording(), FOLLOWER);
        instants[6].actors.iter().find(|actor| actor.track == follower).unwrap().speed_mps
    };
    let (braking, driving) = (speed(&log, &instants), speed(&plain, &free));
    assert!(braking + 1.0 < driving, "{braking} {driving}");

    let mut renderer = renderer(&skeleton);
    let state = scene_state(recording, &instants[0], None);
    let without = scene_state(plain.recording(), &free[0], None);
    check_state(&mut renderer, &state, &without, &cuboid);

    let rows = rollout(&log, &skeleton, &mut renderer, &path, folder.path());
    for row in &rows {
        let actor = row.actors.iter().find(|actor| actor.track == CAR).unwrap();
        assert!(DVec3::from(actor.center_m).distance(cuboid.pose.translation) < 1e-6);
        assert_eq!((actor.size_m, actor.category.as_str()), (SIZE.to_array(), "vehicle.car"));
    }
    #[cfg(feature = "mcap")]
    mcap_file::check(&folder.path().join("rollout.mcap"), rows.len(), &cuboid);
}

/// Runs a rollout of a log without a folder, with an MCAP file in `folder` if there are any; returns its
/// rows.
fn rollout(
    log: &Log,
    skeleton: &Skeleton,
    renderer: &mut Renderer<'_>,
    path: &Path,
    folder: &Path,
) -> Vec<pskel_sim::report::StepRow> {
    let scenario = Scenario { log: log.recording(), map: None, rates: Rates::default() };
    let prompt = PromptParts::default();
    let paths = InputPaths { log: Path::new("town"), skeleton: path, prompt: None };
    let inputs = RolloutInputs { scenario: &scenario, skeleton, prompt: &prompt, paths };
    let maps = "instance".parse().unwrap();
    let conditions = ConditionOptions { maps, ..ConditionOptions::default() };
    let options = RolloutOptions {
        simulation: options(),
        conditions,
        #[cfg(feature = "mcap")]
        mcap: Some(mcap_file::output(&folder.join("rollout.mcap"))),
        ..RolloutOptions::default()
    };
    let _ = folder; // of interest to the MCAP file alone
    Rollout::open(inputs, options, None, None).unwrap().run(renderer, None, &mut |_| {}).unwrap().rows
}

#[cfg(feature = "mcap")]
mod mcap_file {
    use std::path::Path;

    use foxglove::Decode;
    use foxglove::messages::SceneUpdate;
    use glam::DVec3;
    use mcap::MessageStream;
    use point_skeleton::files::{Inputs, OutputFile};
    use point_skeleton::geometry::Cuboid;
    use pskel_sim::rollout::MCAP;

    pub(super) fn output(path: &Path) -> OutputFile {
        OutputFile::open(path, MCAP, &Inputs::default()).unwrap()
    }

    /// Checks the car's entity in each step of a file.
    pub(super) fn check(path: &Path, steps: usize, cuboid: &Cuboid) {
        let bytes = std::fs::read(path).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let records = summary.metadata_indexes.iter().map(|at| mcap::read::metadata(&bytes, at).unwrap());
        let origin =
            records.into_iter().find_map(|record| record.metadata.get("map_origin").cloned()).unwrap();
        let origin: [f64; 3] = serde_json::from_str(&origin).unwrap();
        let mut count = 0;
        for message in MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
            if message.channel.topic != "/actors" {
                continue;
            }
            let update = SceneUpdate::decode(&*message.data).ok().unwrap();
            let entity = update.entities.iter().find(|entity| entity.id == super::CAR).unwrap();
            let (size, place) =
                (entity.cubes[0].size.unwrap(), entity.cubes[0].pose.unwrap().position.unwrap());
            assert_eq!(DVec3::new(size.x, size.y, size.z), cuboid.size);
            let center = DVec3::new(place.x, place.y, place.z) + DVec3::from(origin);
            assert!(center.distance(cuboid.pose.translation) < 1e-6, "{center}");
            count += 1;
        }
        assert_eq!(count, steps);
    }
}
