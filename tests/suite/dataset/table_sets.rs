//! Data sets with nuScenes' tables: MAN TruckScenes, TIER IV's T4 and Lyft Level 5.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;
use point_skeleton::dataset::{LogLocator, LogReader, LogSummary, Recording, expand, open};
use point_skeleton::raster::RasterizerKind;
use point_skeleton::skeleton::Asset;
use point_skeleton::{BuildOptions, Log, RenderOptions, Renderer, Skeleton};
use pskel_testing::shared::{WithLog, skeleton_of};
use pskel_testing::six_cameras::{FIRST_US, FRAMES, STEP_US, ego_at, points};
use pskel_testing::table_sets::{LYFT_LIDARS, TRUCK_LIDARS, write_lyft, write_t4, write_truckscenes};

type Writer = fn(&Path);

/// Writes a data set to a new folder and opens it by its path alone.
fn opened(write: Writer) -> (tempfile::TempDir, Box<dyn LogReader>) {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let locator: LogLocator = folder.path().to_str().unwrap().parse().unwrap();
    assert_eq!(locator.format.name, "nuscenes");
    (folder, open(&locator).unwrap())
}

fn notes(log: &Recording) -> Vec<(&str, usize)> {
    log.notes.iter().map(|(kind, count)| (kind.as_str(), *count)).collect()
}

/// Asserts that each frame has the sweeps of all LiDARs, each with the points that it measured at its time
/// from its place.
fn assert_sweeps(reader: &dyn LogReader, lidars: &[(&str, i64, [f64; 3], f64)]) {
    for (number, frame) in reader.recording().frames.iter().enumerate() {
        let t_us = FIRST_US + STEP_US * number as i64;
        assert_eq!(frame.t_us, t_us);
        assert!(frame.global_from_ego.translation.distance(ego_at(t_us).translation) < 1e-9, "{frame:?}");
        let mut expected: Vec<(i64, [f64; 3])> =
            lidars.iter().map(|lidar| (t_us + lidar.1, lidar.2)).collect();
        expected.sort_by_key(|(at_us, _)| at_us.abs_diff(t_us));
        let own: Vec<_> = frame.sweeps.iter().filter(|sweep| sweep.is_key).collect();
        let found: Vec<(i64, [f64; 3])> =
            own.iter().map(|sweep| (sweep.t_us, sweep.ego_from_lidar.translation.to_array())).collect();
        assert_eq!(found, expected);
        for record in own {
            let sweep = reader.read_sweep(record).unwrap();
            assert_eq!(reader.check_sweep(record).unwrap(), Some(sweep.points.len() as u64));
            let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
            let truth = points(record.t_us);
            assert_eq!(sweep.points.len(), truth.len());
            for (point, truth) in sweep.points.iter().zip(truth) {
                let global = global_from_lidar.transform_point(DVec3::from(point.position.map(f64::from)));
                assert!(global.distance(truth) < 1e-4, "{global} instead of {truth}");
            }
        }
    }
}

/// Builds a skeleton of all points, and returns its actors by track.
fn actors(reader: &dyn LogReader) -> BTreeMap<String, Asset> {
    let folder = tempfile::tempdir().unwrap();
    let frames: Vec<usize> = (0..FRAMES).collect();
    let grey = WithLog::grey(reader, &frames);
    let mut options = BuildOptions::default();
    options.split.ego_clearance_m = 0.0;
    let skeleton = skeleton_of(&folder.path().join("s"), &grey, &frames, &options);
    let report = &skeleton.manifest.report;
    let sweeps =
        reader.recording().frames.iter().flat_map(|frame| &frame.sweeps).filter(|sweep| sweep.is_key);
    assert_eq!(report.sweeps, sweeps.count());
    assert_eq!(report.points_read, report.sweeps * points(FIRST_US).len());
    assert_eq!((report.dropped_not_finite, report.dropped_uncolored, report.dropped_ego), (0, 0, 0));
    skeleton.manifest.actors.iter().map(|actor| (actor.track.clone(), actor.clone())).collect()
}

/// Points of an actor are where one LiDAR measured them, whatever time the others have: ten elevenths of the
/// box in length and width, on one level.
fn assert_fits(actor: &Asset) {
    let [x, y, z] = actor.size;
    let half = [x * 5.0 / 11.0, y * 5.0 / 11.0];
    for (axis, half) in half.into_iter().enumerate() {
        assert!((f64::from(actor.bounds.min[axis]) + half).abs() < 0.02, "{actor:?}");
        assert!((f64::from(actor.bounds.max[axis]) - half).abs() < 0.02, "{actor:?}");
    }
    assert!((f64::from(actor.bounds.max[2]) - 0.4 * z).abs() < 0.02, "{actor:?}");
}

/// Builds a log and renders a frame as the commands do, and returns the cameras with points.
fn rendered(folder: &Path) -> Vec<String> {
    let log = Log::open(folder.to_str().unwrap()).unwrap();
    let out = tempfile::tempdir().unwrap();
    let skeleton = Skeleton::build(&log, out.path().join("s"), &BuildOptions::default()).unwrap();
    let mut options = RenderOptions { optional_map: true, ..RenderOptions::default() };
    options.rasterizer.kind = RasterizerKind::Cpu;
    let mut renderer = Renderer::new(&skeleton, options).unwrap();
    let maps = renderer.render(&log.frame(2).unwrap()).unwrap();
    let seen = |depth: &Option<Vec<f32>>| depth.as_ref().unwrap().iter().any(|depth_m| *depth_m > 0.0);
    maps.cameras()
        .iter()
        .filter(|camera| seen(&camera.depth_m))
        .map(|camera| camera.name.to_string())
        .collect()
}

#[test]
fn truckscenes_is_read() {
    let (folder, reader) = opened(write_truckscenes);
    let log = reader.recording();
    let cameras = ["CAMERA_LEFT_FRONT", "CAMERA_RIGHT_FRONT", "CAMERA_RIGHT_BACK", "CAMERA_LEFT_BACK"];
    assert_eq!(
        (log.cameras.as_slice(), log.location.as_str()),
        (&cameras.map(|c| c.parse().unwrap())[..], "")
    );
    assert_eq!((log.frames.len(), log.tracks.len()), (FRAMES, 3));
    assert_eq!(
        notes(log),
        [
            ("radar sweeps (not read)", 11),
            ("scenes without a log (location and HD map unknown)", 1),
            ("tables that are not read (ego_motion_cabin)", 1),
            ("tables that are not read (ego_motion_chassis)", 1),
            ("tables that are not read (weather_annotation)", 1),
        ]
    );
    assert_sweeps(&*reader, &TRUCK_LIDARS);
    let actors = actors(&*reader);
    assert_eq!(actors.keys().collect::<Vec<_>>(), ["ahead", "cone", "left"]);
    actors.values().for_each(assert_fits);
    assert_eq!(rendered(folder.path()), cameras);
    let summary = LogSummary::new(&*reader);
    let all = log.frames.iter().flat_map(|frame| &frame.sweeps).count();
    assert_eq!((summary.sweeps, all), (all, 6 * (2 * FRAMES - 1)));
    assert_eq!((summary.points, summary.map), (Some((all * points(FIRST_US).len()) as u64), None));
    assert!(summary.damaged.is_empty());
}

#[test]
fn t4_is_read() {
    let (folder, reader) = opened(write_t4);
    let log = reader.recording();
    let order = ["FRONT", "FRONT_RIGHT", "BACK_RIGHT", "BACK", "BACK_LEFT", "FRONT_LEFT"];
    let order = order.map(|camera| format!("CAM_{camera}"));
    assert_eq!(log.cameras, order);
    let categories: Vec<&str> = log.tracks.iter().map(|track| track.category.as_str()).collect();
    assert_eq!(categories, ["car", "traffic_cone", "car"]);
    assert_eq!(
        notes(log),
        [
            ("maps as Lanelet2 (not read; map/lanelet2_map.osm)", 1),
            ("tables that are not read (vehicle_state)", 1),
        ]
    );
    // Data between key frames name no sample.
    let between = log.frames.iter().flat_map(|frame| &frame.sweeps).filter(|sweep| !sweep.is_key);
    assert_eq!(
        between.map(|sweep| sweep.t_us).collect::<Vec<_>>(),
        (1..FRAMES as i64).map(|i| FIRST_US + STEP_US * i - STEP_US / 2).collect::<Vec<_>>()
    );
    assert_sweeps(&*reader, &[("LIDAR_CONCAT", 0, [0.0; 3], 0.0)]);
    let sweep = reader.read_sweep(&log.frames[0].sweeps[0]).unwrap();
    let all = sweep.points.len();
    let lidars: Vec<u16> = sweep.points.iter().map(|point| point.ring).collect();
    assert_eq!((sweep.devices, lidars), (true, [vec![0; all / 2], vec![2; all - all / 2]].concat()));
    assert_eq!(sweep.notes["sweeps of merged LiDARs, as their files say"], 1);
    assert_eq!(rendered(folder.path()), order);
}

/// The latest revision, a given one, a folder of scenes.
#[test]
fn t4_has_folders_of_revisions_and_scenes() {
    let folder = tempfile::tempdir().unwrap();
    for path in ["scenes/a/0", "scenes/a/2", "scenes/a/10", "scenes/b", "scenes/c/1"] {
        write_t4(&folder.path().join(path));
    }
    std::fs::create_dir(folder.path().join("scenes/none")).unwrap();
    let at = |name: &str| format!("{}/{name}", folder.path().display());
    let of = |name: &str| {
        let locator: LogLocator =
            at(name).parse().map_err(|e: point_skeleton::dataset::DatasetError| e.to_string())?;
        let reader = open(&locator).map_err(|error| error.to_string())?;
        let path = reader.recording().frames[0].sweeps[0].path.clone();
        let path = path.strip_prefix(folder.path()).unwrap().to_str().unwrap().to_owned();
        Ok::<_, String>(path.split_once("/data/").unwrap().0.to_owned())
    };
    let is = |name: &str, expected: &str| assert_eq!(of(name).as_deref(), Ok(expected), "{name}");
    is("scenes/a", "scenes/a/10");
    is("scenes/a@2", "scenes/a/2");
    is("scenes/a@annotation", "scenes/a/10");
    is("scenes/a/0", "scenes/a/0");
    is("scenes/b@annotation#project_b", "scenes/b");
    is("scenes#a", "scenes/a/10");
    is("scenes@0#a", "scenes/a/0");
    is("scenes#b", "scenes/b");
    is("scenes#project_c", "scenes/c/1");
    let refuses = |name: &str, parts: &[&str]| {
        let message = of(name).unwrap_err();
        assert!(parts.iter().all(|part| message.contains(part)), "{name}: {message}");
    };
    refuses("scenes/a@3", &["expected @VERSION to name one of 0, 2, 10, found 3", "scenes/a"]);
    refuses("scenes", &["expected #SCENE to name one of a, b, c, found none", "scenes"]);
    refuses("scenes#d", &["expected #SCENE to name one of a, b, c, found d"]);
    let expanded = |name: &str| {
        let locator: LogLocator = at(name).parse().unwrap();
        let logs = expand(&locator).unwrap().into_iter();
        logs.map(|log| log.to_string().replace(&at(""), "")).collect::<Vec<_>>()
    };
    let all = ["nuscenes:scenes#a", "nuscenes:scenes#b", "nuscenes:scenes#c"];
    assert_eq!(expanded("scenes#*"), all);
    // All of them were recorded in the town.
    assert_eq!(expanded("scenes#town"), all);
    assert_eq!(expanded("scenes#c"), ["nuscenes:scenes#c"]);
    assert_eq!(expanded("scenes#project_b"), ["nuscenes:scenes#project_b"]);
    assert_eq!(expanded("scenes/a#*"), ["nuscenes:scenes/a#project_a"]);
    // The root of sensor data has the same folders.
    let mut locator: LogLocator = at("scenes#a").parse().unwrap();
    let sensors = folder.path().join("sensors");
    std::fs::create_dir_all(sensors.join("a")).unwrap();
    std::fs::rename(at("scenes/a/10/data"), folder.path().join("data")).unwrap();
    std::fs::create_dir_all(sensors.join("a/10")).unwrap();
    std::fs::rename(folder.path().join("data"), sensors.join("a/10/data")).unwrap();
    locator.sensor_root = Some(sensors.clone());
    let moved = open(&locator).unwrap();
    assert!(moved.recording().frames[0].sweeps[0].path.starts_with(sensors.join("a/10/data")));
}

#[test]
fn lyft_is_read() {
    let (folder, reader) = opened(write_lyft);
    let log = reader.recording();
    let order = ["FRONT", "FRONT_RIGHT", "BACK_RIGHT", "BACK", "BACK_LEFT", "FRONT_LEFT", "FRONT_ZOOMED"];
    let order = order.map(|camera| format!("CAM_{camera}"));
    assert_eq!(
        (log.cameras.as_slice(), log.location.as_str()),
        (&order.clone().map(|c| c.parse().unwrap())[..], "Palo Alto")
    );
    assert_eq!(
        notes(log),
        [
            ("boxes with an unknown number of LiDAR points", 3 * FRAMES),
            ("maps as an image (not read; maps/map_raster_palo_alto.png)", 1),
        ]
    );
    assert_sweeps(&*reader, &LYFT_LIDARS);
    let actors = actors(&*reader);
    assert_eq!(actors.len(), 3);
    actors.values().for_each(assert_fits);
    assert_eq!(rendered(folder.path()), order);
    assert_eq!(reader.read_map().unwrap().map(|map| map.lanes.len()), None);
}

/// The test set of Lyft Level 5 has no annotations. The version with folders of its own names needs no
/// prefix.
#[test]
fn lyft_without_annotations_is_read() {
    let folder = tempfile::tempdir().unwrap();
    write_lyft(folder.path());
    let at = |name: &str| folder.path().join(name);
    for [from, to] in [["train_data", "v1.01-train"], ["train_images", "images"], ["train_lidar", "lidar"]] {
        std::fs::rename(at(from), at(to)).unwrap();
    }
    for table in ["sample_annotation", "instance"] {
        std::fs::remove_file(at(&format!("v1.01-train/{table}.json"))).unwrap();
    }
    let locator: LogLocator = folder.path().to_str().unwrap().parse().unwrap();
    let reader = open(&locator).unwrap();
    let log = reader.recording();
    assert!(log.tracks.is_empty() && log.frames.iter().all(|frame| frame.boxes.is_empty()));
    assert_eq!(log.notes["logs without annotations"], 1);
    assert_sweeps(&*reader, &LYFT_LIDARS);
}
