//! A synthetic log in nuScenes layout.
//!
//! Three frames half a second apart. The ego drives 1 m per frame along x; a car ahead of it drives 2 m per
//! frame (its back is 10, 11, 12 m away); a cone and a wall are static. One camera looks forward, one back,
//! both with 90 degrees.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use point_skeleton::dataset::SweepPoint;
use point_skeleton::dataset::nuscenes::write_sweep_file;
use serde_json::{Value, json};

pub const WIDTH: u32 = 96;
pub const HEIGHT: u32 = 64;
pub const FRAMES: usize = 3;
/// Start position of the ego, global meters.
pub const START: DVec3 = DVec3::new(664_000.0, 3_997_000.0, 0.0);
pub const FIRST_US: i64 = 1_000_000_000;
pub const STEP_US: i64 = 500_000;
pub const CAMERAS: [&str; 2] = ["CAM_FRONT", "CAM_BACK"];
pub const INTRINSICS: [[f64; 3]; 3] = [[48.0, 0.0, 48.0], [0.0, 48.0, 32.0], [0.0, 0.0, 1.0]];
const LIDAR_Z: f64 = 1.8;
pub const CAMERA_Z: f64 = 1.5;

/// Folder with the log in `log`, and an output folder `out`.
pub struct TinyLog {
    folder: tempfile::TempDir,
}

impl Default for TinyLog {
    fn default() -> Self {
        Self::new()
    }
}

impl TinyLog {
    pub fn new() -> Self {
        let log = Self { folder: tempfile::tempdir().unwrap() };
        for folder in ["out", "log/samples", "log/v1.0-mini"] {
            std::fs::create_dir_all(log.path(folder)).unwrap();
        }
        for frame in 0..FRAMES {
            write_sweep_file(&log.path(&sweep(frame)), &sweep_points(frame)).unwrap();
            for (camera, name) in CAMERAS.iter().enumerate() {
                let image = image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
                    image::Rgb([2 * x as u8, 3 * y as u8, 60 + 90 * camera as u8])
                });
                image.save(log.path(&picture(frame, name))).unwrap();
            }
        }
        for (table, records) in tables() {
            log.write_table(table, &records);
        }
        log
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write_table(&self, table: &str, records: &Value) {
        std::fs::write(self.path(&format!("log/v1.0-mini/{table}.json")), records.to_string()).unwrap();
    }

    /// Replaces one value of a table, found by its JSON pointer.
    pub fn change(&self, table: &str, pointer: &str, value: Value) {
        let text = std::fs::read(self.path(&format!("log/v1.0-mini/{table}.json"))).unwrap();
        let mut records: Value = serde_json::from_slice(&text).unwrap();
        *records.pointer_mut(pointer).unwrap() = value;
        self.write_table(table, &records);
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).unwrap()).unwrap()
    }
}

/// Writes files below a folder, as [`tree`] names them.
pub fn write_tree<'a>(folder: &Path, files: impl IntoIterator<Item = (&'a String, &'a Vec<u8>)>) {
    for (name, bytes) in files {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

/// Returns all files below a folder with their bytes.
pub fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let (path, name) = entry.map(|e| (e.path(), e.file_name().into_string().unwrap())).unwrap();
        if name == ".pskel-files" {
            continue;
        }
        if path.is_dir() {
            files.extend(tree(&path).into_iter().map(|(file, bytes)| (format!("{name}/{file}"), bytes)));
        } else {
            files.insert(name, std::fs::read(&path).unwrap());
        }
    }
    files
}

pub fn sweep(frame: usize) -> String {
    format!("log/samples/{frame}.pcd.bin")
}

pub fn picture(frame: usize, camera: &str) -> String {
    format!("log/samples/{frame}-{camera}.png")
}

/// Returns the rotation of a camera on the ego that looks along `yaw`.
pub fn camera_rotation(yaw: f64) -> DQuat {
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    DQuat::from_rotation_z(yaw) * DQuat::from_mat3(&axes)
}

fn ego_at(frame: usize) -> DVec3 {
    START + DVec3::X * frame as f64
}

fn car_at(frame: usize) -> DVec3 {
    START + DVec3::new(12.0 + 2.0 * frame as f64, 0.0, 0.75)
}

fn cone_at() -> DVec3 {
    START + DVec3::new(8.0, 4.0, 0.5)
}

/// Returns the points of a plane, meters, in rows from a corner along two sides.
fn plane(corner: DVec3, sides: [DVec3; 2], step_m: f64) -> impl Iterator<Item = DVec3> {
    let count = |side: DVec3| (side.length() / step_m).round() as usize;
    let [m, n] = sides.map(count);
    (0..=m).flat_map(move |i| {
        (0..=n).map(move |j| corner + sides[0] * (i as f64 / m as f64) + sides[1] * (j as f64 / n as f64))
    })
}

fn sweep_points(frame: usize) -> Vec<SweepPoint> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let ego = ego_at(frame);
    let mut points: Vec<DVec3> =
        plane(ego + DVec3::new(-20.0, -8.0, 0.0), [x * 50.0, y * 16.0], 0.4).collect();
    points.extend(plane(START + DVec3::new(40.0, -8.0, 0.0), [y * 16.0, z * 4.0], 0.4));
    let back = car_at(frame) + DVec3::new(-2.0, -1.0, -0.45);
    points.extend(plane(back, [y * 2.0, z * 1.2], 0.1));
    points.extend(plane(back + z * 1.2, [x * 4.0, y * 2.0], 0.1));
    points.extend(plane(cone_at() + DVec3::new(-0.2, -0.2, -0.2), [y * 0.4, z * 0.6], 0.1));
    let local = |p: DVec3| (p - ego - z * LIDAR_Z).as_vec3().to_array();
    points.into_iter().map(|p| SweepPoint { position: local(p), intensity: 9.0, ring: 0 }).collect()
}

fn rotation(q: DQuat) -> Value {
    json!([q.w, q.x, q.y, q.z])
}

fn tables() -> Vec<(&'static str, Value)> {
    let time = |frame: usize| FIRST_US + STEP_US * frame as i64;
    let name = |frame: usize| if frame < FRAMES { format!("s{frame}") } else { String::new() };
    let frames = || 0..FRAMES;
    let sensors = ["LIDAR_TOP", CAMERAS[0], CAMERAS[1]];
    let modality = |sensor: &str| if sensor == "LIDAR_TOP" { "lidar" } else { "camera" };
    let data = |frame: usize, sensor: &&str| {
        let camera = *sensor != "LIDAR_TOP";
        let file = if camera { picture(frame, sensor) } else { sweep(frame) };
        json!({"token": format!("d{frame}{sensor}"), "sample_token": name(frame), "timestamp": time(frame),
            "ego_pose_token": format!("e{frame}"), "calibrated_sensor_token": format!("c{sensor}"),
            "is_key_frame": true, "height": if camera { HEIGHT } else { 0 },
            "width": if camera { WIDTH } else { 0 }, "filename": file.trim_start_matches("log/")})
    };
    let calibrated = |sensor: &&str| match *sensor {
        "LIDAR_TOP" => json!({"token": "cLIDAR_TOP", "sensor_token": "LIDAR_TOP", "rotation": [1, 0, 0, 0],
            "translation": [0, 0, LIDAR_Z], "camera_intrinsic": []}),
        name => {
            let yaw = if name == CAMERAS[0] { 0.0 } else { std::f64::consts::PI };
            json!({"token": format!("c{name}"), "sensor_token": name,
            "rotation": rotation(camera_rotation(yaw)),
                "translation": [0, 0, CAMERA_Z], "camera_intrinsic": INTRINSICS})
        }
    };
    let annotation = |frame: usize, track: &str, at: DVec3, size: [f64; 3]| {
        json!({"token": format!("a{frame}{track}"), "sample_token": name(frame), "instance_token": track,
            "translation": at.to_array(), "size": size, "rotation": [1, 0, 0, 0], "num_lidar_pts": 1})
    };
    let boxes = frames().flat_map(|frame| {
        let car = annotation(frame, "car", car_at(frame), [2.0, 4.0, 1.5]);
        [car, annotation(frame, "cone", cone_at(), [0.5, 0.5, 1.0])]
    });
    let one = |value: Value| json!([value]);
    let all = |values: Vec<Value>| Value::from(values);
    vec![
        (
            "scene",
            one(json!({"token": "sc", "name": "tiny", "description": "made up", "log_token": "l",
            "first_sample_token": "s0"})),
        ),
        (
            "sample",
            all(frames()
                .map(|f| {
                    json!({"token": name(f), "timestamp": time(f), "next": name(f + 1),
            "scene_token": "sc"})
                })
                .collect()),
        ),
        ("sample_data", all(frames().flat_map(|f| sensors.iter().map(move |s| data(f, s))).collect())),
        (
            "ego_pose",
            all(frames()
                .map(|f| {
                    json!({"token": format!("e{f}"), "rotation": [1, 0, 0, 0],
            "translation": ego_at(f).to_array()})
                })
                .collect()),
        ),
        ("calibrated_sensor", all(sensors.iter().map(calibrated).collect())),
        (
            "sensor",
            all(sensors.iter().map(|s| json!({"token": s, "channel": s, "modality": modality(s)})).collect()),
        ),
        (
            "instance",
            json!([{"token": "car", "category_token": "k1"}, {"token": "cone", "category_token": "k2"}]),
        ),
        ("sample_annotation", all(boxes.collect())),
        (
            "category",
            json!([{"token": "k1", "name": "vehicle.car"},
            {"token": "k2", "name": "movable_object.trafficcone"}]),
        ),
        ("attribute", json!([])),
        ("visibility", json!([])),
        ("log", one(json!({"token": "l", "location": "nowhere"}))),
        ("map", json!([])),
    ]
}
