//! A synthetic nuPlan log with a map, four frames at 20 Hz and eight cameras at 10 Hz, and functions that
//! break it.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use glam::DVec3;
use point_skeleton::dataset::nuplan::NuPlan;
use point_skeleton::dataset::{DatasetError, LogLocator, LogReader, VectorMap};
use rusqlite::Connection;

use crate::tiny_log::camera_rotation;

pub const LOG: &str = "2021.01.01.00.00.00_veh-01_00000_00001";
pub const MAP: &str = "us-xx-nowhere";
/// Camera channels around the ring, clockwise from the front camera.
pub const RING: [&str; 8] = ["CAM_F0", "CAM_R0", "CAM_R1", "CAM_R2", "CAM_B0", "CAM_L2", "CAM_L1", "CAM_L0"];
pub const FRAMES: usize = 4;
pub const FIRST_US: i64 = 1_600_000_000_000_000;
pub const STEP_US: i64 = 50_000;
/// Delay of an image after its frame, microseconds.
pub const DELAY_US: i64 = 5_000;
/// Start position of the ego, global meters. It drives 1 m per frame along x, 0.1 m between a frame and its
/// images.
pub const START: DVec3 = DVec3::new(664_460.0, 3_997_715.0, 600.0);
pub const CAMERA_Z: f64 = 1.5;
pub const LIDAR_Z: f64 = 1.8;
/// Distortion of the right front camera.
pub const DISTORTION: [f64; 5] = [-0.3, 0.1, -0.002, 0.0005, -0.05];
const SIZE: [u32; 2] = [96, 64];

/// A data set in its own folder.
pub struct NuplanLog(tempfile::TempDir);

impl Default for NuplanLog {
    fn default() -> Self {
        Self::new()
    }
}

impl NuplanLog {
    pub fn new() -> Self {
        let made = Self(tempfile::tempdir().unwrap());
        for folder in ["nuplan-v1.1/splits/mini", &format!("maps/{MAP}/1.0")] {
            std::fs::create_dir_all(made.path(folder)).unwrap();
        }
        made.write_blobs();
        made.sql(&tables());
        let index = format!("{{\"{MAP}\": {{\"version\": \"1.0\", \"layers\": {{}}}}}}");
        std::fs::write(made.path("maps/nuplan-maps-v1.0.json"), index).unwrap();
        made.map_sql(&map_tables());
        made
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn database(&self) -> PathBuf {
        self.path(&format!("nuplan-v1.1/splits/mini/{LOG}.db"))
    }

    pub fn blob(&self, name: &str) -> PathBuf {
        self.path("nuplan-v1.1/sensor_blobs").join(name)
    }

    pub fn map(&self) -> PathBuf {
        self.path(&format!("maps/{MAP}/1.0/map.gpkg"))
    }

    /// Runs statements on the log.
    pub fn sql(&self, statements: &str) {
        Connection::open(self.database()).unwrap().execute_batch(statements).unwrap();
    }

    /// Runs statements on the map.
    pub fn map_sql(&self, statements: &str) {
        Connection::open(self.map()).unwrap().execute_batch(statements).unwrap();
    }

    /// Returns the map of a new log after these statements, with what reading it counts.
    pub fn map_and_notes(statements: &str) -> (VectorMap, Vec<(String, usize)>) {
        let made = Self::new();
        made.map_sql(statements);
        let map = made.open().unwrap().read_map().unwrap().unwrap();
        let notes = map.notes.clone().into_iter().collect();
        (map, notes)
    }

    pub fn locator(&self) -> LogLocator {
        LogLocator::new(&point_skeleton::dataset::nuplan::FORMAT, self.database())
    }

    pub fn open(&self) -> Result<NuPlan, DatasetError> {
        NuPlan::open(&self.locator())
    }

    /// Opens the log and checks that the error message contains all parts and ends with the log's file.
    #[track_caller]
    pub fn refuses(&self, parts: &[&str]) {
        let message = self.open().expect_err("a damaged log").to_string();
        assert_says(&message, parts, &format!("{LOG}.db"));
    }

    fn write_blobs(&self) {
        for frame in 0..FRAMES {
            write(&self.blob(&sweep_file(frame)), &pcd(&sweep_points(frame)));
        }
        for (camera, name) in RING.iter().enumerate() {
            for shot in 0..FRAMES / 2 {
                let path = self.blob(&image_file(name, shot));
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                let level = 20 + 30 * camera as u8;
                let image =
                    image::RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb([level, 128, 255 - level]));
                image.save(path).unwrap();
            }
        }
    }
}

#[track_caller]
pub fn assert_says(message: &str, parts: &[&str], ending: &str) {
    assert!(message.ends_with(ending), "{message:?} does not end with {ending:?}");
    for part in parts {
        assert!(message.contains(part), "{message:?} does not contain {part:?}");
    }
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

pub fn sweep_file(frame: usize) -> String {
    format!("{LOG}/MergedPointCloud/{frame}.pcd")
}

pub fn image_file(camera: &str, shot: usize) -> String {
    format!("{LOG}/{camera}/{shot}.jpg")
}

/// Returns a token as SQL: a letter for the table, then a number.
pub fn token(table: char, number: usize) -> String {
    format!("x'{:02x}{number:014x}'", table as u32)
}

/// Returns a pickled list of numbers, as SQL.
pub fn pickled(numbers: &[f64]) -> String {
    format!("x'8004{}2e'", list(numbers))
}

fn pickled_matrix(rows: &[[f64; 3]; 3]) -> String {
    let rows: String = rows.iter().map(|row| list(row)).collect();
    format!("x'80045d28{rows}652e'")
}

fn list(numbers: &[f64]) -> String {
    let number = |v: &f64| format!("47{:016x}", v.to_bits());
    format!("5d28{}65", numbers.iter().map(number).collect::<String>())
}

pub fn ego_at(frame: f64) -> DVec3 {
    START + DVec3::X * frame
}

/// Returns the car's center. Its back is 10 m ahead of the ego, and it drives as the ego does.
pub fn car_at(frame: usize) -> DVec3 {
    ego_at(frame as f64) + DVec3::new(12.0, 0.0, 0.75)
}

/// Returns position and device of the points: the ground around the ego, and the car's back as seen by two
/// devices.
fn sweep_points(frame: usize) -> Vec<(DVec3, u8)> {
    let mut points = Vec::new();
    for i in 0..80 {
        for j in 0..40 {
            points.push((
                ego_at(frame as f64) + DVec3::new(f64::from(i) * 0.5 - 20.0, f64::from(j) * 0.4 - 8.0, 0.0),
                0,
            ));
        }
    }
    for (device, to_left) in [(0, 0.0), (4, 0.3)] {
        for k in 0..10 {
            let back = DVec3::new(-2.0, to_left, f64::from(k) * 0.1 - 0.4);
            points.push((car_at(frame) + back, device));
        }
    }
    let lidar = ego_at(frame as f64) + DVec3::Z * LIDAR_Z;
    points.into_iter().map(|(p, device)| (p - lidar, device)).collect()
}

/// Returns a PCD file in nuPlan's padded layout.
fn pcd(points: &[(DVec3, u8)]) -> Vec<u8> {
    let n = points.len();
    let header = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity lidar_info \
            ring\nSIZE 4 4 4 1 1 1\n\
         TYPE F F F U U U\nCOUNT 1 1 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA \
         binary\n"
    );
    let mut bytes = header.into_bytes();
    for (position, device) in points {
        bytes.extend(position.as_vec3().to_array().map(f32::to_le_bytes).as_flattened());
        bytes.extend([100, *device, 7]);
    }
    bytes.resize(bytes.len().next_multiple_of(4096), 0);
    bytes
}

/// Tables of a log, with the columns that are read and some others.
const SCHEMA: &str = "CREATE TABLE log (token BLOB PRIMARY KEY, vehicle_name, date, timestamp INTEGER, \
    logfile, location, map_version);
         CREATE TABLE category (token BLOB PRIMARY KEY, name, description);
         CREATE TABLE lidar (token BLOB PRIMARY KEY, log_token, channel, model, translation BLOB, rotation \
         BLOB);
         CREATE TABLE camera (token BLOB PRIMARY KEY, log_token, channel, model, translation BLOB, rotation \
         BLOB,
             intrinsic BLOB, distortion BLOB, width FLOAT, height FLOAT);
         CREATE TABLE ego_pose (token BLOB PRIMARY KEY, timestamp INTEGER, x FLOAT, y FLOAT, z FLOAT, qw \
         FLOAT, qx FLOAT,
             qy FLOAT, qz FLOAT, epsg INTEGER);
         CREATE TABLE scene (token BLOB PRIMARY KEY, log_token, name TEXT, goal_ego_pose_token, \
         roadblock_ids);
         CREATE TABLE lidar_pc (token BLOB PRIMARY KEY, next_token, prev_token, ego_pose_token, lidar_token, \
         scene_token,
             filename, timestamp);
         CREATE TABLE image (token BLOB PRIMARY KEY, next_token, prev_token, ego_pose_token, camera_token, \
         filename_jpg,
             timestamp);
         CREATE TABLE track (token BLOB PRIMARY KEY, category_token, width FLOAT, length FLOAT, height FLOAT);
         CREATE TABLE lidar_box (token BLOB PRIMARY KEY, lidar_pc_token, track_token, x FLOAT, y FLOAT, z \
         FLOAT,
             width FLOAT, length FLOAT, height FLOAT, yaw FLOAT, confidence FLOAT);
         CREATE TABLE scenario_tag (token BLOB PRIMARY KEY, lidar_pc_token, type TEXT, agent_track_token);
         CREATE TABLE traffic_light_status (token BLOB PRIMARY KEY, lidar_pc_token, lane_connector_id INTEGER,
             status VARCHAR(8));\n";

/// Returns the statements that create the log.
fn tables() -> String {
    let mut sql = String::from(SCHEMA);
    let mut insert = |table: &str, values: String| {
        writeln!(sql, "INSERT INTO {table} VALUES ({values});").unwrap();
    };
    insert(
        "log",
        format!("{}, 'veh-01', '2021-01-01', {FIRST_US}, '{LOG}', '{MAP}', '{MAP}.gpkg'", token('o', 0)),
    );
    let categories =
        ["vehicle", "bicycle", "pedestrian", "traffic_cone", "barrier", "czone_sign", "generic_object"];
    for (i, name) in categories.iter().enumerate() {
        insert("category", format!("{}, '{name}', ''", token('k', i)));
        let [width, length, height] = sizes(i);
        insert("track", format!("{}, {}, {width}, {length}, {height}", token('t', 9 - i), token('k', i)));
    }
    let (level, up) = (pickled(&[1.0, 0.0, 0.0, 0.0]), pickled(&[0.0, 0.0, LIDAR_Z]));
    insert("lidar", format!("{}, x'00', 'MergedPointCloud', 'm', {up}, {level}", token('l', 0)));
    let intrinsic = pickled_matrix(&[[48.0, 0.0, 48.0], [0.0, 48.0, 32.0], [0.0, 0.0, 1.0]]);
    // The file stores the cameras in reverse order.
    for (i, name) in RING.iter().enumerate().rev() {
        let q = camera_rotation(-(i as f64) * std::f64::consts::FRAC_PI_4);
        let (up, turn) = (pickled(&[0.0, 0.0, CAMERA_Z]), pickled(&[q.w, q.x, q.y, q.z]));
        let distortion = pickled(if i == 1 { &DISTORTION } else { &[0.0; 5] });
        let [width, height] = SIZE;
        let calibration = format!("{up}, {turn}, {intrinsic}, {distortion}, {width}, {height}");
        insert("camera", format!("{}, x'00', '{name}', 'm', {calibration}", token('c', i)));
    }
    let pose = |number: usize, t_us: i64, at: DVec3| {
        format!("{}, {t_us}, {}, {}, {}, 1, 0, 0, 0, 32611", token('e', number), at.x, at.y, at.z)
    };
    for frame in 0..FRAMES {
        let t_us = FIRST_US + STEP_US * frame as i64;
        insert("ego_pose", pose(frame, t_us, ego_at(frame as f64)));
        let next = if frame + 1 < FRAMES { token('p', frame + 1) } else { "NULL".to_owned() };
        let keys = format!("{}, {next}, NULL, {}, {}", token('p', frame), token('e', frame), token('l', 0));
        let file = sweep_file(frame);
        insert("lidar_pc", format!("{keys}, {}, '{file}', {t_us}", token('s', frame / 2)));
        // Two tags of the same kind for two agents; a light that turns green.
        for (i, kind) in ["following", "following", "waiting"].iter().enumerate().skip(frame % 2) {
            let tag = format!("{}, {}, '{kind}', NULL", token('g', 10 * frame + i), token('p', frame));
            insert("scenario_tag", tag);
        }
        let color = if frame < 2 { "red" } else { "green" };
        let light = format!("{}, {}, 71, '{color}'", token('h', frame), token('p', frame));
        insert("traffic_light_status", light);
        for track in 0..2 {
            let at = if track == 0 { car_at(frame) } else { START + DVec3::new(8.0, 4.0, 0.5) };
            let [width, length, height] = sizes(track);
            let keys = format!("{}, {}", token('b', 10 * frame + track), token('p', frame));
            let place = format!("{}, {}, {}, {width}, {length}, {height}, 0.25", at.x, at.y, at.z);
            insert("lidar_box", format!("{keys}, {}, {place}, 1", token('t', 9 - track)));
        }
    }
    for scene in 0..FRAMES / 2 {
        insert("scene", format!("{}, x'00', 'scene-00{scene}', NULL, ''", token('s', scene)));
    }
    for shot in 0..FRAMES / 2 {
        let t_us = FIRST_US + 2 * STEP_US * shot as i64 + DELAY_US;
        insert("ego_pose", pose(100 + shot, t_us, ego_at(2.0 * shot as f64 + 0.1)));
        for (i, name) in RING.iter().enumerate() {
            let keys = format!(
                "{}, NULL, NULL, {}, {}",
                token('i', 10 * shot + i),
                token('e', 100 + shot),
                token('c', i)
            );
            insert("image", format!("{keys}, '{}', {t_us}", image_file(name, shot)));
        }
    }
    sql
}

/// Returns width, length, height of a track, meters.
pub fn sizes(track: usize) -> [f64; 3] {
    if track == 0 { [2.0, 4.0, 1.5] } else { [0.6, 1.8, 1.0] }
}

/// Bounds of a rectangle, degrees.
pub const WEST: f64 = -115.1729;
pub const EAST: f64 = -115.1727;
pub const SOUTH: f64 = 36.1101;
pub const NORTH: f64 = 36.1103;
/// Its corners south-west, north-west, north-east, south-east in UTM zone 11, meters, by PROJ 9.5.1.
pub const CORNERS: [[f64; 2]; 4] = [
    [664_451.567_964_090_5, 3_997_705.869_355_971_5],
    [664_451.150_855_567_1, 3_997_728.056_162_812],
    [664_469.154_065_432_7, 3_997_728.394_639_708_6],
    [664_469.571_219_659_6, 3_997_706.207_832_108_3],
];

/// Returns the well-known binary of a line or a closed ring in a GeoPackage, as SQL.
pub fn geometry(is_polygon: bool, points: &[[f64; 2]]) -> String {
    let mut hex = String::from("x'47500001e6100000");
    hex += if is_polygon { "010300000001000000" } else { "0102000000" };
    let le = |bytes: &[u8]| bytes.iter().fold(String::new(), |text, b| format!("{text}{b:02x}"));
    hex += &le(&(points.len() as u32).to_le_bytes());
    points.as_flattened().iter().for_each(|v| hex += &le(&v.to_le_bytes()));
    hex + "'"
}

/// Returns the statements that create the map: a lane, a connector after it, a lane after that, all of the
/// same shape.
fn map_tables() -> String {
    let ring = [[WEST, SOUTH], [WEST, NORTH], [EAST, NORTH], [EAST, SOUTH], [WEST, SOUTH]];
    let (area, line) = (geometry(true, &ring), geometry(false, &ring[..2]));
    format!(
        "CREATE TABLE meta (id INTEGER PRIMARY KEY, key TEXT, value TEXT);
         INSERT INTO meta VALUES (1, 'geographicCoordSystem', 'epsg:4326'), (2, 'projectedCoordSystem', \
         'epsg:32611');
         CREATE TABLE gpkg_geometry_columns (table_name TEXT, column_name TEXT);
         INSERT INTO gpkg_geometry_columns VALUES ('lanes_polygons', 'geom'), ('lane_connectors', 'geom'),
             ('gen_lane_connectors_scaled_width_polygons', 'geom'), ('baseline_paths', 'geom'), \
             ('boundaries', 'geom'),
             ('crosswalks', 'geom'), ('stop_polygons', 'geom'), ('generic_drivable_areas', 'geom'),
             ('lane_groups_polygons', 'geom'), ('intersections', 'geom'), ('carpark_areas', 'geom'),
             ('walkways', 'geom');
         CREATE TABLE lanes_polygons (fid INTEGER PRIMARY KEY, geom BLOB, lane_fid INTEGER);
         INSERT INTO lanes_polygons VALUES (11, {area}, 11), (12, {area}, 12);
         CREATE TABLE lane_connectors (fid INTEGER PRIMARY KEY, geom BLOB, exit_lane_fid, entry_lane_fid);
         INSERT INTO lane_connectors VALUES (21, {line}, 11.0, '12');
         CREATE TABLE gen_lane_connectors_scaled_width_polygons (fid INTEGER PRIMARY KEY, geom BLOB, \
         lane_connector_fid);
         INSERT INTO gen_lane_connectors_scaled_width_polygons VALUES (31, {area}, 21);
         CREATE TABLE baseline_paths (fid INTEGER PRIMARY KEY, geom BLOB, lane_fid, lane_connector_fid);
         INSERT INTO baseline_paths VALUES (41, {line}, 11, NULL), (42, {line}, NULL, 21);
         CREATE TABLE boundaries (fid INTEGER PRIMARY KEY, geom BLOB);
         INSERT INTO boundaries VALUES (51, {line});
         CREATE TABLE crosswalks (fid INTEGER PRIMARY KEY, geom BLOB);
         INSERT INTO crosswalks VALUES (61, {area});
         CREATE TABLE stop_polygons (fid INTEGER PRIMARY KEY, geom BLOB);
         INSERT INTO stop_polygons VALUES (71, {area});
         CREATE TABLE generic_drivable_areas (fid INTEGER PRIMARY KEY, geom BLOB);
         INSERT INTO generic_drivable_areas VALUES (81, {area});
         CREATE TABLE lane_groups_polygons (fid INTEGER PRIMARY KEY, geom BLOB);
         INSERT INTO lane_groups_polygons VALUES (91, {area});
         CREATE TABLE intersections (fid INTEGER PRIMARY KEY, geom BLOB);
         CREATE TABLE carpark_areas (fid INTEGER PRIMARY KEY, geom BLOB);
         CREATE TABLE walkways (fid INTEGER PRIMARY KEY, geom BLOB);
         INSERT INTO walkways VALUES (101, {area});"
    )
}
