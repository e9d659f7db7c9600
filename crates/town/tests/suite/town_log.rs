//! The built-in town as a log: the recording agrees with the ground truth, and written logs are read
//! unchanged.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec2, DVec3};
use point_skeleton::dataset::nuscenes::write_log;
use point_skeleton::dataset::{
    ChangedLog, EgoTrack, ImageRecord, Lane, LogReader, PosedActor, RigCamera, TrackBox,
};
use point_skeleton::geometry::{Cuboid, Pose, View};
use point_skeleton::scene::{EgoOffset, state_at, state_of_frame};
use point_skeleton::skeleton::{BuildOptions, SplitOptions};
use pskel_testing::shared::{WithLog, skeleton_of};
use pskel_testing::synthetic_town::{self, FRAMES, OPTIONS, town};
use pskel_testing::tiny_log::tree;
use pskel_town::{Daylight, Town, TownOptions};

fn views(town: &Town, frame: usize) -> Vec<View> {
    let state = state_of_frame(town.recording(), frame, EgoOffset::default()).unwrap();
    state.cameras.into_iter().map(|camera| camera.view).collect()
}

fn close(a: &Pose, b: &Pose) -> bool {
    a.rotation.angle_between(b.rotation) < 1e-7 && (a.translation - b.translation).length() < 1e-9
}

/// A log with a moved ego has the states of the log seen from the moved ego; a recorded log has no images
/// there.
#[test]
fn cameras_move_with_a_moved_ego() {
    let offset = EgoOffset { forward_m: 0.5, left_m: 2.0, yaw_deg: 6.0, ..EgoOffset::default() };
    let moved = ChangedLog::with_moved_ego(Arc::new(Town::new(&OPTIONS).unwrap()), offset).unwrap();
    let log = town().recording();
    for frame in 0..FRAMES {
        let found = state_of_frame(moved.recording(), frame, EgoOffset::default()).unwrap();
        let expected = state_of_frame(log, frame, offset).unwrap();
        assert!(close(&found.global_from_ego, &expected.global_from_ego));
        assert_eq!((&found.actors, found.cameras.len()), (&expected.actors, 6));
        for (found, expected) in found.cameras.iter().zip(&expected.cameras) {
            assert!(close(&found.global_from_ego, &expected.global_from_ego));
            let off = found.view.camera_from_world.inverse() * expected.view.camera_from_world;
            assert!(off.abs_diff_eq(glam::DAffine3::IDENTITY, 1e-9), "{off:?}");
        }
    }
    // Between frames too, and without moving the LiDAR.
    let (track, moved_track) = (EgoTrack::new(log), EgoTrack::new(moved.recording()));
    let (first, last) = (log.frames[0].t_us, log.frames[FRAMES - 1].t_us);
    for t_us in (first..=last).step_by(30_000) {
        let found = state_at(moved.recording(), &moved_track, t_us, EgoOffset::default()).unwrap();
        let expected = state_at(log, &track, t_us, offset).unwrap();
        let off = found.global_from_ego.inverse() * expected.global_from_ego;
        assert!(
            off.translation.length() < 0.01 && off.rotation.angle_between(Pose::IDENTITY.rotation) < 1e-3,
            "{off:?}"
        );
    }
    for (sweep, before) in
        moved.recording().frames.iter().zip(&log.frames).flat_map(|(a, b)| a.sweeps.iter().zip(&b.sweeps))
    {
        assert!(close(
            &(sweep.global_from_ego * sweep.ego_from_lidar),
            &(before.global_from_ego * before.ego_from_lidar)
        ));
    }
    assert!(moved.view_renderer().is_some());
    let recorded = WithLog { drive: town(), log: log.clone() };
    assert!(ChangedLog::with_moved_ego(Arc::new(recorded), offset).is_none());
}

/// Returns the distance from a point to a polyline.
fn away(point: DVec2, line: &[DVec2]) -> f64 {
    let to_piece = |w: &[DVec2]| {
        let s = (point - w[0]).dot(w[1] - w[0]) / (w[1] - w[0]).length_squared();
        point.distance(w[0].lerp(w[1], s.clamp(0.0, 1.0)))
    };
    line.windows(2).map(to_piece).fold(f64::INFINITY, f64::min)
}

#[test]
fn frames_sweeps_and_images_have_their_times() {
    let log = town().recording();
    assert_eq!(
        (log.name.as_str(), log.location.as_str(), log.frames.len()),
        ("town-3-6f-dusk", "town", FRAMES)
    );
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
    // The ego moves, and its poses at images lie between those at frames.
    let ego = EgoTrack::new(log);
    let image = &log.frames[1].images[0];
    let between = ego.at(image.t_us).unwrap();
    assert!(between.translation.distance(image.global_from_ego.translation) < 0.02);
    // With other rates of frames and LiDAR turns, every turn occurs once.
    let other = Town::new(&TownOptions { frames: 4, hz: 4.0, lidar_hz: 20.0, ..OPTIONS }).unwrap();
    let counts: Vec<usize> = other.recording().frames.iter().map(|frame| frame.sweeps.len()).collect();
    assert_eq!(counts, [1, 5, 5, 5]);
    // Names distinguish drives, but not recording options.
    let named = |options: TownOptions| Town::new(&options).unwrap().recording().name.clone();
    assert_eq!(other.recording().name, "town-3-4f-4hz-dusk");
    assert_eq!(named(TownOptions { beams: 64, size: [45, 80], ..OPTIONS }), log.name);
    assert_eq!(named(TownOptions { daylight: Some(Daylight::Day), ..OPTIONS }), "town-3-6f-day");
}

#[test]
fn a_written_town_is_read_back_unchanged() {
    let (town, (_files, read)) = (town(), synthetic_town::read());
    assert_eq!(synthetic_town::written().done, (0..FRAMES).collect::<Vec<_>>());
    let (a, b) = (town.recording(), read.recording());
    assert_eq!((&a.name, &a.location, &a.cameras, &a.tracks), (&b.name, &b.location, &b.cameras, &b.tracks));
    let mounts = |(a, b): (&RigCamera, &RigCamera)| {
        (a.channel, &a.camera) == (b.channel, &b.camera) && close(&a.ego_from_camera, &b.ego_from_camera)
    };
    assert!(a.rig.len() == b.rig.len() && a.rig.iter().zip(&b.rig).all(mounts) && b.notes.is_empty());
    for (a, b) in a.frames.iter().zip(&b.frames) {
        assert!(a.t_us == b.t_us && close(&a.global_from_ego, &b.global_from_ego));
        let key = |frame: &point_skeleton::dataset::Frame| {
            let sweeps = frame.sweeps.iter().map(|s| (s.t_us, s.is_key)).collect::<Vec<_>>();
            let images =
                frame.images.iter().map(|i| (i.channel, i.t_us, i.camera.clone())).collect::<Vec<_>>();
            (sweeps, images, frame.boxes.iter().map(|b| b.track).collect::<Vec<_>>())
        };
        assert_eq!(key(a), key(b));
        assert!(
            a.boxes
                .iter()
                .zip(&b.boxes)
                .all(|(a, b)| { a.cuboid.size == b.cuboid.size && close(&a.cuboid.pose, &b.cuboid.pose) })
        );
        let mounted = |(a, b): (&ImageRecord, &ImageRecord)| {
            close(&a.ego_from_camera, &b.ego_from_camera) && close(&a.global_from_ego, &b.global_from_ego)
        };
        assert!(a.images.iter().zip(&b.images).all(mounted));
    }
    let (first, same) = (&a.frames[..2], &b.frames[..2]);
    for (a, b) in first.iter().zip(same) {
        for (x, y) in a.sweeps.iter().zip(&b.sweeps) {
            assert_eq!(town.read_sweep(x).unwrap(), read.read_sweep(y).unwrap());
        }
    }
    let [image, jpeg] =
        [town, &read as &dyn LogReader].map(|d| d.read_image(&d.recording().frames[1].images[0]).unwrap());
    let off: u64 = image.iter().zip(jpeg.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    assert!(off < 4 * image.len() as u64, "JPEG changes a channel by {} levels", off / image.len() as u64);
    let [mut a, mut b] = [town, &read as &dyn LogReader].map(|d| d.read_map().unwrap().unwrap());
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
    let made = |seed: u64| Town::new(&TownOptions { seed, frames: 1, size: [45, 80], ..OPTIONS }).unwrap();
    let write = || {
        let folder = tempfile::tempdir().unwrap();
        write_log(folder.path(), "v1.0-town", &made(3)).unwrap();
        tree(folder.path())
    };
    assert!(write() == write());
    // Another seed gives another town.
    assert!(made(3).read_map().unwrap() != made(4).read_map().unwrap());
}

/// The LiDAR's rays and the triangle pipeline render the same town: points agree with the depth map. The back
/// camera fires at the timestamp of the sweep.
#[test]
fn the_lidar_and_the_cameras_agree() {
    let town = town();
    let frame = &town.recording().frames[1];
    let image = &frame.images[3];
    assert_eq!(image.t_us, frame.t_us);
    // Pixels so small that the depth of distant ground changes little within one.
    let (height, width) = (720, 1280);
    let camera = image.camera.resized(height, width);
    let view = View { camera, camera_from_world: image.camera_from_global().affine() };
    let seen = &town.truth(frame.t_us, std::slice::from_ref(&view)).unwrap()[0];
    let sweep = town.read_sweep(&frame.sweeps[0]).unwrap();
    let global_from_lidar = frame.sweeps[0].global_from_ego * frame.sweeps[0].ego_from_lidar;
    let (mut compared, mut off) = (0, Vec::new());
    for point in &sweep.points {
        let at = global_from_lidar.transform_point(DVec3::from(point.position.map(f64::from)));
        let Some((pixel, depth_m)) = view.project(at) else { continue };
        let inside =
            pixel.cmpge(DVec2::ZERO).all() && pixel.x < f64::from(width) && pixel.y < f64::from(height);
        if !inside || depth_m > 30.0 {
            continue;
        }
        compared += 1;
        let own = seen.depth_m[pixel.y as usize * width as usize + pixel.x as usize];
        // At an edge, one of the two may hit the surface behind it.
        off.push((f64::from(own) - depth_m).abs() / depth_m);
    }
    off.sort_by(f64::total_cmp);
    assert!(compared > 1000, "{compared}");
    assert!(off[compared / 2] < 0.01, "median {}", off[compared / 2]);
    assert!(off[compared * 8 / 10] < 0.05, "80 %: {}", off[compared * 8 / 10]);
    // The test can fail: shifted by half a meter, the same points do not fit.
    let shifted = View {
        camera_from_world: glam::DAffine3::from_translation(DVec3::X * 0.5) * view.camera_from_world,
        ..view
    };
    let moved = town.truth(frame.t_us, &[shifted]).unwrap();
    assert!(moved[0].depth_m != seen.depth_m);
}

/// Points in the boxes of static actors: none sticks out, and at least half of the actors near the ego have
/// points.
#[test]
fn boxes_contain_their_actors() {
    let town = town();
    let frames = &town.recording().frames;
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
        let stands = frames[FRAMES - 1]
            .cuboid_of(item.track)
            .is_some_and(|c: Cuboid| close(&c.pose, &item.cuboid.pose));
        if stands {
            // Range errors are 1.5 cm, and at most five times that.
            assert_eq!(inside(0.08), inside(0.12), "{}", town.recording().tracks[item.track].id);
        }
        if item.cuboid.pose.translation.distance(frame.global_from_ego.translation) < 20.0 {
            near += 1;
            seen += usize::from(inside(0.08) > 0);
        }
    }
    assert!(near >= 2 && seen * 2 >= near, "{seen} of {near} near the ego are seen");
}

#[test]
fn ground_truth_is_numbered_like_boxes() {
    let town = town();
    let frame = &town.recording().frames[1];
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
            assert_eq!(*class, town.recording().tracks[item.track].class as u8);
            // The point that the pixel shows lies in the box.
            let centre = DVec3::new((pixel % 160) as f64 + 0.5, (pixel / 160) as f64 + 0.5, 1.0);
            let in_camera = view.camera.intrinsics.inverse() * centre * f64::from(seen.depth_m[pixel]);
            let at = view.camera_from_world.inverse().transform_point3(in_camera);
            let local = item.cuboid.pose.inverse().transform_point(at);
            assert!(item.cuboid.contains_local(local, 0.02), "{local} of {}", item.cuboid.size);
            shown += 1;
        }
    }
    assert!(shown > 100, "{shown} pixels of actors");
    // The same state, passed actor by actor.
    let actors: Vec<PosedActor<'_>> = frame
        .boxes
        .iter()
        .map(|item| PosedActor { track: &town.recording().tracks[item.track].id, cuboid: item.cuboid })
        .collect();
    let again = town.truth_of(frame.t_us, &actors, &views).unwrap();
    for (a, b) in seen.iter().zip(&again) {
        let differ = a.instance.iter().zip(&b.instance).filter(|(a, b)| a != b).count();
        assert!(differ * 500 < a.instance.len(), "{differ} pixels");
    }
    // Without actors, no pixel shows one.
    assert!(town.truth_of(frame.t_us, &[], &views).unwrap().iter().all(|v| v.class.iter().all(|c| *c == 0)));
    let stranger = [PosedActor { track: "nobody", cuboid: frame.boxes[0].cuboid }];
    let error = town.truth_of(frame.t_us, &stranger, &views).unwrap_err().to_string();
    assert_eq!(error, "expected tracks of town town-3-6f-dusk, found nobody");
}

/// Every point inside a box at the time of its sweep belongs to that actor. Between frames, the boxes are
/// interpolated.
#[test]
fn sweeps_between_frames_are_split_by_interpolated_boxes() {
    let (_files, drive) = synthetic_town::read();
    let mut log = WithLog::grey(&drive, &[1, 2]);
    // All boxes creep forward independently of the actors, so that the choice of boxes matters.
    for (frame, item) in
        (0..).zip(&mut log.log.frames).flat_map(|(i, f)| f.boxes.iter_mut().map(move |b| (i, b)))
    {
        let pose = &mut item.cuboid.pose;
        pose.translation += pose.rotation * DVec3::X * (0.5 * f64::from(frame));
    }
    let folder = tempfile::tempdir().unwrap();
    for between_sweeps in [false, true] {
        let options = BuildOptions { between_sweeps, voxel_m: 0.0, ..BuildOptions::default() };
        let all: Vec<usize> = (0..FRAMES).collect();
        let built = skeleton_of(&folder.path().join("s"), &log, &all, &options).manifest;
        assert_eq!(built.report.sweeps, if between_sweeps { 4 } else { 2 });
        let found: BTreeMap<String, usize> = built.actors.into_iter().map(|a| (a.track, a.points)).collect();
        let expected = points_in_boxes(&log, between_sweeps, true);
        assert!(expected.values().sum::<usize>() > 100, "{expected:?}");
        assert_eq!(found, expected);
        // The boxes of the frames would select other points.
        assert_eq!(expected == points_in_boxes(&log, between_sweeps, false), !between_sweeps);
    }
}

/// Counts the points of all sweeps per actor, with boxes at the times of sweeps or of their frames.
fn points_in_boxes(
    drive: &WithLog<'_>,
    between_sweeps: bool,
    at_their_times: bool,
) -> BTreeMap<String, usize> {
    let SplitOptions { margin_m, ground_m, .. } = SplitOptions::default();
    let log = drive.recording();
    let mut counts = BTreeMap::new();
    let records = log.frames.iter().enumerate().flat_map(|(i, f)| f.sweeps.iter().map(move |s| (i, s)));
    for (index, record) in records.filter(|(_, s)| s.is_key || between_sweeps) {
        let [before, after] = [index - 1, index].map(|i| &log.frames[i]);
        let s = (record.t_us - before.t_us) as f64 / (after.t_us - before.t_us) as f64;
        let s = if at_their_times { s } else { 1.0 };
        let moved = |b: &TrackBox| Some((b.track, before.cuboid_of(b.track)?.interpolate(&b.cuboid, s)));
        let boxes: Vec<(usize, Cuboid)> = after.boxes.iter().filter_map(moved).collect();
        let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
        for point in drive.read_sweep(record).unwrap().points {
            let at = global_from_lidar.transform_point(DVec3::from(point.position.map(f64::from)));
            let deep = |(track, cuboid): &(usize, Cuboid)| {
                let local = cuboid.pose.inverse().transform_point(at);
                let inside =
                    cuboid.contains_local(local, margin_m) && local.z > ground_m - cuboid.size.z / 2.0;
                inside.then(|| ((local.abs() / (cuboid.size / 2.0)).max_element(), *track))
            };
            if let Some((_, track)) = boxes.iter().filter_map(deep).min_by(|a, b| a.0.total_cmp(&b.0)) {
                *counts.entry(log.tracks[track].id.clone()).or_default() += 1;
            }
        }
    }
    counts
}

/// A thread outside the pool renders while all threads of the pool wait for the renderer.
#[test]
fn images_are_rendered_from_any_thread() {
    let (done, all_done) = std::sync::mpsc::channel();
    let town = std::sync::Arc::new(Town::new(&OPTIONS).unwrap());
    for is_in_pool in [false, true] {
        let (done, town) = (done.clone(), std::sync::Arc::clone(&town));
        std::thread::spawn(move || {
            let record = &town.recording().frames[0].images[0];
            let images = || (0..6).map(|_| town.read_image(record).unwrap()).collect::<Vec<_>>();
            let images = if is_in_pool { rayon::broadcast(|_| images()).concat() } else { images() };
            done.send(images).unwrap();
        });
    }
    let wait = || all_done.recv_timeout(std::time::Duration::from_secs(120)).expect("a deadlock");
    let images = [wait(), wait()].concat();
    assert!(images.len() >= 12 && images.iter().all(|image| *image == images[0]));
}
