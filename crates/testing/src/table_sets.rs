//! The log of `six_cameras` in the layouts of other data sets with nuScenes' tables: MAN TruckScenes, TIER
//! IV's T4, and Lyft Level 5.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use point_skeleton::geometry::Pose;
use serde_json::{Value, json};

use crate::six_cameras::{VERSION, ego_at, files, points};

/// LiDARs of TruckScenes, how long after a frame they measure, microseconds, where they are, and their yaw in
/// degrees.
pub const TRUCK_LIDARS: [(&str, i64, [f64; 3], f64); 6] = [
    ("LIDAR_LEFT", -30_000, [1.0, 1.3, 0.8], 90.0),
    ("LIDAR_RIGHT", 20_000, [1.0, -1.3, 0.8], -90.0),
    ("LIDAR_TOP_FRONT", 10_000, [1.8, 0.0, 3.1], 0.0),
    ("LIDAR_TOP_LEFT", -15_000, [0.9, 1.0, 3.0], 45.0),
    ("LIDAR_TOP_RIGHT", 40_000, [0.9, -1.0, 3.0], -45.0),
    ("LIDAR_REAR", -50_000, [-4.0, 0.0, 1.1], 180.0),
];

/// LiDARs of Lyft Level 5, as in [`TRUCK_LIDARS`].
pub const LYFT_LIDARS: [(&str, i64, [f64; 3], f64); 3] = [
    ("LIDAR_TOP", 0, [1.2, 0.0, 1.9], 0.0),
    ("LIDAR_FRONT_LEFT", 4_000, [3.0, 0.9, 0.7], 60.0),
    ("LIDAR_FRONT_RIGHT", -6_000, [3.0, -0.9, 0.7], -60.0),
];

/// Cameras of TruckScenes, and those of the log in their place.
const TRUCK_CAMERAS: [(&str, &str); 4] = [
    ("CAM_FRONT_LEFT", "CAMERA_LEFT_FRONT"),
    ("CAM_FRONT_RIGHT", "CAMERA_RIGHT_FRONT"),
    ("CAM_BACK_RIGHT", "CAMERA_RIGHT_BACK"),
    ("CAM_BACK_LEFT", "CAMERA_LEFT_BACK"),
];

/// Columns of T4's sweeps here, of which a file says the number.
pub const T4_COLUMNS: usize = 7;

type Row = Vec<Value>;

/// Tables and files of a data set.
struct DataSet {
    root: PathBuf,
    tables: BTreeMap<String, Row>,
}

impl DataSet {
    /// Returns the tables of the log, without files.
    fn new(root: &Path) -> Self {
        let name = |path: &str| {
            Some(path.strip_prefix(VERSION)?.trim_matches('/').strip_suffix(".json")?.to_owned())
        };
        let table =
            |(path, bytes): (&String, &Vec<u8>)| Some((name(path)?, serde_json::from_slice(bytes).unwrap()));
        Self { root: root.to_owned(), tables: files().iter().filter_map(table).collect() }
    }

    fn rows(&mut self, table: &str) -> &mut Row {
        self.tables.entry(table.to_owned()).or_default()
    }

    fn file(&self, name: &str, bytes: &[u8]) {
        let path = self.root.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    /// Returns the channel of a record of sensor data.
    fn channel(&mut self, data: &Value) -> String {
        let find =
            |rows: &Row, token: &Value| rows.iter().find(|row| row["token"] == *token).unwrap().clone();
        let calibrated = find(self.rows("calibrated_sensor"), &data["calibrated_sensor_token"]);
        find(self.rows("sensor"), &calibrated["sensor_token"])["channel"].as_str().unwrap().to_owned()
    }

    /// Replaces the records of sensor data: `change` gets each with its channel and file, and returns those
    /// that take its place.
    fn replace(&mut self, mut change: impl FnMut(&mut Self, Value, &str, &[u8]) -> Row) {
        let old = std::mem::take(self.rows("sample_data"));
        let new = old.into_iter().flat_map(|data| {
            let channel = self.channel(&data);
            let bytes = &files()[data["filename"].as_str().unwrap()];
            change(self, data, &channel, bytes)
        });
        let new: Row = new.collect();
        *self.rows("sample_data") = new;
    }

    /// Returns the record of a sensor's data in place of another record, at a time after it.
    fn data(&mut self, like: &Value, channel: &str, after_us: i64, filename: &str) -> Value {
        let t_us = like["timestamp"].as_i64().unwrap() + after_us;
        let token = format!("{channel}{t_us}");
        let Pose { translation, .. } = ego_at(t_us);
        self.rows("ego_pose").push(json!({"token": token, "timestamp": t_us, "rotation": [1, 0, 0, 0],
            "translation": translation.to_array()}));
        let mut data = like.clone();
        for (field, value) in [
            ("token", json!(token)),
            ("ego_pose_token", json!(token)),
            ("calibrated_sensor_token", json!(channel)),
            ("timestamp", json!(t_us)),
            ("filename", json!(filename)),
        ] {
            data[field] = value;
        }
        data
    }

    /// Adds a sensor with its calibration.
    fn sensor(&mut self, channel: &str, modality: &str, pose: Pose) {
        self.rows("sensor").push(json!({"token": channel, "channel": channel, "modality": modality}));
        self.rows("calibrated_sensor").push(json!({"token": channel, "sensor_token": channel,
            "translation": pose.translation.to_array(), "rotation": pose.wxyz(), "camera_intrinsic": []}));
    }

    /// Renames channels, and the categories of the log as single words.
    fn rename(&mut self, table: &str, field: &str, names: &[(&str, &str)]) {
        for row in self.rows(table) {
            let new = names.iter().find(|(old, _)| row[field] == *old);
            row[field] = new.map_or_else(|| row[field].clone(), |(_, new)| json!(new));
        }
    }

    /// Writes the tables to a folder.
    fn write(&self, folder: &str) {
        for (name, rows) in &self.tables {
            self.file(&format!("{folder}/{name}.json"), &serde_json::to_vec(rows).unwrap());
        }
    }
}

/// Returns the place of a LiDAR on the ego.
pub fn lidar_pose(translation: [f64; 3], yaw_deg: f64) -> Pose {
    Pose { rotation: DQuat::from_rotation_z(yaw_deg.to_radians()), translation: DVec3::from(translation) }
}

/// Returns what a LiDAR measures at a time, in its frame.
pub fn measured(t_us: i64, ego_from_lidar: Pose) -> Vec<[f32; 3]> {
    let lidar_from_global = (ego_at(t_us) * ego_from_lidar).inverse();
    points(t_us)
        .into_iter()
        .map(|point| lidar_from_global.transform_point(point).as_vec3().to_array())
        .collect()
}

/// Returns points as a PCD file with intensities and times, in the encoding `DATA`.
fn pcd(points: &[[f32; 3]], t_us: i64, encoding: &str) -> Vec<u8> {
    let count = points.len();
    let mut file = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity timestamp\n\
         SIZE 4 4 4 4 8\nTYPE F F F F U\nCOUNT 1 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {count}\nDATA {encoding}\n"
    )
    .into_bytes();
    let time = t_us.cast_unsigned().to_le_bytes();
    let row = |p: &[f32; 3]| [p.map(f32::to_le_bytes).as_flattened(), &9_f32.to_le_bytes(), &time].concat();
    match encoding {
        "ascii" => {
            let line = |p: &[f32; 3]| format!("{} {} {} 9 {t_us}\n", p[0], p[1], p[2]).into_bytes();
            file.extend(points.iter().flat_map(line));
        }
        "binary" => file.extend(points.iter().flat_map(row)),
        _ => {
            let rows: Vec<Vec<u8>> = points.iter().map(row).collect();
            let column =
                |from: usize, bytes: usize| rows.iter().flat_map(move |row| row[from..from + bytes].to_vec());
            let plain: Vec<u8> =
                [0, 4, 8, 12].into_iter().flat_map(|from| column(from, 4)).chain(column(16, 8)).collect();
            // LZF without references: up to 32 bytes follow their number, less one.
            let packed: Vec<u8> =
                plain.chunks(32).flat_map(|part| [&[part.len() as u8 - 1], part].concat()).collect();
            [packed.len(), plain.len()].iter().for_each(|length| file.extend((*length as u32).to_le_bytes()));
            file.extend(packed);
        }
    }
    file
}

/// Writes MAN TruckScenes: six LiDARs of PCD files, four cameras, radars, no logs and no maps.
pub fn write_truckscenes(root: &Path) {
    let mut set = DataSet::new(root);
    for (channel, _, translation, yaw_deg) in TRUCK_LIDARS {
        set.sensor(channel, "lidar", lidar_pose(translation, yaw_deg));
    }
    set.sensor("RADAR_LEFT_FRONT", "radar", Pose::IDENTITY);
    set.rename("sensor", "channel", &TRUCK_CAMERAS);
    set.replace(|set, data, channel, bytes| match channel {
        "LIDAR_TOP" => {
            let place = if data["is_key_frame"] == true { "samples" } else { "sweeps" };
            let mut new = Vec::new();
            for (number, (channel, after_us, translation, yaw_deg)) in TRUCK_LIDARS.into_iter().enumerate() {
                let t_us = data["timestamp"].as_i64().unwrap() + after_us;
                let name = format!("{place}/{channel}/{channel}_{t_us}.pcd");
                let encoding = ["ascii", "binary", "binary_compressed"][number % 3];
                let points = measured(t_us, lidar_pose(translation, yaw_deg));
                set.file(&name, &pcd(&points, t_us, encoding));
                new.push(set.data(&data, channel, after_us, &name));
            }
            new.push(set.data(&data, "RADAR_LEFT_FRONT", 1_000, "samples/RADAR_LEFT_FRONT/0.pcd"));
            new
        }
        name if name.starts_with("CAMERA_") => {
            set.file(data["filename"].as_str().unwrap(), bytes);
            vec![data]
        }
        _ => Vec::new(),
    });
    set.rows("scene")[0]["log_token"] = json!("");
    for table in ["log", "map"] {
        set.tables.remove(table);
    }
    for table in ["ego_motion_cabin", "ego_motion_chassis", "weather_annotation"] {
        set.rows(table).push(json!({"token": "t", "timestamp": 0, "vx": 5.0}));
    }
    set.write("v1.0-mini");
}

/// Writes a scene of T4 to a folder: merged LiDARs in the frame of the ego, with a file that says the number
/// of columns and the time of each LiDAR, and a Lanelet2 map. The name of its scene is that of the folder.
pub fn write_t4(root: &Path) {
    let mut set = DataSet::new(root);
    set.sensor("LIDAR_CONCAT", "lidar", Pose::IDENTITY);
    set.replace(|set, mut data, channel, bytes| {
        let t_us = data["timestamp"].as_i64().unwrap();
        if data["is_key_frame"] == false {
            data["sample_token"] = json!("");
        }
        if channel != "LIDAR_TOP" {
            let name = format!("data/{channel}/{t_us}.jpg");
            set.file(&name, bytes);
            data["filename"] = json!(name);
            return vec![data];
        }
        let name = format!("data/LIDAR_CONCAT/{t_us}.pcd.bin");
        let points = measured(t_us, Pose::IDENTITY);
        let row = |p: &[f32; 3]| [p[0], p[1], p[2], 9.0, -1.0, 0.25, 1.5].map(f32::to_le_bytes);
        let rows: Vec<[[u8; 4]; T4_COLUMNS]> = points.iter().map(row).collect();
        set.file(&name, rows.as_flattened().as_flattened());
        // The first LiDAR measured at the time of the sweep, the second one 40 ms later.
        let stamp = |t_us: i64| json!({"sec": t_us / 1_000_000, "nanosec": t_us % 1_000_000 * 1000});
        let half = points.len() / 2;
        let source = |token: &str, first: usize, count: usize, t_us: i64| {
            json!({"sensor_token": token, "idx_begin": first, "length": count, "stamp": stamp(t_us)})
        };
        let info = json!({"stamp": stamp(t_us), "num_pts_feats": T4_COLUMNS, "sources": [
            source("top", 0, half, t_us), source("left", half, points.len() - half, t_us + 40_000)]});
        let info_name = format!("data/LIDAR_CONCAT_INFO/{t_us}.json");
        set.file(&info_name, info.to_string().as_bytes());
        let mut sweep = set.data(&data, "LIDAR_CONCAT", 0, &name);
        sweep["info_filename"] = json!(info_name);
        sweep["fileformat"] = json!("pcd.bin");
        vec![sweep]
    });
    let named =
        root.components().rev().find(|part| part.as_os_str().to_string_lossy().parse::<u32>().is_err());
    set.rows("scene")[0]["name"] = json!(format!("project_{}", named.unwrap().as_os_str().to_string_lossy()));
    set.rename("category", "name", &[("vehicle.car", "car"), ("movable_object.trafficcone", "traffic_cone")]);
    for row in set.rows("calibrated_sensor") {
        row["camera_distortion"] = json!([0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    for row in set.rows("instance") {
        row["instance_name"] = json!("project::1");
    }
    let date = set.rows("log")[0].as_object_mut().unwrap().remove("date_captured");
    set.rows("log")[0]["data_captured"] = date.into();
    set.rows("object_ann");
    set.rows("vehicle_state").push(json!({"token": "v", "timestamp": 0}));
    set.file("map/lanelet2_map.osm", b"<osm/>");
    set.file("status.json", b"{}");
    set.write("annotation");
}

/// Writes Lyft Level 5 as Kaggle distributes it: tables in `train_data` name files in `images` and `lidar`,
/// which are in `train_images` and `train_lidar`. Three LiDARs, seven cameras, times as floats, points of
/// boxes not counted, map as an image.
pub fn write_lyft(root: &Path) {
    let mut set = DataSet::new(root);
    for (channel, _, translation, yaw_deg) in LYFT_LIDARS {
        if channel != "LIDAR_TOP" {
            set.sensor(channel, "lidar", lidar_pose(translation, yaw_deg));
        }
    }
    set.sensor("CAM_FRONT_ZOOMED", "camera", Pose::IDENTITY);
    let (_, _, translation, yaw_deg) = LYFT_LIDARS[0];
    set.rename("sensor", "channel", &[("LIDAR_TOP", "LIDAR_OLD")]);
    set.sensor("LIDAR_TOP", "lidar", lidar_pose(translation, yaw_deg));
    let zoomed =
        set.rows("calibrated_sensor").iter().position(|row| row["token"] == "CAM_FRONT_ZOOMED").unwrap();
    set.replace(|set, mut data, channel, bytes| {
        let t_us = data["timestamp"].as_i64().unwrap();
        if channel == "LIDAR_OLD" {
            if data["is_key_frame"] == false {
                return Vec::new();
            }
            let sweep =
                |(number, (channel, after_us, translation, yaw_deg)): (usize, (&str, i64, [f64; 3], f64))| {
                    let t_us = t_us + after_us;
                    let name = format!("lidar/host-a004_lidar{number}_{t_us}000.bin");
                    let row = |p: [f32; 3]| [p[0], p[1], p[2], 100.0, 1.0].map(f32::to_le_bytes);
                    let rows: Vec<[[u8; 4]; 5]> =
                        measured(t_us, lidar_pose(translation, yaw_deg)).into_iter().map(row).collect();
                    set.file(&format!("train_{name}"), rows.as_flattened().as_flattened());
                    set.data(&data, channel, after_us, &name)
                };
            return LYFT_LIDARS.into_iter().enumerate().map(sweep).collect();
        }
        let name = format!("images/host-a004_{channel}_{t_us}000.jpeg");
        set.file(&format!("train_{name}"), bytes);
        data["filename"] = json!(name);
        if channel != "CAM_FRONT" {
            return vec![data];
        }
        let token = data["calibrated_sensor_token"].clone();
        let rows = set.rows("calibrated_sensor");
        let front = rows.iter().find(|row| row["token"] == token).unwrap().clone();
        rows[zoomed] = json!({"token": "CAM_FRONT_ZOOMED", "sensor_token": "CAM_FRONT_ZOOMED",
            "translation": front["translation"], "rotation": front["rotation"],
            "camera_intrinsic": front["camera_intrinsic"]});
        let second = set.data(&data, "CAM_FRONT_ZOOMED", 0, &name);
        vec![data, second]
    });
    let float = |value: &mut Value, fraction: f64| *value = json!(value.as_f64().unwrap() + fraction);
    set.rows("sample").iter_mut().for_each(|row| float(&mut row["timestamp"], 0.25));
    set.rows("sample_data").iter_mut().for_each(|row| float(&mut row["timestamp"], 0.0));
    set.rows("sample_annotation").iter_mut().for_each(|row| row["num_lidar_pts"] = json!(-1));
    set.rename("category", "name", &[("vehicle.car", "car"), ("movable_object.trafficcone", "animal")]);
    set.rows("log")[0]["location"] = json!("Palo Alto");
    set.rows("map")[0]["filename"] = json!("maps/map_raster_palo_alto.png");
    set.file("train_maps/map_raster_palo_alto.png", b"raster");
    for table in ["visibility", "attribute"] {
        set.tables.remove(table);
    }
    set.write("train_data");
}
