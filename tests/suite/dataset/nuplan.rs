//! The nuPlan reader on a synthetic log.

use glam::{DVec2, DVec3};
use point_skeleton::Log;
use point_skeleton::dataset::{self, Class, DatasetError, LogLocator, LogReader};
use point_skeleton::geometry::{Camera, LensModel, View};
use pskel_testing::nuplan_log::{
    CAMERA_Z, CORNERS, DELAY_US, DISTORTION, FIRST_US, FRAMES, LIDAR_Z, LOG, MAP, NuplanLog, RING, STEP_US,
    assert_says, car_at, ego_at, image_file, sweep_file, token,
};
use pskel_testing::tiny_log::tree;

fn open(locator: &LogLocator) -> Result<Log, DatasetError> {
    dataset::open(locator).map(Log::new)
}

#[test]
fn cameras_at_half_the_rate_give_every_frame_an_image() {
    let nuplan = NuplanLog::new();
    let dataset = nuplan.open().unwrap();
    let log = dataset.recording();
    assert_eq!((log.name.as_str(), log.location.as_str()), (LOG, MAP));
    assert_eq!(log.description, "veh-01 2021-01-01");
    assert!(log.notes.is_empty(), "{:?}", log.notes);
    assert_eq!(log.cameras, RING);
    assert_eq!(log.frames.len(), FRAMES);
    for (i, frame) in log.frames.iter().enumerate() {
        assert_eq!(frame.t_us, FIRST_US + STEP_US * i as i64);
        assert_eq!(frame.global_from_ego.translation, ego_at(i as f64));
        assert_eq!((frame.sweeps.len(), frame.images.len(), frame.between_images.len()), (1, 8, 0));
        let sweep = &frame.sweeps[0];
        assert_eq!((sweep.t_us, sweep.global_from_ego.translation), (frame.t_us, ego_at(i as f64)));
        assert_eq!(sweep.ego_from_lidar.translation, DVec3::Z * LIDAR_Z);
        for (channel, image) in frame.images.iter().enumerate() {
            // The image is 5 ms late or 45 ms early: two consecutive frames share an image, with that image's
            // pose.
            let shot = i / 2;
            assert_eq!((image.channel, &image.camera.name), (channel, &log.cameras[channel]));
            assert_eq!(image.t_us, FIRST_US + 2 * STEP_US * shot as i64 + DELAY_US);
            assert_eq!(image.path, nuplan.blob(&image_file(RING[channel], shot)));
            assert_eq!(image.global_from_ego.translation, ego_at(2.0 * shot as f64 + 0.1));
            let lens = (channel == 1).then(|| LensModel::from_opencv(DISTORTION).unwrap());
            assert_eq!(image.camera.lens, lens);
            assert_eq!(dataset.read_image(image).unwrap().dimensions(), (96, 64));
        }
    }
}

#[test]
fn tracks_with_boxes_are_sorted_by_id() {
    let nuplan = NuplanLog::new();
    let dataset = nuplan.open().unwrap();
    let log = dataset.recording();
    let tracks: Vec<_> = log.tracks.iter().map(|t| (t.id.as_str(), t.category.as_str(), t.class)).collect();
    let expected =
        [("7400000000000008", "bicycle", Class::Cycle), ("7400000000000009", "vehicle", Class::MotorVehicle)];
    assert_eq!(tracks, expected);
    for (i, frame) in log.frames.iter().enumerate() {
        let car = frame.cuboid_of(1).unwrap();
        // The columns are width, length, height.
        assert_eq!((car.size, car.pose.translation), (DVec3::new(4.0, 2.0, 1.5), car_at(i)));
        let forward = car.pose.rotation * DVec3::X;
        assert!((forward - DVec3::new(0.25_f64.cos(), 0.25_f64.sin(), 0.0)).length() < 1e-12);
    }
}

/// A camera looks along x, y or -x from 1.5 m above a known ego position, so pixels are computed by hand.
#[test]
fn known_points_fall_on_known_pixels() {
    let nuplan = NuplanLog::new();
    let dataset = nuplan.open().unwrap();
    let frame = &dataset.recording().frames[1];
    let eye = ego_at(0.1) + DVec3::Z * CAMERA_Z;
    let pixel = |channel: usize, offset: DVec3| {
        let image = &frame.images[channel];
        let view = View {
            camera: Camera::clone(&image.camera),
            camera_from_world: image.camera_from_global().affine(),
        };
        view.project(eye + offset)
    };
    let near = |found: Option<(DVec2, f64)>, pixel: [f64; 2], depth_m: f64| {
        let (p, z) = found.unwrap();
        assert!(p.distance(DVec2::from(pixel)) < 1e-6 && (z - depth_m).abs() < 1e-8, "{p} {z}");
    };
    // Ahead, 1 m to the left, 0.5 m down: f = 48, center (48, 32).
    near(pixel(0, DVec3::new(10.0, 1.0, -0.5)), [48.0 - 4.8, 32.0 + 2.4], 10.0);
    // For the right camera, forward is on its left; for the left camera, on its right.
    near(pixel(2, DVec3::new(1.0, -8.0, 0.0)), [48.0 - 6.0, 32.0], 8.0);
    near(pixel(6, DVec3::new(1.0, 8.0, 0.0)), [48.0 + 6.0, 32.0], 8.0);
    near(pixel(4, DVec3::new(-6.0, 1.0, 2.0)), [48.0 + 8.0, 32.0 - 16.0], 6.0);
    assert!(pixel(4, DVec3::X).is_none());
}

/// The car's box contains exactly the points that were placed on its back, of both devices.
#[test]
fn points_lie_in_their_box() {
    let nuplan = NuplanLog::new();
    let dataset = nuplan.open().unwrap();
    for frame in &dataset.recording().frames {
        let record = &frame.sweeps[0];
        let sweep = dataset.read_sweep(record).unwrap();
        assert!(sweep.devices);
        assert_eq!(dataset.check_sweep(record).unwrap(), Some(sweep.points.len() as u64));
        let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
        let mut car = frame.cuboid_of(1).unwrap();
        car.pose.rotation = glam::DQuat::IDENTITY; // the orientation used when placing the points
        let inside = |p: &&dataset::SweepPoint| {
            let global = global_from_lidar.transform_point(DVec3::from(p.position.map(f64::from)));
            let local = car.pose.inverse().transform_point(global);
            local.z > 0.1 - car.size.z / 2.0 && car.contains_local(local, 1e-4)
        };
        let rings: Vec<u16> = sweep.points.iter().filter(inside).map(|p| p.ring).collect();
        assert_eq!(rings, [[0; 10], [4; 10]].concat());
    }
}

#[test]
fn a_scene_is_a_part_of_the_log() {
    let nuplan = NuplanLog::new();
    for scene in ["scene-001", "7300000000000001"] {
        let locator = LogLocator { scene: Some(scene.into()), ..nuplan.locator() };
        let dataset = open(&locator).unwrap();
        let log = dataset.recording();
        let times: Vec<i64> = log.frames.iter().map(|f| (f.t_us - FIRST_US) / STEP_US).collect();
        assert_eq!((times, log.name.as_str()), (vec![2, 3], LOG));
        assert_eq!(log.description, "veh-01 2021-01-01, scene-001");
        let scenarios: Vec<_> =
            log.scenarios.iter().map(|(kind, at)| (kind.as_str(), at.as_slice())).collect();
        assert_eq!(scenarios, [("following", &[0, 1][..]), ("waiting", &[0, 1][..])]);
        let lights: Vec<_> =
            log.lights.iter().map(|l| (l.frame, l.lane_connector.as_str(), l.color.as_str())).collect();
        assert_eq!(lights, [(0, "71", "green"), (1, "71", "green")]);
        assert!(log.frames.iter().all(|f| f.images.len() == 8 && f.boxes.len() == 2), "{:?}", log.notes);
        assert!(log.notes.is_empty(), "{:?}", log.notes);
    }
    let locator = LogLocator { scene: Some("scene-009".into()), ..nuplan.locator() };
    let message = open(&locator).err().unwrap().to_string();
    assert_says(&message, &["scene-000, scene-001, found scene-009"], &format!("{LOG}.db"));
}

#[test]
fn missing_files_are_skipped_and_counted() {
    let nuplan = NuplanLog::new();
    std::fs::remove_file(nuplan.blob(&sweep_file(2))).unwrap();
    for camera in &RING[..3] {
        std::fs::remove_file(nuplan.blob(&image_file(camera, 0))).unwrap();
    }
    let dataset = nuplan.open().unwrap();
    let log = dataset.recording();
    let notes: Vec<_> = log.notes.iter().map(|(kind, n)| (kind.as_str(), *n)).collect();
    assert_eq!(notes, [("missing image files", 3), ("missing sweep files", 1)]);
    let count = |of: fn(&dataset::Frame) -> usize| log.frames.iter().map(of).collect::<Vec<_>>();
    assert_eq!(count(|f| f.sweeps.len()), [1, 1, 0, 1]);
    assert_eq!(count(|f| f.images.len()), [5, 5, 8, 8]);
    assert_eq!(count(|f| f.boxes.len()), [2; 4]);
    assert!(log.frames[0].images.iter().all(|image| image.channel >= 3));
    // All blobs may be missing.
    std::fs::remove_dir_all(nuplan.blob("")).unwrap();
    let notes = nuplan.open().unwrap().recording().notes.clone();
    assert_eq!(notes.into_values().collect::<Vec<_>>(), [16, 4]);
}

#[test]
fn cameras_without_an_image_near_a_frame_are_counted() {
    let nuplan = NuplanLog::new();
    let (first, late) = (token('i', 0), token('i', 12));
    nuplan.sql(&format!("DELETE FROM image WHERE token = {first};"));
    nuplan.sql(&format!("UPDATE image SET timestamp = timestamp + 200000 WHERE token = {late};"));
    let dataset = nuplan.open().unwrap();
    let log = dataset.recording();
    let notes: Vec<_> = log.notes.iter().map(|(kind, n)| (kind.as_str(), *n)).collect();
    let (pose, others) = notes.split_first().unwrap();
    assert!(
        pose.0.starts_with("ego poses of another time than their data of CAM_R1 ") && pose.1 == 1,
        "{pose:?}"
    );
    assert_eq!(others, [("images outside of the frames' time", 1), ("missing camera images", 3)]);
    let of = |channel: usize| {
        let has = |frame: &dataset::Frame| frame.images.iter().any(|i| i.channel == channel);
        log.frames.iter().map(has).collect::<Vec<_>>()
    };
    // The image at 105 ms is 55 ms away from the second frame.
    assert_eq!(of(0), [false, true, true, true]);
    assert_eq!(of(2), [true, true, false, false]);
}

#[test]
fn images_far_from_every_frame_lie_between_frames() {
    let nuplan = NuplanLog::new();
    let (old, new) = (token('i', 3), token('i', 99));
    let rest = "next_token, prev_token, ego_pose_token, camera_token, filename_jpg";
    nuplan.sql(&format!(
        "INSERT INTO image SELECT {new}, {rest}, timestamp + 25000 FROM image WHERE token = {old};"
    ));
    let dataset = nuplan.open().unwrap();
    let between: Vec<usize> = dataset.recording().frames.iter().map(|f| f.between_images.len()).collect();
    // The image at 30 ms is closer to the frame at 50 ms than the one at 5 ms, which still serves the frame
    // at 0 ms.
    assert_eq!(between, [0; 4]);
    assert_eq!(dataset.recording().frames[1].images[3].t_us, FIRST_US + 30_000);
    nuplan.sql(&format!("UPDATE image SET timestamp = timestamp - 3000 WHERE token = {};", token('i', 99)));
    nuplan.sql(&format!(
        "UPDATE image SET timestamp = {} WHERE token = {};",
        FIRST_US + 49_000,
        token('i', 3)
    ));
    nuplan.sql(&format!(
        "UPDATE image SET timestamp = {} WHERE token = {};",
        FIRST_US + 2_000,
        token('i', 13)
    ));
    let dataset = nuplan.open().unwrap();
    let between: Vec<usize> = dataset.recording().frames.iter().map(|f| f.between_images.len()).collect();
    assert_eq!(between, [0, 1, 0, 0]);
    assert_eq!(dataset.recording().frames[1].between_images[0].t_us, FIRST_US + 27_000);
}

#[test]
fn sensors_and_maps_may_be_in_other_folders() {
    let nuplan = NuplanLog::new();
    for (from, to) in [("nuplan-v1.1/sensor_blobs", "blobs"), ("maps", "places")] {
        std::fs::rename(nuplan.path(from), nuplan.path(to)).unwrap();
    }
    let dataset = nuplan.open().unwrap();
    assert_eq!((dataset.recording().notes.len(), dataset.read_map().unwrap()), (2, None));
    let (sensor_root, map_root) = (Some(nuplan.path("blobs")), Some(nuplan.path("places")));
    let dataset = open(&LogLocator { sensor_root, map_root, ..nuplan.locator() }).unwrap();
    assert!(dataset.recording().notes.is_empty() && dataset.map().is_some());
    let gone = LogLocator { sensor_root: Some(nuplan.path("gone")), ..nuplan.locator() };
    assert_says(&open(&gone).err().unwrap().to_string(), &["cannot read"], "gone");
    // The given map folder must contain the log's map.
    std::fs::write(nuplan.path("places/nuplan-maps-v1.0.json"), "{}").unwrap();
    let said = LogLocator { map_root: Some(nuplan.path("places")), ..nuplan.locator() };
    let message = open(&said).unwrap().require_map().unwrap_err().to_string();
    assert_says(&message, &[&format!("expected map {MAP}, found none of that name")], "places");
}

#[test]
fn nothing_is_written_beside_the_data() {
    let nuplan = NuplanLog::new();
    // A log written with this journal mode makes readers create two more files.
    nuplan.sql("PRAGMA journal_mode = WAL; UPDATE log SET date = 'today';");
    let before = tree(&nuplan.path(""));
    let dataset = nuplan.open().unwrap();
    dataset.read_map().unwrap().unwrap();
    assert!(before == tree(&nuplan.path("")));
}

/// Data that is still in the journal would not be read.
#[test]
fn a_journal_beside_a_log_is_an_error() {
    let nuplan = NuplanLog::new();
    let mut journal = nuplan.database().into_os_string();
    journal.push("-wal");
    std::fs::write(&journal, "").unwrap();
    nuplan.open().unwrap();
    std::fs::write(&journal, [1; 33]).unwrap();
    nuplan.refuses(&["expected a database without a write-ahead log", "found 33 bytes in ", ".db-wal"]);
}

#[test]
fn maps_are_projected_to_meters() {
    let nuplan = NuplanLog::new();
    let map = nuplan.open().unwrap().read_map().unwrap().unwrap();
    assert_eq!(map.location, MAP);
    let assert_near = |points: &[DVec2], expected: &[[f64; 2]]| {
        assert_eq!(points.len(), expected.len());
        for (point, expected) in points.iter().zip(expected) {
            assert!(point.distance(DVec2::from(*expected)) < 1e-6, "{point} {expected:?}");
        }
    };
    // The drivable area combines two layers.
    let layers = [(&map.drivable_area, 2), (&map.crossings, 1), (&map.stop_lines, 1), (&map.walkways, 1)];
    for (areas, count) in layers {
        assert_eq!((areas.len(), areas[0].holes.len()), (count, 0));
        areas.iter().for_each(|area| assert_near(&area.exterior, &CORNERS));
    }
    assert_eq!(map.dividers.len(), 1);
    assert_near(&map.dividers[0], &CORNERS[..2]);
    let ids = |lanes: &[dataset::Lane]| -> Vec<(String, Vec<String>)> {
        lanes.iter().map(|lane| (lane.id.clone(), lane.successors.clone())).collect()
    };
    let of = |id: &str, next: &[&str]| (id.to_owned(), next.iter().map(ToString::to_string).collect());
    assert_eq!(ids(&map.lanes), [of("11", &["21"]), of("12", &[])]);
    assert_eq!(ids(&map.lane_connectors), [of("21", &["12"])]);
    assert_near(&map.lanes[0].outline.exterior, &CORNERS);
    assert_near(&map.lanes[0].centerline, &CORNERS[..2]);
    assert_near(&map.lane_connectors[0].centerline, &CORNERS[..2]);
    assert!(map.lanes[1].centerline.is_empty());
}
