//! A synthetic log is read as it was written, whatever the form of its files.

use arrow_ipc::CompressionType;
use glam::{DVec2, DVec3};
use point_skeleton::dataset::{Class, LogReader, Recording};
use point_skeleton::geometry::{Camera, LensModel, Pose};
use pskel_testing::py123d_log::{
    DISTORTION, FRAMES, FRONT, IMAGE_US, INTRINSICS, LEFT, LIDAR, POINTS, SIZE, START, TinyPy123d,
    camera_mount, ego, frame_us, image, picture, point, se3,
};

#[track_caller]
fn assert_same(found: &Pose, expected: &Pose) {
    let apart = se3(found).iter().zip(se3(expected)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-9, "{found:?} {expected:?}");
}

#[test]
fn poses_and_boxes_are_read() {
    let log = TinyPy123d::new().open().unwrap();
    let points = log.box_points().unwrap().to_vec();
    let log = log.recording();
    let about = [&log.name, &log.location, &log.description];
    assert_eq!(about, ["2026.01.02.made", "nowhere", "nuscenes made_train"]);
    assert_eq!((&log.notes, &log.gaps), (&Default::default(), &Vec::new()));
    let tracks = log.tracks.iter().map(|track| (track.id.as_str(), track.category.as_str(), track.class));
    let [car, walker] = [
        ("car", "vehicle.car", Class::MotorVehicle),
        ("walker", "human.pedestrian.adult", Class::Pedestrian),
    ];
    assert_eq!(tracks.collect::<Vec<_>>(), [car, walker]);
    assert_eq!(log.frames.len(), FRAMES);
    for (index, frame) in log.frames.iter().enumerate() {
        assert_eq!(frame.t_us, frame_us(index));
        assert_same(&frame.global_from_ego, &ego(index as f64));
        let ahead = ego(index as f64) * Pose::from_yaw(0.0, DVec3::new(12.0, 0.0, 0.8));
        let beside = ego(0.0) * Pose::from_yaw(1.0, DVec3::new(8.0, 4.0, 0.9));
        for (track, (pose, size)) in [(ahead, [4.0, 2.0, 1.6]), (beside, [0.6, 0.7, 1.8])].iter().enumerate()
        {
            assert_eq!(
                (frame.boxes[track].track, frame.boxes[track].cuboid.size),
                (track, DVec3::from(*size))
            );
            assert_same(&frame.boxes[track].cuboid.pose, pose);
        }
        assert_eq!(points[index], [Some(3), Some(index as u32)]);
    }
    let lights =
        log.lights.iter().map(|light| (light.frame, light.lane_connector.as_str(), light.color.as_str()));
    assert_eq!(
        lights.collect::<Vec<_>>(),
        [(0, "12", "green"), (1, "12", "yellow"), (2, "12", "red"), (3, "12", "unknown")]
    );
}

#[test]
fn images_are_read() {
    let made = TinyPy123d::new();
    let reader = made.open().unwrap();
    let log = reader.recording();
    assert_eq!(log.cameras, ["PCAM_F0", "PCAM_L0"]);
    let [fx, fy, cx, cy, skew] = INTRINSICS;
    for (channel, key) in [FRONT, LEFT].into_iter().enumerate() {
        let rows = [[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        let plain = Camera::new(&log.cameras[channel], SIZE[1], SIZE[0], rows).unwrap();
        // The images of the other camera are undistorted.
        let lens = if key == FRONT { LensModel::from_opencv(DISTORTION) } else { None };
        assert_eq!(log.rig[channel].camera, Camera { lens, ..plain });
        assert_same(&log.rig[channel].ego_from_camera, &camera_mount(key));
        for (index, frame) in log.frames.iter().enumerate() {
            let record = &frame.images[channel];
            let (path, row) = match key {
                FRONT => (made.path(FRONT), Some(index as u32)),
                _ => (made.sensor_root().join(picture(index)), None),
            };
            assert_eq!((&record.path, record.row, record.t_us), (&path, row, frame_us(index) + IMAGE_US));
            // Poses that are not stored are interpolated between those of the ego, and end with the last one.
            let late = if key == LEFT && index + 1 == FRAMES { 0.0 } else { 0.1 };
            assert_same(&record.global_from_ego, &ego(index as f64 + late));
            reader.check_image(record).unwrap();
            assert_eq!(reader.read_image(record).unwrap(), image(index));
        }
    }
    assert!(log.frames.iter().all(|frame| frame.images.len() == 2 && frame.between_images.is_empty()));
}

#[test]
fn sweeps_are_read() {
    let made = TinyPy123d::new();
    let reader = made.open().unwrap();
    for (index, frame) in reader.recording().frames.iter().enumerate() {
        let [record] = &frame.sweeps[..] else { panic!("{:?}", frame.sweeps) };
        assert_eq!((&record.path, record.row, record.is_key), (&made.path(LIDAR), Some(index as u32), true));
        assert_eq!((record.ego_from_lidar, record.t_us), (Pose::IDENTITY, frame.t_us));
        assert_eq!(record.global_from_ego, frame.global_from_ego);
        let sweep = reader.read_sweep(record).unwrap();
        assert_eq!((reader.check_sweep(record).unwrap(), sweep.points.len()), (Some(POINTS as u64), POINTS));
        for (i, found) in sweep.points.iter().enumerate() {
            assert_eq!((found.position, found.intensity), (point(index, i), (3 * i) as f32));
            assert_eq!(usize::from(found.ring), i % 32);
        }
        assert_eq!((sweep.devices, sweep.dropped_non_finite, sweep.notes.len()), (false, 0, 0));
    }
}

#[test]
fn the_map_is_read() {
    let map = TinyPy123d::new().open().unwrap().read_map().unwrap().unwrap();
    let at = |x: f64, y: f64| START.truncate() + DVec2::new(x, y);
    let rectangle =
        |x: f64, length: f64| [at(x, -2.0), at(x + length, -2.0), at(x + length, 2.0), at(x, 2.0)];
    let [lane] = &map.lanes[..] else { panic!("{:?}", map.lanes) };
    let [connector] = &map.lane_connectors[..] else { panic!("{:?}", map.lane_connectors) };
    assert_eq!((&*lane.id, &lane.successors[..], &*connector.id), ("11", &["12".to_owned()][..], "12"));
    assert_eq!((&lane.outline.exterior[..], lane.outline.holes.len()), (&rectangle(0.0, 20.0)[..], 0));
    assert_eq!(lane.centerline, [at(0.0, 0.0), at(20.0, 0.0)]);
    assert_eq!(connector.outline.exterior, rectangle(20.0, 20.0));
    let exteriors = |areas: &[point_skeleton::dataset::Area]| {
        areas.iter().map(|area| area.exterior.clone()).collect::<Vec<_>>()
    };
    assert_eq!(exteriors(&map.drivable_area), [rectangle(-5.0, 50.0)]);
    assert_eq!(exteriors(&map.crossings), [rectangle(18.0, 3.0)]);
    assert_eq!(map.dividers, [[at(0.0, 2.0), at(20.0, 2.0)]]);
    assert_eq!((&*map.location, map.stop_lines.len(), map.walkways.len()), ("nowhere", 0, 0));
    assert_eq!(map.notes, Default::default());
}

/// A log without the folder, which every log has another one of.
fn portable(made: &TinyPy123d, log: &Recording) -> Recording {
    let mut log = log.clone();
    let relative = |path: &std::path::Path| path.strip_prefix(made.root()).unwrap().to_owned();
    for frame in &mut log.frames {
        frame.sweeps.iter_mut().for_each(|sweep| sweep.path = relative(&sweep.path));
        frame.images.iter_mut().for_each(|image| image.path = relative(&image.path));
    }
    log
}

#[test]
fn compression_and_batches_change_nothing() {
    let read = |compression: Option<CompressionType>, batches: usize| {
        let mut made = TinyPy123d::new();
        for name in made.tables.keys().cloned().collect::<Vec<_>>() {
            made.edit(&name, |table| (table.compression, table.batches) = (compression, batches));
        }
        let reader = made.open().unwrap();
        let frames = &reader.recording().frames;
        let sweeps = frames
            .iter()
            .flat_map(|frame| &frame.sweeps)
            .map(|record| reader.read_sweep(record).unwrap().points);
        let images =
            frames.iter().flat_map(|frame| &frame.images).map(|record| reader.read_image(record).unwrap());
        let (sweeps, images) = (sweeps.collect::<Vec<_>>(), images.collect::<Vec<_>>());
        (portable(&made, reader.recording()), sweeps, images, reader.read_map().unwrap())
    };
    let expected = read(None, 1);
    for compression in [None, Some(CompressionType::LZ4_FRAME), Some(CompressionType::ZSTD)] {
        // The last number leaves batches without rows.
        for batches in [1, 3, 9] {
            assert!(read(compression, batches) == expected, "{compression:?} {batches}");
        }
    }
}
