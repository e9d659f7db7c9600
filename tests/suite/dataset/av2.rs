//! The Argoverse 2 reader, on a synthetic log and on a real one compared with its files and NumPy.

use std::sync::Arc;

use arrow_array::Int32Array;
use glam::{DVec2, DVec3};
use point_skeleton::dataset::av2::{Argoverse, read_map_file, read_sweep_file};
use point_skeleton::dataset::{self, Class, LogLocator, LogReader, Recording, expand};
use point_skeleton::geometry::{Cuboid, View};
use point_skeleton::scene::{EgoOffset, state_of_frame};
use pskel_testing::av2_log::{
    FRAMES, IMAGE_NS, LOG_ID, MAP, RING, SIZE, START, TinyAv2, frame_ns, picture, read, set, set_number,
    sweep, write,
};
use pskel_testing::shared::shared;

fn locator(path: impl Into<std::path::PathBuf>) -> LogLocator {
    LogLocator::new(&point_skeleton::dataset::av2::FORMAT, path)
}

#[test]
fn reads_a_synthetic_log() {
    let made = TinyAv2::new();
    let dataset = made.open().unwrap();
    let log = dataset.recording();
    assert_eq!((log.name.as_str(), log.location.as_str(), log.frames.len()), (LOG_ID, "PIT", FRAMES));
    assert!(log.notes.is_empty(), "{:?}", log.notes);
    assert_eq!(log.cameras, RING.map(|(name, _)| name));
    let tracks: Vec<_> = log.tracks.iter().map(|t| (t.id.as_str(), t.category.as_str(), t.class)).collect();
    let sign = ("a sign", "static_object.sign", Class::Object);
    assert_eq!(tracks, [sign, ("car", "vehicle.car.regular_vehicle", Class::MotorVehicle)]);
    for (i, frame) in log.frames.iter().enumerate() {
        let ego = START + DVec3::X * i as f64;
        assert_eq!((frame.t_us, frame.global_from_ego.translation), (frame_ns(i) / 1000, ego));
        let sweep_record = &frame.sweeps[0];
        assert!(frame.sweeps.len() == 1 && sweep_record.is_key && sweep_record.path == made.path(&sweep(i)));
        let Cuboid { pose, size } = frame.boxes[1].cuboid;
        assert_eq!((pose.translation, size), (ego + DVec3::new(10.0, 0.0, 0.8), DVec3::new(4.0, 2.0, 1.6)));
        assert_eq!(frame.boxes[0].cuboid.pose.translation, START + DVec3::new(6.0, 3.0, 1.0));
        assert_eq!(frame.images.iter().map(|image| image.channel).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6]);
        for (image, (name, _)) in frame.images.iter().zip(RING) {
            assert_eq!(
                (&image.path, image.t_us),
                (&made.path(&picture(i, name)), (frame_ns(i) + IMAGE_NS) / 1000)
            );
            // Interpolated: one fifth of the way from the pose at the frame to the pose 50 ms later.
            assert!((image.global_from_ego.translation - (ego + DVec3::X * 0.1)).length() < 1e-9);
            assert_eq!(dataset.read_image(image).unwrap().dimensions(), (SIZE[1].into(), SIZE[0].into()));
            assert_eq!(image.camera.lens, None);
        }
        let cloud = dataset.read_sweep(sweep_record).unwrap();
        assert_eq!(dataset.check_sweep(sweep_record).unwrap(), Some(cloud.points.len() as u64));
        let in_car = cloud.points.iter().filter(|p| p.position[0] == 8.0 && p.position[2] > 0.0).count();
        assert_eq!((in_car, dataset.box_points().unwrap()[i].clone()), (77, vec![Some(0), Some(77)]));
        assert_eq!((cloud.points[70].intensity, cloud.points[70].ring), (70.0, 6));
        assert_eq!(cloud.points[70].position, [-4.5, 5.0, 0.0]);
    }
}

#[test]
fn reads_a_synthetic_map() {
    let made = TinyAv2::new();
    let map = made.open().unwrap().read_map().unwrap().unwrap();
    let at = |x: f64, y: f64| DVec2::new(START.x + x, START.y + y);
    assert_eq!((map.location.as_str(), map.stop_lines.len()), ("PIT", 0));
    let ids: Vec<&str> = map.lanes.iter().map(|lane| lane.id.as_str()).collect();
    assert_eq!((ids, map.lane_connectors[0].id.as_str()), (vec!["8", "9"], "7"));
    let lane = &map.lanes[1];
    assert_eq!(lane.outline.exterior, [at(0.0, 2.0), at(20.0, 2.0), at(20.0, -2.0), at(0.0, -2.0)]);
    assert_eq!(
        (lane.successors.clone(), map.lane_connectors[0].successors.clone()),
        (vec!["7".into()], vec!["99".into()])
    );
    assert_eq!(lane.centerline.len(), 41);
    assert!(lane.centerline.iter().enumerate().all(|(i, p)| p.distance(at(0.5 * i as f64, 0.0)) < 1e-9));
    // A border shared by two lanes occurs once; an unpainted border does not occur.
    assert_eq!(map.dividers, [[at(0.0, -2.0), at(20.0, -2.0)], [at(0.0, 2.0), at(20.0, 2.0)]]);
    let crossing = [at(20.0, -6.0), at(20.0, 2.0), at(23.0, 2.0), at(23.0, -6.0)];
    assert_eq!((&map.crossings[0].exterior[..], map.drivable_area[0].exterior.len()), (&crossing[..], 4));
    std::fs::remove_file(made.path(MAP)).unwrap();
    let dataset = made.open().unwrap();
    assert!(dataset.read_map().unwrap().is_none() && dataset.recording().location.is_empty());
}

#[test]
fn a_folder_of_logs_is_a_set() {
    let made = TinyAv2::new();
    let root = made.root();
    assert_eq!(expand(&locator(root)).unwrap(), [locator(made.path(""))]);
    assert_eq!(Argoverse::open(&locator(root)).unwrap().recording().name, LOG_ID);
    std::fs::create_dir(root.join("ffff")).unwrap();
    std::fs::create_dir(root.join("no log")).unwrap();
    for file in ["annotations.feather", "city_SE3_egovehicle.feather"] {
        std::fs::copy(made.path(file), root.join("ffff").join(file)).unwrap();
    }
    let all = [locator(root.join(LOG_ID)), locator(root.join("ffff"))];
    let named = |scene: &str| LogLocator { scene: Some(scene.into()), ..locator(root) };
    assert_eq!(expand(&locator(root)).unwrap(), all);
    assert_eq!(expand(&named("*")).unwrap(), all);
    assert_eq!(expand(&named("ffff")).unwrap(), all[1..]);
    assert_eq!(dataset::open(&named(LOG_ID)).unwrap().recording().name, LOG_ID);
    let reported = |locator: &LogLocator| Argoverse::open(locator).unwrap_err().to_string();
    let several = reported(&locator(root));
    assert!(several.contains("#SCENE to name one of 0a1b2c3d, ffff, found none"), "{several}");
    assert!(reported(&named("eeee")).contains("one of 0a1b2c3d, ffff, found eeee"));
    assert!(reported(&locator(root.join("no log"))).contains("or a folder of logs, found neither"));
    let versioned = LogLocator { version: Some("v2".into()), ..locator(root) };
    assert!(reported(&versioned).contains("without @VERSION, found @v2"));
    // A missing file is reported as missing, not as an unrecognized log.
    assert!(reported(&locator(root.join("ffff"))).contains("cannot read"));
}

#[test]
fn sensors_and_maps_may_be_in_other_folders() {
    let made = TinyAv2::new();
    let elsewhere = tempfile::tempdir().unwrap();
    let of_log = elsewhere.path().join(LOG_ID);
    std::fs::create_dir(&of_log).unwrap();
    for part in ["sensors", "map"] {
        std::fs::rename(made.path(part), of_log.join(part)).unwrap();
    }
    let bare = made.open().unwrap();
    assert_eq!(bare.recording().notes["missing camera images"], FRAMES * RING.len());
    assert!(bare.read_map().unwrap().is_none());
    for [sensors, map] in [
        [elsewhere.path().to_owned(), elsewhere.path().to_owned()],
        [of_log.join("sensors"), of_log.join("map")],
    ] {
        let moved = LogLocator { sensor_root: Some(sensors), map_root: Some(map), ..locator(made.path("")) };
        let dataset = Argoverse::open(&moved).unwrap();
        assert!(dataset.recording().notes.is_empty() && dataset.read_map().unwrap().is_some());
    }
}

#[test]
fn given_sensor_and_map_folders_must_exist() {
    let made = TinyAv2::new();
    let (gone, file) = (made.path("gone"), made.path("annotations.feather"));
    for (place, found) in [(&gone, "cannot read"), (&file, "expected a folder, found a file")] {
        let maps = LogLocator { map_root: Some(place.clone()), ..locator(made.path("")) };
        let sensors = LogLocator { sensor_root: Some(place.clone()), ..locator(made.path("")) };
        for locator in [maps, sensors] {
            let message = Argoverse::open(&locator).unwrap_err().to_string();
            assert!(message.contains(found) && message.ends_with(place.to_str().unwrap()), "{message}");
        }
    }
    let said = LogLocator { map_root: Some(made.path("sensors")), ..locator(made.path("")) };
    let message = Argoverse::open(&said).unwrap().read_map().unwrap_err().to_string();
    assert!(message.contains("expected a map (log_map_archive_*.json), found none"), "{message}");
    // If there are two map files, the first is read.
    assert!(made.open().unwrap().read_map().unwrap().unwrap().notes.is_empty());
    std::fs::write(made.path("map/log_map_archive_z.json"), "{}").unwrap();
    let notes = made.open().unwrap().read_map().unwrap().unwrap().notes;
    assert_eq!(notes.into_iter().collect::<Vec<_>>(), [("further map files".to_owned(), 1)]);
    // A file at the default map location is an error, not a missing map.
    std::fs::remove_dir_all(made.path("map")).unwrap();
    assert!(made.open().unwrap().read_map().unwrap().is_none());
    std::fs::write(made.path("map"), "").unwrap();
    assert!(made.open().unwrap_err().to_string().contains("cannot read"));
}

#[test]
fn boxes_without_a_size_are_counted() {
    let made = TinyAv2::new();
    made.edit("annotations.feather", |columns| {
        set_number(columns, "width_m", 1, 0.0);
        set_number(columns, "height_m", 2, -1.0);
    });
    let dataset = made.open().unwrap();
    let notes: Vec<_> = dataset.recording().notes.clone().into_iter().collect();
    assert_eq!(notes, [("boxes without a size".to_owned(), 2)]);
    let boxes: Vec<usize> = dataset.recording().frames.iter().map(|f| f.boxes.len()).collect();
    let stated: Vec<usize> = dataset.box_points().unwrap().iter().map(Vec::len).collect();
    assert_eq!((&boxes[..2], &boxes), (&[1, 1][..], &stated));
    assert_eq!(dataset.box_points().unwrap()[1], [Some(0)]);
}

/// Overwrites each place in the file that stores the number of rows.
#[test]
fn rejects_more_rows_than_the_columns_have() {
    const ROWS: usize = 1237;
    let made = TinyAv2::new();
    let dataset = made.open().unwrap();
    let record = &dataset.recording().frames[0].sweeps[0];
    let mut columns: Vec<_> =
        read(&record.path).into_iter().map(|(name, c)| (name, c.slice(0, ROWS))).collect();
    // For columns of one byte per row, the edit would also change the byte count.
    for name in ["intensity", "laser_number"] {
        set(&mut columns, name, Arc::new(Int32Array::from_iter_values(0..ROWS as i32)));
    }
    for compression in [None, Some(arrow_ipc::CompressionType::LZ4_FRAME)] {
        write(&record.path, columns.clone(), compression);
        let whole = std::fs::read(&record.path).unwrap();
        assert_eq!(dataset.check_sweep(record).unwrap(), Some(ROWS as u64));
        for rows in [i64::MAX, 2 * ROWS as i64] {
            let found = format!("bytes in a batch of {rows} rows");
            let mut bytes = whole.clone();
            let places: Vec<usize> =
                (0..bytes.len() - 8).filter(|i| whole[*i..*i + 8] == ROWS.to_le_bytes()).collect();
            assert!(places.len() > columns.len(), "{places:?}");
            places.iter().for_each(|i| bytes[*i..*i + 8].copy_from_slice(&rows.to_le_bytes()));
            std::fs::write(&record.path, bytes).unwrap();
            for message in [dataset.check_sweep(record).err(), dataset.read_sweep(record).err()] {
                let message = message.unwrap().to_string();
                assert!(message.contains(&found), "{message}");
            }
        }
    }
}

fn real() -> Option<Argoverse> {
    let shared = shared("the Argoverse 2 log")?;
    Some(Argoverse::open(&locator(shared.join("data/av2"))).unwrap())
}

#[test]
fn real_log_matches_its_readme() {
    let Some(dataset) = real() else { return };
    let log: &Recording = dataset.recording();
    assert_eq!((log.name.split_once('-').unwrap().0, log.location.as_str()), ("7fab2350", "PIT"));
    assert_eq!((log.frames.len(), log.tracks.len()), (156, 114));
    assert_eq!(log.frames.iter().map(|f| f.boxes.len()).sum::<usize>(), 11_364);
    assert_eq!(log.frames.iter().map(|f| f.sweeps.len()).sum::<usize>(), 2);
    assert_eq!(log.cameras, RING.map(|(name, _)| name));
    let notes: Vec<(&str, usize)> = log.notes.iter().map(|(k, n)| (k.as_str(), *n)).collect();
    assert_eq!(
        notes,
        [("frames without a LiDAR sweep of their own", 154), ("missing camera images", 7 * 156)]
    );
    assert_eq!(log.frames[0].t_us, 315_966_253_660_357);
    let sizes: Vec<_> = log.rig.iter().map(|c| (c.camera.width, c.camera.height)).collect();
    assert_eq!((sizes[0], sizes[1], sizes.len()), ((1550, 2048), (2048, 1550), 7));
    let points: Vec<_> =
        log.frames.iter().flat_map(|f| &f.sweeps).map(|s| dataset.check_sweep(s).unwrap()).collect();
    assert_eq!(points, [Some(99_229), Some(99_466)]);
    // Position of a box in city coordinates, computed with NumPy.
    let bicycle = log.tracks.iter().position(|t| t.id.starts_with("1046f12a")).unwrap();
    let at = log.frames[0].cuboid_of(bicycle).unwrap().pose.translation;
    assert!((at - DVec3::new(5_219.828_573_64, 2_398.255_392_32, 68.812_085_36)).length() < 1e-7, "{at}");
    assert_eq!(log.tracks[bicycle].category, "vehicle.bicycle.bicycle");
}

/// Poses, boxes and sweeps are consistent: each box contains exactly the number of points that the file
/// states.
#[test]
fn real_boxes_contain_the_stated_number_of_points() {
    let Some(dataset) = real() else { return };
    let mut boxes = 0;
    for (frame, stated) in dataset.recording().frames.iter().zip(dataset.box_points().unwrap()) {
        let Some(record) = frame.sweeps.first() else { continue };
        let sweep = dataset.read_sweep(record).unwrap();
        assert_eq!(sweep.dropped_non_finite, 0);
        assert!(sweep.points.iter().any(|p| p.ring == 63) && sweep.points.iter().all(|p| p.ring <= 63));
        for (item, stated) in frame.boxes.iter().zip(stated) {
            let box_from_lidar = item.cuboid.pose.inverse() * record.global_from_ego * record.ego_from_lidar;
            let local = |p: [f32; 3]| box_from_lidar.transform_point(DVec3::from(p.map(f64::from)));
            let inside =
                sweep.points.iter().filter(|p| item.cuboid.contains_local(local(p.position), 0.0)).count();
            assert_eq!(Some(inside as u32), *stated, "{}", dataset.recording().tracks[item.track].id);
            boxes += 1;
        }
    }
    assert_eq!(boxes, 162);
}

/// Projects points of the ego frame into the cameras: pixel and depth as computed by NumPy and SciPy from the
/// same files.
#[test]
fn known_points_project_to_the_expected_pixels() {
    let Some(dataset) = real() else { return };
    let state = state_of_frame(dataset.recording(), 120, EgoOffset::default()).unwrap();
    let known = [
        ([20.0, 1.0, 0.5], "ring_front_center", [682.9738, 1101.9736, 18.36496]),
        ([5.0, -15.0, 1.0], "ring_side_right", [313.3971, 719.0367, 13.97283]),
        ([-12.0, 6.0, 0.2], "ring_rear_left", [947.9744, 905.5467, 14.3335]),
        ([8.0, 9.0, 2.0], "ring_front_left", [769.8666, 591.2721, 10.7405]),
    ];
    for (point, camera, expected) in known {
        let world = state.global_from_ego.transform_point(DVec3::from(point));
        let view: &View = &state.cameras.iter().find(|c| c.view.camera.name == camera).unwrap().view;
        let (pixel, depth_m) = view.project(world).unwrap();
        let found = [pixel.x, pixel.y, depth_m];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{camera}: {found:?}");
    }
}

#[test]
fn the_real_map_matches_the_recording() {
    let Some(dataset) = real() else { return };
    let map = dataset.read_map().unwrap().unwrap();
    assert_eq!((map.lanes.len(), map.lane_connectors.len()), (110, 73));
    assert_eq!((map.drivable_area.len(), map.crossings.len()), (13, 11));
    let inside = |ring: &[DVec2], p: DVec2| {
        let sides = ring.iter().zip(ring.iter().cycle().skip(1));
        let cuts = |(a, b): &(&DVec2, &DVec2)| {
            (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x)
        };
        sides.filter(cuts).count() % 2 == 1
    };
    for frame in &dataset.recording().frames {
        let ego = frame.global_from_ego.translation.truncate();
        assert!(map.drivable_area.iter().any(|area| inside(&area.exterior, ego)), "{ego}");
    }
    // Each lane ends where its successor starts.
    let lanes = || map.lanes.iter().chain(&map.lane_connectors);
    let mut met = 0;
    for lane in lanes() {
        for next in lane.successors.iter().filter_map(|id| lanes().find(|l| l.id == *id)) {
            let gap_m = lane.centerline.last().unwrap().distance(next.centerline[0]);
            assert!(gap_m < 0.05, "{} to {}: {gap_m} m", lane.id, next.id);
            met += 1;
        }
    }
    assert_eq!(met, 226 - 21);
    let Some(shared) = shared("the Argoverse 2 log") else { return };
    assert!(read_map_file(&shared.join("data/nuscenes-map/boston-thomaspark.json"), "").is_err());
    assert!(read_sweep_file(&shared.join("data/av2/README.md")).is_err());
}
