//! The same recordings through other readers.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use glam::DVec3;
use point_skeleton::dataset::{
    ImageRecord, LogLocator, LogReader, Recording, SweepPoint, SweepRecord, TrackBox, av2, nuplan, nuscenes,
    open,
};
use point_skeleton::geometry::Pose;
use pskel_testing::shared::shared;

use super::open_recorded;

fn other(format: &'static point_skeleton::dataset::LogFormat, path: &str) -> Box<dyn LogReader> {
    let path = shared("a recording").unwrap().join("data").join(path);
    open(&LogLocator::new(format, path)).unwrap()
}

/// Largest difference of two poses: meters, and half radians.
fn apart(a: &Pose, b: &Pose) -> f64 {
    let turned = if a.rotation.dot(b.rotation) < 0.0 { -b.rotation } else { b.rotation };
    (a.translation - b.translation).length().max((a.rotation - turned).length())
}

/// Category, center, size and yaw of a box.
type BoxValues<'a> = (&'a str, [f64; 3], [f64; 3], f64);

/// Boxes by frame and track.
fn boxes(log: &Recording) -> Vec<BTreeMap<&str, BoxValues<'_>>> {
    let of = |item: &TrackBox| {
        let (track, cuboid) = (&log.tracks[item.track], &item.cuboid);
        let [center, size] = [cuboid.pose.translation, cuboid.size].map(|v| v.to_array());
        (track.id.as_str(), (track.category.as_str(), center, size, cuboid.pose.yaw_rad()))
    };
    log.frames.iter().map(|frame| frame.boxes.iter().map(of).collect()).collect()
}

fn images(log: &Recording) -> BTreeMap<&std::path::Path, &ImageRecord> {
    let all = log.frames.iter().flat_map(|frame| &frame.images);
    all.map(|image| (image.path.as_path(), image)).collect()
}

#[test]
fn nuscenes_is_the_same() {
    let Some(reader) = open_recorded("nuscenes-paths", "nuscenes") else { return };
    let other = other(&nuscenes::FORMAT, "pandaset-002/nuscenes");
    let (ours, theirs) = (reader.recording(), other.recording());
    assert_eq!(ours.frames.len(), 38);
    assert_eq!(boxes(ours), boxes(theirs));
    assert_eq!(reader.box_points(), other.box_points());
    let (seen, known) = (images(ours), images(theirs));
    assert_eq!(seen.keys().collect::<Vec<_>>(), known.keys().collect::<Vec<_>>());
    for (a, b) in seen.values().zip(known.values()) {
        assert_eq!((a.t_us, a.camera.intrinsics), (b.t_us, b.camera.intrinsics));
        let [a, b] = [a, b].map(|image| image.global_from_ego * image.ego_from_camera);
        assert!(apart(&a, &b) < 2e-13, "{}", apart(&a, &b));
    }
    for (a, b) in ours.frames.iter().zip(&theirs.frames) {
        assert_eq!((a.t_us, &a.global_from_ego, a.sweeps.len()), (b.t_us, &b.global_from_ego, 1));
        let (sweep, known) = (&a.sweeps[0], &b.sweeps[0]);
        assert_eq!(
            (&sweep.path, sweep.t_us, sweep.global_from_ego),
            (&known.path, known.t_us, known.global_from_ego)
        );
        assert!(apart(&sweep.ego_from_lidar, &known.ego_from_lidar) < 1e-13);
        assert_eq!(a.images.len(), b.images.len());
    }
    let first = &ours.frames[0].sweeps[0];
    assert_eq!(reader.read_sweep(first).unwrap(), other.read_sweep(&theirs.frames[0].sweeps[0]).unwrap());
    let (map, known) = (reader.read_map().unwrap().unwrap(), other.read_map().unwrap().unwrap());
    assert_eq!(
        (map.lanes.len(), map.lane_connectors.len()),
        (known.lanes.len(), known.lane_connectors.len())
    );
    assert_eq!(map.crossings, known.crossings);
    assert_eq!((map.walkways.len(), known.walkways.len()), (8, 0)); // not read from the tables of nuScenes
    assert_eq!(map.stop_lines, known.stop_lines);
    assert_eq!(map.drivable_area, known.drivable_area);
}

#[test]
fn nuplan_is_the_same_but_for_the_shutter() {
    let Some(reader) = open_recorded("nuplan-paths", "nuplan") else { return };
    let other = other(
        &nuplan::FORMAT,
        "pandaset-002/nuplan/nuplan-v1.1/splits/mini/2020.01.01.00.00.00_veh-02_00000_00079.db",
    );
    let (ours, theirs) = (reader.recording(), other.recording());
    let times = |log: &Recording| log.frames.iter().map(|frame| frame.t_us).collect::<Vec<_>>();
    assert_eq!(times(ours), times(theirs));
    assert_eq!(boxes(ours).len(), 38);
    for (a, b) in boxes(ours).iter().zip(boxes(theirs)) {
        assert!(a.keys().eq(b.keys()) && a.values().map(|a| (a.0, a.2)).eq(b.values().map(|b| (b.0, b.2))));
    }
    for (a, b) in ours.frames.iter().zip(&theirs.frames) {
        assert!((a.global_from_ego.translation - b.global_from_ego.translation).length() < 1e-3);
    }
    let sweeps = |log: &Recording| log.frames.iter().map(|f| f.sweeps.len()).sum::<usize>();
    assert_eq!(sweeps(ours), 6);
    // Six sweeps and their 36 images were written; three of the images before the interval of their frame.
    let (seen, known) = (images(ours), images(theirs));
    assert_eq!(seen.len(), 36);
    for (path, image) in seen {
        let known = known[path];
        // py123d takes the ego pose a sixtieth of a second later.
        let [a, b] = [image, known].map(|image| image.global_from_ego * image.ego_from_camera);
        assert!((a.translation - b.translation).length() < 0.12, "{}", path.display());
    }
    let lights = |log: &Recording| {
        let mut lights: Vec<_> =
            log.lights.iter().map(|l| (l.frame, l.lane_connector.clone(), l.color.clone())).collect();
        lights.sort();
        lights
    };
    assert_eq!(lights(ours), lights(theirs));
    let (map, known) = (reader.read_map().unwrap().unwrap(), other.read_map().unwrap().unwrap());
    let counts = |map: &point_skeleton::dataset::VectorMap| {
        let areas = [&map.drivable_area, &map.crossings, &map.stop_lines, &map.walkways].map(Vec::len);
        (map.lanes.len(), map.lane_connectors.len(), areas)
    };
    assert_eq!(counts(&map), counts(&known));
    assert_eq!(map.drivable_area.len(), 10);
}

#[test]
fn argoverse_has_the_pose_at_the_time_of_the_sweep() {
    let Some(reader) = open_recorded("av2-laz", "av2-sensor") else { return };
    let other = other(&av2::FORMAT, "av2");
    let (ours, theirs) = (reader.recording(), other.recording());
    assert_eq!(ours.frames.len(), 16);
    let known: BTreeMap<i64, _> = theirs.frames.iter().map(|frame| (frame.t_us, frame)).collect();
    let (found, expected) = (boxes(ours), boxes(theirs));
    for (i, frame) in ours.frames.iter().enumerate() {
        // Nanoseconds are cut off, or rounded through floats.
        let (place, known) = (frame.t_us - 1..=frame.t_us + 1)
            .find_map(|t_us| {
                Some((theirs.frames.iter().position(|frame| frame.t_us == t_us)?, known.get(&t_us)?))
            })
            .unwrap();
        let offset = (frame.global_from_ego.translation - known.global_from_ego.translation).length();
        assert!(offset < 1e-5, "{offset}");
        assert!(found[i].keys().eq(expected[place].keys()));
        for (a, b) in found[i].values().zip(expected[place].values()) {
            assert_eq!(a.0, b.0);
            assert!(
                (0..3)
                    .all(|axis| (a.1[axis] - b.1[axis]).abs() < 0.01 && (a.2[axis] - b.2[axis]).abs() < 1e-6)
            );
        }
    }
    let (map, known) = (reader.read_map().unwrap().unwrap(), other.read_map().unwrap().unwrap());
    assert_eq!(
        (map.lanes.len(), map.lane_connectors.len()),
        (known.lanes.len(), known.lane_connectors.len())
    );
    assert_eq!(
        (map.crossings.len(), map.drivable_area.len()),
        (known.crossings.len(), known.drivable_area.len())
    );
}

/// PandaSet converted by py123d, and the copy of the same drive in the layout of nuScenes: another global
/// frame, times of sweeps at their end, one box for an object that was labeled once per LiDAR, and boxes that
/// face as they move: those of py123d face backward.
#[test]
fn pandaset_is_the_same_but_for_its_frames() {
    let (Some(reader), Some(clouds)) =
        (open_recorded("pandaset-jpeg-laz", ""), open_recorded("pandaset-png-draco", ""))
    else {
        return;
    };
    let other = other(&nuscenes::FORMAT, "pandaset-002/nuscenes");
    let (ours, theirs) = (reader.recording(), other.recording());
    let moved = Pose::from_yaw(17.25f64.to_radians(), DVec3::new(600.0, 1600.0, 0.0));
    let same_time = |t_us: i64| theirs.frames.iter().find(|frame| frame.t_us == t_us + 100_000).unwrap();
    let places = ["FRONT", "BACK", "FRONT_LEFT", "FRONT_RIGHT", "BACK_LEFT", "BACK_RIGHT"];
    let cameras = ["PCAM_F0", "PCAM_B0", "PCAM_L0", "PCAM_R0", "PCAM_L1", "PCAM_R1"];
    let mut siblings = 0;
    for frame in &ours.frames {
        let known = same_time(frame.t_us);
        assert_eq!(frame.images.len(), 6);
        for image in &frame.images {
            let place = cameras.iter().position(|name| **name == *image.camera.name).unwrap();
            let is_same = |other: &&ImageRecord| other.camera.name == format!("CAM_{}", places[place]);
            let known = known.images.iter().find(is_same).unwrap();
            assert_eq!((image.t_us, image.camera.intrinsics), (known.t_us, known.camera.intrinsics));
            let [a, b] = [image, known].map(|image| image.global_from_ego * image.ego_from_camera);
            assert!(apart(&(moved * a), &b) < 1e-9, "{}", apart(&(moved * a), &b));
            if frame.t_us == ours.frames[3].t_us {
                assert!(reader.read_image(image).unwrap() == other.read_image(known).unwrap());
            }
        }
        // The copy gives an object that was labeled twice the size of one label and the place of the other.
        let (mut found, mut resized) = (0, 0);
        for item in &frame.boxes {
            let pose = moved * item.cuboid.pose * Pose::from_yaw(PI, DVec3::ZERO);
            let twin = known.boxes.iter().find(|other| apart(&other.cuboid.pose, &pose) < 1e-6);
            found += usize::from(twin.is_some());
            resized +=
                usize::from(twin.is_some_and(|twin| (twin.cuboid.size - item.cuboid.size).length() > 1e-9));
            if let Some(twin) = twin {
                let [a, b] = [&ours.tracks[item.track], &theirs.tracks[twin.track]];
                assert_eq!(a.class, b.class, "{} and {}", a.category, b.category);
            }
        }
        assert!(found == known.boxes.len() && resized <= 1, "{found} of {}, {resized}", known.boxes.len());
        siblings += frame.boxes.len() - found;
    }
    assert_eq!(siblings, ours.frames.len());
    let note = "tracks that move against the heading of their boxes";
    assert!(ours.notes.get(note).is_some_and(|tracks| *tracks > 10), "{:?}", ours.notes);
    assert!(!open_recorded("nuscenes-paths", "nuscenes").unwrap().recording().notes.contains_key(note));

    // All points of a sweep, in the same order: rounded to 16 bits by Draco, to 1 mm by the copy.
    let log = clouds.recording();
    let (sweep, known) = (&log.frames[0].sweeps[0], &same_time(log.frames[0].t_us).sweeps[0]);
    let points = |reader: &dyn LogReader, record: &SweepRecord, moved: Pose| -> Vec<DVec3> {
        let pose = moved * record.global_from_ego * record.ego_from_lidar;
        let global = |p: &SweepPoint| pose.transform_point(DVec3::from(p.position.map(f64::from)));
        reader.read_sweep(record).unwrap().points.iter().map(global).collect()
    };
    let (a, b) = (points(&*clouds, sweep, moved), points(&*other, known, Pose::IDENTITY));
    assert_eq!(a.len(), b.len());
    let off = a.iter().zip(&b).map(|(a, b)| (*a - *b).length()).fold(0.0, f64::max);
    assert!(off < 0.01, "{off}");
}
