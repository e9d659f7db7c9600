//! The nuScenes reader on real recordings.

use std::path::Path;

use glam::DVec3;
use point_skeleton::dataset::nuscenes::{NuScenes, read_sweep_file};
use point_skeleton::dataset::{LogLocator, LogReader, Recording, Sweep, TrackBox};
use point_skeleton::geometry::{Cuboid, Pose};

use pskel_testing::shared::shared;

fn open(path: &Path) -> NuScenes {
    let path = path.to_owned();
    NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, path)).unwrap()
}

/// Returns the number of a sweep's points in a box.
fn points_in(sweep: &Sweep, global_from_lidar: &Pose, cuboid: &Cuboid) -> u32 {
    let box_from_lidar = cuboid.pose.inverse() * *global_from_lidar;
    let inside = |p: &[f32; 3]| {
        cuboid.contains_local(box_from_lidar.transform_point(DVec3::from(p.map(f64::from))), 0.0)
    };
    sweep.points.iter().filter(|p| inside(&p.position)).count() as u32
}

fn file_points(log: &Recording) -> u64 {
    let sweeps = log.frames.iter().flat_map(|f| &f.sweeps);
    sweeps.map(|s| std::fs::metadata(&s.path).unwrap().len() / 20).sum()
}

#[test]
fn pandaset_recording_matches_its_readme() {
    let Some(shared) = shared("the PandaSet drive") else { return };
    let dataset = open(&shared.join("data/pandaset-002/nuscenes"));
    let log = dataset.recording();
    assert_eq!((log.name.as_str(), log.location.as_str()), ("scene-9002", "pandaset-002"));
    assert_eq!((log.frames.len(), log.tracks.len()), (38, 98));
    assert_eq!(log.frames.iter().map(|f| f.boxes.len()).sum::<usize>(), 3576);
    assert_eq!(file_points(log), 6_331_843);
    assert!(log.notes.is_empty(), "{:?}", log.notes);
    let ring = ["FRONT", "FRONT_RIGHT", "BACK_RIGHT", "BACK", "BACK_LEFT", "FRONT_LEFT"];
    assert_eq!(log.cameras, ring.map(|c| format!("CAM_{c}")));
    assert!(log.frames.iter().all(|f| f.images.len() == 6 && f.sweeps.len() == 1));

    let image = &log.frames[0].images[0];
    assert_eq!(image.t_us, 1_557_539_956_450_180);
    assert_eq!(image.camera.rows()[0], [1970.0131, 0.0, 970.0002]);
    assert_eq!(image.global_from_ego.translation.x, 599.987_511_179_566_5);
    assert!((image.global_from_ego.rotation.w - 0.857_158_855_809_310_7).abs() < 1e-12);
    let first = log.frames[0].boxes.iter().find(|b| log.tracks[b.track].id.starts_with("ae1d8f43f0f8712b"));
    assert_eq!(first.unwrap().cuboid.size, DVec3::new(2.679, 1.467, 2.846));
}

#[test]
fn pandaset_boxes_contain_the_stated_number_of_points() {
    let Some(shared) = shared("the PandaSet drive") else { return };
    let dataset = open(&shared.join("data/pandaset-002/nuscenes"));
    for index in [0, 20, 37] {
        let frame = &dataset.recording().frames[index];
        let record = &frame.sweeps[0];
        let sweep = dataset.read_sweep(record).unwrap();
        let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
        let count = |b: &TrackBox| Some(points_in(&sweep, &global_from_lidar, &b.cuboid));
        let found: Vec<Option<u32>> = frame.boxes.iter().map(count).collect();
        assert_eq!(found, dataset.box_points().unwrap()[index], "frame {index}");
        assert_eq!(dataset.read_image(&frame.images[3]).unwrap().dimensions(), (1920, 1080));
    }
}

#[test]
fn nuscenes_sweep_is_read() {
    let Some(shared) = shared("the nuScenes frame") else { return };
    let files = std::fs::read_dir(shared.join("data/nuscenes-frame")).unwrap();
    let mut paths = files.map(|f| f.unwrap().path());
    let sweep = read_sweep_file(&paths.find(|p| p.to_string_lossy().ends_with(".pcd.bin")).unwrap()).unwrap();
    assert_eq!((sweep.points.len(), sweep.dropped_non_finite), (34_688, 0));
    assert!(sweep.points.iter().all(|p| p.ring < 32 && (0.0..=255.0).contains(&p.intensity)));
}
