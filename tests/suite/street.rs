//! The built-in street, written as a nuScenes data set and read again.

use glam::DVec3;
use point_skeleton::dataset::nuscenes::{NuScenes, write_log};
use point_skeleton::dataset::{Class, Dataset, Log, LogFormat, LogLocator, SweepRecord};
use point_skeleton::geometry::Pose;
use point_skeleton::skeleton::BuildOptions;
use point_skeleton::town::{Street, StreetOptions};

use crate::common::{WithLog, skeleton_of};
use crate::tiny_log::tree;

const OPTIONS: StreetOptions = StreetOptions { seed: 3, frames: 2, size: [45, 80] };

fn close(a: &Pose, b: &Pose) -> bool {
    a.rotation.angle_between(b.rotation) < 1e-7 && (a.translation - b.translation).length() < 1e-9
}

#[test]
fn a_written_log_is_read_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let street = Street::new(&OPTIONS).unwrap();
    write_log(folder.path(), "v1.0-street", &street).unwrap();
    let path = folder.path().to_owned();
    let format = LogFormat::NuScenes;
    let dataset = NuScenes::open(&LogLocator::new(format, path)).unwrap();
    let (wrote, read) = (street.log(), dataset.log());
    assert_eq!((&wrote.name, &wrote.location), (&read.name, &read.location));
    assert_eq!((&wrote.cameras, &wrote.tracks), (&read.cameras, &read.tracks));
    assert_eq!((read.frames.len(), read.notes.len()), (2, 0));
    for (a, b) in wrote.frames.iter().zip(&read.frames) {
        assert!(a.t_us == b.t_us && close(&a.global_from_ego, &b.global_from_ego));
        assert_eq!(a.boxes.len(), b.boxes.len());
        for (x, y) in a.boxes.iter().zip(&b.boxes) {
            assert!(x.track == y.track && x.cuboid.size == y.cuboid.size);
            assert!(close(&x.cuboid.pose, &y.cuboid.pose));
        }
        assert_eq!((a.images.len(), a.sweeps.len()), (b.images.len(), b.sweeps.len()));
        for (x, y) in a.images.iter().zip(&b.images) {
            assert_eq!((x.channel, x.t_us, &x.camera), (y.channel, y.t_us, &y.camera));
            assert!(
                close(&x.ego_from_camera, &y.ego_from_camera)
                    && close(&x.global_from_ego, &y.global_from_ego)
            );
        }
        assert_eq!(street.read_sweep(&a.sweeps[0]).unwrap(), dataset.read_sweep(&b.sweeps[0]).unwrap());
    }
    let image = |dataset: &dyn Dataset| dataset.read_image(&dataset.log().frames[1].images[0]).unwrap();
    let (truth, jpeg) = (image(&street), image(&dataset));
    let error: u64 = truth.iter().zip(jpeg.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    assert!(
        error < 4 * truth.len() as u64,
        "JPEG changes a channel by {} levels on average",
        error / truth.len() as u64
    );
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let write = |seed: u64| {
        let folder = tempfile::tempdir().unwrap();
        write_log(folder.path(), "v1.0-street", &Street::new(&StreetOptions { seed, ..OPTIONS }).unwrap())
            .unwrap();
        tree(folder.path())
    };
    let first = write(3);
    assert!(first == write(3) && first != write(4));
}

/// Points of a sweep lie in the boxes of what they hit, and every box near the ego holds some.
#[test]
fn boxes_hold_their_actors() {
    let street = Street::new(&OPTIONS).unwrap();
    let frame = &street.log().frames[0];
    let record = &frame.sweeps[0];
    let sweep = street.read_sweep(record).unwrap();
    let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
    let mut near = 0;
    for item in &frame.boxes {
        let box_from_lidar = item.cuboid.pose.inverse() * global_from_lidar;
        let locals = || {
            sweep
                .points
                .iter()
                .map(|p| box_from_lidar.transform_point(DVec3::from(p.position.map(f64::from))))
        };
        let inside =
            |margin: f64| locals().filter(|p| item.cuboid.contains_local(*p, margin) && p.z > 0.1).count();
        // A few centimetres of noise, no more: nothing of the actor sticks out of its box.
        assert_eq!(inside(0.02), inside(0.15), "{}", street.log().tracks[item.track].category);
        if item.cuboid.pose.translation.distance(frame.global_from_ego.translation) < 20.0 {
            near += usize::from(inside(0.02) > 0);
        }
    }
    assert!(near >= 5, "{near} actors near the ego are seen");
}

#[test]
fn sweeps_between_frames_are_split_by_boxes_in_between() {
    // The middle one of three frames becomes a sweep between the others.
    let street = Street::new(&StreetOptions { frames: 3, ..OPTIONS }).unwrap();
    let mut log = street.log().clone();
    let middle = log.frames.remove(1);
    let between = middle.sweeps.into_iter().map(|sweep| SweepRecord { is_key: false, ..sweep });
    log.frames[1].sweeps.extend(between);
    let log = WithLog { drive: &street, log };
    let folder = tempfile::tempdir().unwrap();
    let build = |between_sweeps: bool| {
        let options = BuildOptions { between_sweeps, ..BuildOptions::default() };
        skeleton_of(&folder.path().join("s"), &log, &[0, 1], &options).manifest
    };
    let (without, with) = (build(false), build(true));
    assert_eq!([without.report.sweeps, with.report.sweeps], [2, 3]);
    // The car in front moves 1.1 m a frame; its points still lie where its box is.
    let moving = with.actors.iter().find(|a| a.track == log.log.tracks[moving_car(&log.log)].id).unwrap();
    assert_eq!(moving.sweeps, 3);
    for axis in 0..3 {
        let half = moving.size[axis] as f32 / 2.0 + 0.02;
        assert!(moving.bounds.min[axis] >= -half && moving.bounds.max[axis] <= half, "{:?}", moving.bounds);
    }
}

/// The car that moves and is nearest to the ego.
fn moving_car(log: &Log) -> usize {
    let moved = |track: &usize| {
        let boxes = log.track_boxes(*track);
        boxes[0].1.pose.translation.distance(boxes[1].1.pose.translation) > 1.0
    };
    let away = |track: &usize| {
        let cuboid = log.frames[0].cuboid_of(*track).unwrap();
        cuboid.pose.translation.distance(log.frames[0].global_from_ego.translation)
    };
    let cars = (0..log.tracks.len()).filter(|t| log.tracks[*t].class == Class::MotorVehicle).filter(moved);
    cars.min_by(|a, b| away(a).total_cmp(&away(b))).unwrap()
}
