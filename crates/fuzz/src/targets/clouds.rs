//! Sweeps and point clouds.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use point_skeleton::cloud::{self, Point, cameras, npy, ply};
use point_skeleton::dataset::{SweepPoint, nuplan, nuscenes};
use point_skeleton::geometry::{Camera, View};
use serde_json::Value;

use super::{SMALL, Scratch, seed};
use crate::check::assert_names_file;
use crate::edits::json_file;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 5] = [
    Target { name: "sweep_bin", run: sweep_bin, seeds: sweep_bin_seeds, max_len: 4096, memory: SMALL },
    Target { name: "sweep_pcd", run: sweep_pcd, seeds: sweep_pcd_seeds, max_len: 4096, memory: SMALL },
    Target { name: "npy", run: read_npy, seeds: npy_seeds, max_len: 8192, memory: SMALL },
    Target { name: "ply", run: read_ply, seeds: ply_seeds, max_len: 8192, memory: SMALL },
    Target { name: "cameras", run: read_cameras, seeds: cameras_seeds, max_len: 8192, memory: SMALL },
];

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::new());
}

fn file(name: &str, data: &[u8]) -> PathBuf {
    SCRATCH.with_borrow_mut(|scratch| scratch.put(name, data))
}

fn sweep_bin(data: &[u8]) {
    let path = file("a.pcd.bin", data);
    match nuscenes::read_sweep_file(&path) {
        Err(error) => assert_names_file(error, &path, data),
        Ok(sweep) => {
            // Rows of four columns and PCD files are recognized too.
            let is_plain =
                sweep.points.len() + sweep.dropped_non_finite == data.len() / nuscenes::POINT_BYTES;
            assert!(
                sweep
                    .points
                    .iter()
                    .all(|p| p.position.iter().all(|v| v.is_finite()) && p.intensity.is_finite())
            );
            if is_plain && !sweep.points.is_empty() {
                let path = file("b.pcd.bin", &[]);
                nuscenes::write_sweep_file(&path, &sweep.points).expect("a sweep to write");
                match nuscenes::read_sweep_file(&path) {
                    Ok(again) => assert_eq!((again.points, again.devices), (sweep.points, sweep.devices)),
                    // Without the points that are not finite, too few rows may be left.
                    Err(_) => assert!(sweep.dropped_non_finite > 0, "a sweep that was written"),
                }
            }
        }
    }
}

fn sweep_bin_seeds() -> Vec<Seed> {
    let point = |i: u16| SweepPoint { position: [f32::from(i), -2.5, 0.25], intensity: 17.0, ring: i % 32 };
    let bytes =
        |points: Vec<SweepPoint>| written("a.pcd.bin", |path| nuscenes::write_sweep_file(path, &points));
    vec![seed("two", bytes((0..2).map(point).collect())), seed("forty", bytes((0..40).map(point).collect()))]
}

fn sweep_pcd(data: &[u8]) {
    let path = file("a.pcd", data);
    match (nuplan::check_pcd_file(&path), nuplan::read_pcd_file(&path)) {
        (Ok(count), Ok(sweep)) => {
            assert_eq!(count, (sweep.points.len() + sweep.dropped_non_finite) as u64);
            assert!(sweep.points.iter().all(|p| p.position.iter().all(|v| v.is_finite())));
        }
        (Err(check), Err(parse)) => {
            assert_eq!(check.to_string(), parse.to_string());
            assert_names_file(parse, &path, data);
        }
        // The check does not decode points, and their coordinates may not be finite or all be zero.
        (Ok(_), Err(parse)) if is_of_points(data, &parse.to_string()) => {
            assert_names_file(parse, &path, data)
        }
        (check, parse) => panic!("{check:?} but {parse:?}"),
    }
}

/// Returns whether an error of a PCD file is one of its points. Points of text and compressed points are not
/// decoded by the check at all.
fn is_of_points(data: &[u8], error: &str) -> bool {
    let lower = data.to_ascii_lowercase();
    let encoding = lower.split(|byte| *byte == b'\n').find_map(|line| {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        words.next().filter(|word| *word == b"data").and_then(|_| words.next())
    });
    encoding.is_some_and(|word| word != b"binary")
        || error.contains("points with finite coordinates")
        || error.contains("points around the LiDAR")
}

fn sweep_pcd_seeds() -> Vec<Seed> {
    let point = |x: f32, device: u8| [&x.to_le_bytes()[..], &[0; 8], &[100, device, 7]].concat();
    let merged = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity lidar_info ring\nSIZE 4 4 4 1 1 1\nTYPE F \
        F F U U U\n\
                  COUNT 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n";
    let other = "FIELDS pad z y x time\nSIZE 2 4 4 4 8\nTYPE U F F F F\nCOUNT 3 1 1 1 1\nWIDTH 1\nHEIGHT \
        1\nDATA binary\n";
    // Lengths of 31 and 30 bytes, then a run of 30 literals.
    let compressed = [&[31, 0, 0, 0, 30, 0, 0, 0, 29][..], &[1; 30]].concat();
    vec![
        seed("merged", [merged.as_bytes(), &point(1.5, 0), &point(-3.0, 4), &[0; 40]].concat()),
        seed("other", [other.as_bytes(), &[0; 26]].concat()),
        seed(
            "ascii",
            [merged.replace("DATA binary", "DATA ascii").as_bytes(), b"1 2 3 4 0 6\n1 2 nan 4 4 6\n"]
                .concat(),
        ),
        seed("compressed", [merged.replace("binary", "binary_compressed").as_bytes(), &compressed].concat()),
    ]
}

fn read_npy(data: &[u8]) {
    points(&file("a.npy", data), data, |path, points| npy::write(path, points, true));
}

fn npy_seeds() -> Vec<Seed> {
    let bytes = |class| written("a.npy", |path| npy::write(path, &some_points(), class));
    vec![seed("classes", bytes(true)), seed("colors", bytes(false))]
}

fn read_ply(data: &[u8]) {
    points(&file("a.ply", data), data, ply::write);
}

fn ply_seeds() -> Vec<Seed> {
    let text = "ply\nformat ascii 1.0\ncomment made\nelement face 1\nproperty list uchar int \
        corners\nelement vertex 2\n\
                property double x\nproperty double y\nproperty double z\nproperty uchar red\nend_header\n3 0 \
                1 2\n\
                500000.25 1 2 9\n500001.5 1e3 3 0\n";
    let binary = written("a.ply", |path| ply::write(path, &some_points()));
    let floats = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty \
        double z\n\
                  property float diffuse_red\nproperty float diffuse_green\nproperty float \
                  diffuse_blue\nend_header\n\
                  0 0 0 0.5 1 0\r\nnan -1.#IND inf nan 0 0\n691603.25 5335787.75 520.5 1 0.25 0\n";
    let packed = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty \
        float z\n\
                  property float rgb\nend_header\n1 2 3 2.3e-38\n";
    let text = [("text", text), ("floats", floats), ("packed", packed)];
    let text = text.map(|(name, text)| seed(name, text.as_bytes().to_vec()));
    [vec![seed("binary", binary)], text.to_vec()].concat()
}

/// Reads a cloud, writes it, and reads it again.
fn points<E: std::fmt::Debug>(path: &Path, data: &[u8], write: impl Fn(&Path, &[Point]) -> Result<(), E>) {
    let cloud = match cloud::read(path) {
        Err(error) => return assert_names_file(error, path, data),
        Ok(cloud) => cloud,
    };
    let lost = cloud.points.iter().filter(|p| p.position.iter().any(|v| v.is_nan())).count();
    assert_eq!(lost, cloud.non_finite);
    assert!(cloud.origin.is_finite() && !cloud.points.is_empty() && cloud.points.len() <= data.len());
    write(path, &cloud.points).expect("points to write");
    let again = cloud::read(path).expect("points that were written");
    let bits = |points: &[Point]| -> Vec<_> {
        points
            .iter()
            .map(|p| (p.position.map(|v| if v.is_nan() { 0 } else { v.to_bits() }), p.rgb_class))
            .collect()
    };
    assert_eq!(bits(&again.points), bits(&cloud.points));
}

fn some_points() -> Vec<Point> {
    (0..20_u8).map(|i| Point::new([f32::from(i), -0.25, 7.0], [i, 3, 255 - i], i % 5)).collect()
}

fn read_cameras(data: &[u8]) {
    let path = file("c.json", &json_file(data, &cameras_json()));
    match cameras::read(&path) {
        // All these errors end with the file's name.
        Err(error) => assert_names_file(error, &path, data),
        Ok(views) => {
            assert!(!views.is_empty());
            cameras::write(&path, &views).expect("cameras to write");
            assert_eq!(cameras::read(&path).expect("cameras that were written"), views);
        }
    }
}

fn cameras_json() -> Value {
    serde_json::from_slice(&cameras_file()).expect("JSON")
}

fn cameras_file() -> Vec<u8> {
    let rows = [[1000.0, 0.0, 800.0], [0.0, 1100.0, 450.0], [0.0, 0.0, 1.0]];
    let pose = DAffine3::from_rotation_y(0.7) * DAffine3::from_translation(DVec3::new(4e6, -2.0, 3.5));
    let view = |name| View {
        camera: Camera::new(name, 1600, 900, rows).expect("a camera"),
        camera_from_world: pose,
    };
    written("c.json", |path| cameras::write(path, &[view("left"), view("right")]))
}

fn cameras_seeds() -> Vec<Seed> {
    vec![seed("file", cameras_file()), seed("edit", vec![0, 0, 1, 3, 0, 0, 0, 0, 1, 7])]
}

/// Returns the bytes of a file that `write` writes.
pub(super) fn written<E: std::fmt::Debug>(name: &str, write: impl FnOnce(&Path) -> Result<(), E>) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    write(&path).expect("a file to write");
    std::fs::read(&path).expect("a file that was written")
}
