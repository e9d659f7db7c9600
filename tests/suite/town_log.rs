//! The built-in town as a log: what is recorded fits what is true, and what is written is read again.

use std::sync::OnceLock;

use glam::{DVec2, DVec3};
use point_skeleton::dataset::nuscenes::{LogWriter, NuScenes, write_log};
use point_skeleton::dataset::{Dataset, EgoTrack, Lane, LogFormat, LogLocator};
use point_skeleton::geometry::{Cuboid, Pose, View};
use point_skeleton::scene::{EgoOffset, state_of_frame};
use point_skeleton::town::{Town, TownOptions, TrueActor};

use crate::tiny_log::{TinyLog, assert_failed, tree};

const OPTIONS: TownOptions =
    TownOptions { seed: 3, frames: 3, hz: 5.0, lidar_hz: 10.0, beams: 32, size: [90, 160], daylight: None };

/// Meshes and device are made once.
fn town() -> &'static Town {
    static TOWN: OnceLock<Town> = OnceLock::new();
    TOWN.get_or_init(|| Town::new(&OPTIONS).unwrap())
}

fn views(town: &Town, frame: usize) -> Vec<View> {
    let state = state_of_frame(town.log(), frame, EgoOffset::default()).unwrap();
    state.cameras.into_iter().map(|camera| camera.view).collect()
}

fn close(a: &Pose, b: &Pose) -> bool {
    a.rotation.angle_between(b.rotation) < 1e-7 && (a.translation - b.translation).length() < 1e-9
}

/// How far a point is from a line of points.
fn away(point: DVec2, line: &[DVec2]) -> f64 {
    let to_piece = |w: &[DVec2]| {
        let s = (point - w[0]).dot(w[1] - w[0]) / (w[1] - w[0]).length_squared();
        point.distance(w[0].lerp(w[1], s.clamp(0.0, 1.0)))
    };
    line.windows(2).map(to_piece).fold(f64::INFINITY, f64::min)
}

#[test]
fn frames_sweeps_and_images_have_their_times() {
    let log = town().log();
    assert_eq!((log.name.as_str(), log.location.as_str(), log.frames.len()), ("town-3", "town", 3));
    let start = log.frames[0].t_us;
    for (index, frame) in log.frames.iter().enumerate() {
        assert_eq!(frame.t_us, start + 200_000 * index as i64);
        let times: Vec<(i64, bool)> = frame.sweeps.iter().map(|s| (frame.t_us - s.t_us, s.is_key)).collect();
        let between: &[_] = if index == 0 { &[] } else { &[(100_000, false)] };
        assert_eq!(times, [&[(0, true)], between].concat());
        let before: Vec<i64> = frame.images.iter().map(|image| frame.t_us - image.t_us).collect();
        assert_eq!(before, [25_000, 17_000, 10_000, 0, 40_000, 33_000]);
        assert!(frame.boxes.windows(2).all(|w| w[0].track < w[1].track));
        let far = |item: &&point_skeleton::dataset::TrackBox| {
            item.cuboid.pose.translation.distance(frame.global_from_ego.translation) > 120.0
        };
        assert_eq!(frame.boxes.iter().filter(far).count(), 0);
    }
    assert!(log.tracks.windows(2).all(|w| w[0].id < w[1].id));
    assert!((0..log.tracks.len()).all(|track| !log.track_boxes(track).is_empty()));
    // The ego moves along, and its poses of images lie between those of frames.
    let ego = EgoTrack::new(log);
    let image = &log.frames[1].images[0];
    let between = ego.at(image.t_us).unwrap();
    assert!(between.translation.distance(image.global_from_ego.translation) < 0.02);
    // Another rate of frames and turns: every turn is there once.
    let other = Town::new(&TownOptions { frames: 4, hz: 4.0, lidar_hz: 20.0, ..OPTIONS }).unwrap();
    let counts: Vec<usize> = other.log().frames.iter().map(|frame| frame.sweeps.len()).collect();
    assert_eq!(counts, [1, 5, 5, 5]);
}

#[test]
fn a_town_written_is_read_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let (town, done) = (town(), std::cell::RefCell::new(Vec::new()));
    let layers = town.map_layers();
    let frame_done = |index: usize| done.borrow_mut().push(index);
    let writer = LogWriter { version: "v1.0-town", map: Some(&layers), frame_done: &frame_done };
    writer.write(folder.path(), town).unwrap();
    assert_eq!(done.take(), [0, 1, 2]);
    let read = NuScenes::open(&LogLocator::new(LogFormat::NuScenes, folder.path())).unwrap();
    let (a, b) = (town.log(), read.log());
    assert_eq!((&a.name, &a.location, &a.cameras, &a.tracks), (&b.name, &b.location, &b.cameras, &b.tracks));
    assert_eq!((&a.rig, b.notes.len()), (&b.rig, 0));
    for (a, b) in a.frames.iter().zip(&b.frames) {
        assert!(a.t_us == b.t_us && close(&a.global_from_ego, &b.global_from_ego));
        let key = |frame: &point_skeleton::dataset::Frame| {
            let sweeps = frame.sweeps.iter().map(|s| (s.t_us, s.is_key)).collect::<Vec<_>>();
            let images = frame.images.iter().map(|i| (i.channel, i.t_us)).collect::<Vec<_>>();
            (sweeps, images, frame.boxes.iter().map(|b| b.track).collect::<Vec<_>>())
        };
        assert_eq!(key(a), key(b));
        assert!(
            a.boxes
                .iter()
                .zip(&b.boxes)
                .all(|(a, b)| { a.cuboid.size == b.cuboid.size && close(&a.cuboid.pose, &b.cuboid.pose) })
        );
        for (x, y) in a.sweeps.iter().zip(&b.sweeps) {
            assert_eq!(town.read_sweep(x).unwrap(), read.read_sweep(y).unwrap());
        }
    }
    let [mut a, mut b] = [town, &read as &dyn Dataset].map(|d| d.read_map().unwrap().unwrap());
    let lines = |lanes: &mut Vec<Lane>| -> Vec<Vec<DVec2>> {
        lanes.iter_mut().map(|lane| std::mem::take(&mut lane.centerline)).collect()
    };
    for (a, b) in [
        (lines(&mut a.lanes), lines(&mut b.lanes)),
        (lines(&mut a.lane_connectors), lines(&mut b.lane_connectors)),
    ] {
        for (a, b) in a.iter().zip(&b) {
            assert!(a.iter().all(|p| away(*p, b) < 0.01) && b.iter().all(|p| away(*p, a) < 0.01));
        }
    }
    assert_eq!(a, b);
}

#[test]
fn the_same_options_give_the_same_bytes() {
    let write = |seed: u64| {
        let folder = tempfile::tempdir().unwrap();
        let town = Town::new(&TownOptions { seed, frames: 1, size: [45, 80], ..OPTIONS }).unwrap();
        write_log(folder.path(), "v1.0-town", &town).unwrap();
        tree(folder.path())
    };
    let first = write(3);
    assert!(first == write(3) && first != write(4));
}

/// The LiDAR's rays and the triangle pipeline see the same town: points stand where the depth map has them. The back
/// camera fires at the time stamp of the sweep.
#[test]
fn the_lidar_and_the_cameras_agree() {
    let town = town();
    let frame = &town.log().frames[1];
    let seen = &town.truth_of_frame(1).unwrap()[3];
    let image = &frame.images[3];
    assert_eq!(image.t_us, frame.t_us);
    let view = View { camera: image.camera.clone(), camera_from_world: image.camera_from_global().affine() };
    let sweep = town.read_sweep(&frame.sweeps[0]).unwrap();
    let global_from_lidar = frame.sweeps[0].global_from_ego * frame.sweeps[0].ego_from_lidar;
    let (mut compared, mut off) = (0, Vec::new());
    for point in &sweep.points {
        let at = global_from_lidar.transform_point(DVec3::from(point.position.map(f64::from)));
        let Some((pixel, depth_m)) = view.project(at) else { continue };
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < 160.0 && pixel.y < 90.0;
        if !inside || depth_m > 30.0 {
            continue;
        }
        compared += 1;
        let own = seen.depth_m[pixel.y as usize * 160 + pixel.x as usize];
        // A pixel of a far ground spans metres; what is behind an edge is behind it for one of the two.
        off.push((f64::from(own) - depth_m).abs() / depth_m);
    }
    off.sort_by(f64::total_cmp);
    assert!(compared > 1000, "{compared}");
    assert!(off[compared / 2] < 0.01, "median {}", off[compared / 2]);
    assert!(off[compared * 8 / 10] < 0.05, "80 %: {}", off[compared * 8 / 10]);
    // Moved by half a metre the same points do not fit: the test can fail.
    let shifted = View {
        camera_from_world: glam::DAffine3::from_translation(DVec3::X * 0.5) * view.camera_from_world,
        ..view
    };
    let moved = town.truth(frame.t_us, &[shifted]).unwrap();
    assert!(moved[0].depth_m != seen.depth_m);
}

/// Points in the boxes of those who stand still: none sticks out, and who is near is seen.
#[test]
fn boxes_hold_their_actors() {
    let town = town();
    let frames = &town.log().frames;
    let (frame, record) = (&frames[0], &frames[0].sweeps[0]);
    let sweep = town.read_sweep(record).unwrap();
    let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
    let (mut near, mut seen) = (0, 0);
    for item in &frame.boxes {
        let box_from_lidar = item.cuboid.pose.inverse() * global_from_lidar;
        let locals = || {
            sweep
                .points
                .iter()
                .map(|p| box_from_lidar.transform_point(DVec3::from(p.position.map(f64::from))))
        };
        let above = |p: &DVec3| p.z > 0.25 - item.cuboid.size.z / 2.0;
        let inside =
            |margin_m: f64| locals().filter(|p| item.cuboid.contains_local(*p, margin_m) && above(p)).count();
        let stands =
            frames[2].cuboid_of(item.track).is_some_and(|c: Cuboid| close(&c.pose, &item.cuboid.pose));
        if stands {
            // Ranges are off by 1.5 cm, five times that at most.
            assert_eq!(inside(0.08), inside(0.12), "{}", town.log().tracks[item.track].id);
        }
        if item.cuboid.pose.translation.distance(frame.global_from_ego.translation) < 20.0 {
            near += 1;
            seen += usize::from(inside(0.08) > 0);
        }
    }
    assert!(near >= 2 && seen * 2 >= near, "{seen} of {near} near the ego are seen");
}

#[test]
fn the_truth_is_numbered_as_boxes_are() {
    let town = town();
    let frame = &town.log().frames[1];
    let views = views(town, 1);
    let seen = town.truth(frame.t_us, &views).unwrap();
    let mut shown = 0;
    for (view, seen) in views.iter().zip(&seen) {
        for (pixel, (number, class)) in seen.instance.iter().zip(&seen.class).enumerate() {
            let Some(index) = (*number as usize).checked_sub(1) else {
                assert_eq!(*class, 0);
                continue;
            };
            let item = &frame.boxes[index];
            assert_eq!(*class, town.log().tracks[item.track].class as u8);
            // The point of the pixel lies in the box.
            let centre = DVec3::new((pixel % 160) as f64 + 0.5, (pixel / 160) as f64 + 0.5, 1.0);
            let in_camera = view.camera.intrinsics.inverse() * centre * f64::from(seen.depth_m[pixel]);
            let at = view.camera_from_world.inverse().transform_point3(in_camera);
            let local = item.cuboid.pose.inverse().transform_point(at);
            assert!(item.cuboid.contains_local(local, 0.02), "{local} of {}", item.cuboid.size);
            shown += 1;
        }
    }
    assert!(shown > 100, "{shown} pixels of actors");
    // The same state given actor by actor.
    let actors: Vec<TrueActor<'_>> = frame
        .boxes
        .iter()
        .map(|item| TrueActor { track: &town.log().tracks[item.track].id, cuboid: item.cuboid })
        .collect();
    let again = town.truth_of(frame.t_us, &actors, &views).unwrap();
    for (a, b) in seen.iter().zip(&again) {
        let differ = a.instance.iter().zip(&b.instance).filter(|(a, b)| a != b).count();
        assert!(differ * 500 < a.instance.len(), "{differ} pixels");
    }
    // Nobody: no pixel of anybody.
    assert!(town.truth_of(frame.t_us, &[], &views).unwrap().iter().all(|v| v.class.iter().all(|c| *c == 0)));
    let stranger = [TrueActor { track: "nobody", cuboid: frame.boxes[0].cuboid }];
    let error = town.truth_of(frame.t_us, &stranger, &views).unwrap_err().to_string();
    assert_eq!(error, "expected tracks of town town-3, found nobody");
}

#[test]
fn a_town_comes_whole_or_not_at_all() {
    let log = TinyLog::new();
    let small = "--frames 1 --size 45x80";
    let summary = log.succeed(&format!("town --seed 2 {small} --truth --out out/town"));
    assert!(summary.starts_with("wrote town-2: 1 frames, 6 images, 1 sweeps"), "{summary}");
    for name in [
        "v1.0-town/sample.json",
        "maps/town.png",
        "maps/expansion/town.json",
        "truth/000000/CAM_BACK/depth.exr",
    ] {
        assert!(log.path("out/town").join(name).is_file(), "{name}");
    }
    assert!(log.path("out/town/truth/000000/CAM_BACK/instance.png").is_file());
    assert_eq!(
        log.json("out/town/town.json")["town"],
        "seed=2,frames=1,hz=5,beams=32,lidar_hz=10,size=45x80"
    );
    log.succeed("info nuscenes:out/town");
    // Replaced by its like, not by others.
    log.succeed(&format!("town --seed 4 {small} --out out/town"));
    assert!(!log.path("out/town/truth").exists());
    std::fs::remove_file(log.path("out/town/town.json")).unwrap();
    let output = log.run(&format!("town --seed 4 {small} --out out/town"));
    assert_failed(&output, 1, &["an older one with town.json"]);
    for (args, said) in [
        ("town --beams 16 --out out/x", "beams of 32 or 64"),
        ("town --frames 0 --out out/x", "1 to 10000 frames"),
        ("town --lidar-hz 10 --hz 12 --out out/x", "hz of 0.5 to lidar_hz"),
        ("town --light night --out out/x", "day, dusk or overcast"),
        ("info town:frames=0", "1 to 10000 frames"),
        ("build town:seed=x --out out/x", "whole number for seed"),
        ("render town:colour=3 --skeleton out/x --out out/y", "KEY=VALUE"),
        ("fidelity nuscenes:log --skeleton out/x", "expected a log town:"),
    ] {
        assert_failed(&log.run(args), 2, &[said]);
        assert!(!log.path("out/x").exists() && !log.path("out/y").exists());
    }
}

/// Built and rendered from memory; a build of another town is not gone on with.
#[test]
fn a_town_goes_through_all_commands() {
    let log = TinyLog::new();
    let town = "town:seed=5,frames=2,size=90x160";
    let summary = log.succeed(&format!("build {town} --out out/sk"));
    assert!(summary.starts_with("built town-5 from 2 frames") && summary.contains("12 images"), "{summary}");
    log.succeed(&format!("render {town} --skeleton out/sk --out out/maps --frames 0..1"));
    assert!(
        log.path("out/maps/000000/sheet.png").is_file()
            && log.path("out/maps/000000/CAM_BACK/map.png").is_file()
    );
    let output = log.run(&format!("fidelity {town} --skeleton out/sk --frames 0..1 --json out/f.json --markdown out/f.md --csv out/f.csv"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = log.json("out/f.json")["poses"].as_array().unwrap().clone();
    assert_eq!((rows.len(), &rows[0]["pose"], &rows[0]["images"]), (8, &"as driven".into(), &6.into()));
    let number = |path: &str| rows[0].pointer(path).unwrap().as_f64().unwrap();
    assert!(number("/color/psnr_db") > 15.0 && number("/color/filled") > 0.1, "{}", rows[0]);
    assert!(
        number("/depth/median_m") < 0.5 && number("/rendered/classes/motor_vehicle") > 0.3,
        "{}",
        rows[0]
    );
    assert_eq!(std::fs::read_to_string(log.path("out/f.md")).unwrap().lines().count(), 10);
    assert_eq!(std::fs::read_to_string(log.path("out/f.csv")).unwrap().lines().count(), 9);
    // A skeleton of one town is none of another.
    let output = log.run("fidelity town:seed=6,frames=2 --skeleton out/sk");
    assert_failed(&output, 1, &["a skeleton of log town-6"]);
}
