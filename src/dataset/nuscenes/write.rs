//! Export of any log as a nuScenes dataset.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::write_map::{MapLayers, picture_name, write_map};
use super::write_sweep_file;
use crate::dataset::{DatasetError, Frame, ImageRecord, LogReader, Recording, Sweep, SweepRecord};
use crate::error::FileError;
use crate::files::{write_json, write_whole};
use crate::geometry::Pose;

/// JPEG quality of the images, 1 to 100.
const QUALITY: u8 = 95;

/// Writes a log as `root/version/*.json` (13 tables), `root/samples` and `root/sweeps`. Reading it back
/// yields the same log, except for paths, the order of cameras and tracks (by token), and JPEG losses.
/// Scenarios, traffic lights, notes and the map are omitted, since the tables cannot represent them. The
/// tables are written last.
///
/// # Errors
/// Returns any error of the log. Fails if a frame has more than one LiDAR, a camera has lens distortion
/// (which the tables cannot represent), or a file cannot be written.
pub fn write_log(root: &Path, version: &str, dataset: &dyn LogReader) -> Result<(), DatasetError> {
    LogWriter { version, map: None, frame_done: &|_| () }.write(root, dataset)
}

/// Options for writing a log.
pub struct LogWriter<'a> {
    /// Name of the table folder.
    pub version: &'a str,
    /// Map content beyond the log's [`VectorMap`](crate::dataset::VectorMap); `None` to write no map.
    pub map: Option<&'a MapLayers>,
    /// Progress callback, called after each frame with its index.
    pub frame_done: &'a dyn Fn(usize),
}

impl LogWriter<'_> {
    /// Writes a log as [`write_log`] does, and also its map, if requested and available.
    ///
    /// # Errors
    /// Fails as [`write_log`] and [`write_map`](super::write_map()).
    pub fn write(&self, root: &Path, dataset: &dyn LogReader) -> Result<(), DatasetError> {
        refuse_distortion(dataset.recording(), root)?;
        let mut tables = Tables::default();
        let map = self.map.map(|layers| Ok::<_, DatasetError>(dataset.read_map()?.map(|map| (map, layers))));
        if let Some((map, layers)) = map.transpose()?.flatten() {
            write_map(root, &map, layers)?;
            tables.map_picture = picture_name(&map.location);
        }
        tables.fixed(dataset);
        write_files(root, dataset, &mut tables, self.frame_done)?;
        tables.write(&root.join(self.version))
    }
}

fn write_files(
    root: &Path,
    dataset: &dyn LogReader,
    tables: &mut Tables,
    frame_done: &dyn Fn(usize),
) -> Result<(), DatasetError> {
    let log = dataset.recording();
    for channel in &log.cameras {
        make_folders(root, channel)?;
    }
    make_folders(root, LIDAR)?;
    for (index, frame) in log.frames.iter().enumerate() {
        let images: Vec<(&ImageRecord, bool)> = frame
            .images
            .iter()
            .map(|i| (i, true))
            .chain(frame.between_images.iter().map(|i| (i, false)))
            .collect();
        images.par_iter().try_for_each(|(record, key)| {
            let path = root.join(image_name(&log.cameras[record.channel], record, *key));
            write_image(&path, &dataset.read_image(record)?)
        })?;
        let lidars = frame.sweeps.iter().filter(|s| s.is_key).count();
        if lidars > 1 {
            return Err(FileError::content("one LiDAR", format!("{lidars} in frame {index}"), root).into());
        }
        let mut counts = Vec::new();
        for (number, record) in frame.sweeps.iter().enumerate() {
            let sweep = dataset.read_sweep(record)?;
            write_sweep_file(&root.join(sweep_name(record)), &sweep.points)?;
            if number == 0 {
                counts = points_in_boxes(frame, record, &sweep);
            }
        }
        tables.frame(dataset, index, &counts);
        frame_done(index);
    }
    Ok(())
}

fn refuse_distortion(log: &Recording, root: &Path) -> Result<(), FileError> {
    let images = log.frames.iter().flat_map(|f| f.images.iter().chain(&f.between_images));
    let mut cameras = log.rig.iter().map(|c| &c.camera).chain(images.map(|image| &*image.camera));
    match cameras.find_map(|camera| Some((camera, camera.lens.as_ref()?))) {
        None => Ok(()),
        Some((camera, lens)) => Err(FileError::content(
            "cameras without lens distortion",
            format!("one of {} ({})", camera.name, lens.name()),
            root,
        )),
    }
}

/// The only LiDAR channel that is written.
const LIDAR: &str = "LIDAR_TOP";

fn make_folders(root: &Path, channel: &str) -> Result<(), FileError> {
    for kind in ["samples", "sweeps"] {
        let folder = root.join(kind).join(channel);
        std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
    }
    Ok(())
}

fn image_name(channel: &str, record: &ImageRecord, key: bool) -> String {
    format!("{}/{channel}/{channel}__{}.jpg", if key { "samples" } else { "sweeps" }, record.t_us)
}

fn sweep_name(record: &SweepRecord) -> String {
    format!("{}/{LIDAR}/{LIDAR}__{}.pcd.bin", if record.is_key { "samples" } else { "sweeps" }, record.t_us)
}

fn write_image(path: &Path, image: &image::RgbImage) -> Result<(), DatasetError> {
    let mut bytes = Vec::new();
    let encoded = JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode_image(image);
    encoded.map_err(|e| FileError::content("an image that JPEG can hold", e.to_string(), path))?;
    Ok(write_whole(path, |writer| {
        std::io::Write::write_all(writer, &bytes).map_err(FileError::io("write", path))
    })?)
}

/// Counts the points of the frame's sweep in each box.
fn points_in_boxes(frame: &Frame, record: &SweepRecord, sweep: &Sweep) -> Vec<usize> {
    let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
    let count = |cuboid: &crate::geometry::Cuboid| {
        let box_from_lidar = cuboid.pose.inverse() * global_from_lidar;
        let inside = |p: &[f32; 3]| {
            let local = box_from_lidar.transform_point(glam::Vec3::from(*p).as_dvec3());
            cuboid.contains_local(local, 0.0)
        };
        sweep.points.iter().filter(|p| inside(&p.position)).count()
    };
    frame.boxes.par_iter().map(|b| count(&b.cuboid)).collect()
}

/// Sorts items by time.
fn by_time<T>(items: &[T], t_us: impl Fn(&T) -> i64) -> Vec<&T> {
    let mut sorted: Vec<&T> = items.iter().collect();
    sorted.sort_by_key(|item| t_us(item));
    sorted
}

/// Returns a token of 32 hexadecimal digits, like nuScenes' own.
fn token(kind: Kind, index: usize) -> String {
    format!("{:02x}{index:030x}", kind as u8 + 0xa0)
}

/// Returns the token of a neighbor in a chain; empty at its ends, as in nuScenes.
fn neighbour(kind: Kind, index: Option<usize>) -> String {
    index.map_or_else(String::new, |i| token(kind, i))
}

#[derive(Clone, Copy)]
enum Kind {
    Sample,
    SampleData,
    Pose,
    Calibration,
    Sensor,
    Annotation,
    Category,
    Other,
}

/// Tables under construction, in nuScenes' layout.
#[derive(Default)]
struct Tables {
    tables: std::collections::BTreeMap<&'static str, Vec<Value>>,
    /// Last annotation of each track.
    last: std::collections::BTreeMap<usize, usize>,
    /// Last file of each sensor.
    last_data: std::collections::BTreeMap<usize, usize>,
    /// File name of the map image; empty without a map.
    map_picture: String,
}

impl Tables {
    fn rows(&mut self, table: &'static str) -> &mut Vec<Value> {
        self.tables.entry(table).or_default()
    }

    /// Adds the records that do not depend on frames.
    fn fixed(&mut self, dataset: &dyn LogReader) {
        let log = dataset.recording();
        let (scene, record) = (token(Kind::Other, 0), token(Kind::Other, 1));
        self.rows("scene").push(json!({
            "token": scene, "log_token": record, "nbr_samples": log.frames.len(), "name": log.name,
            "description": log.description, "first_sample_token": token(Kind::Sample, 0),
            "last_sample_token": token(Kind::Sample, log.frames.len().saturating_sub(1)),
        }));
        self.rows("log").push(json!({
            "token": record, "logfile": log.name, "vehicle": "synthetic", "date_captured": "",
            "location": log.location,
        }));
        let picture = self.map_picture.clone();
        self.rows("map").push(json!({
            "token": token(Kind::Other, 2), "log_tokens": [record], "category": "semantic_prior",
            "filename": picture,
        }));
        self.rows("attribute");
        for (token, [from, to]) in [("1", [0, 40]), ("2", [40, 60]), ("3", [60, 80]), ("4", [80, 100])] {
            self.rows("visibility").push(json!({
                "token": token, "level": format!("v{from}-{to}"),
                "description": format!("{from} to {to} % visible"),
            }));
        }
        let sensors = log.cameras.iter().map(|name| (name.as_str(), "camera")).chain([(LIDAR, "lidar")]);
        for (i, (channel, modality)) in sensors.enumerate() {
            self.rows("sensor")
                .push(json!({"token": token(Kind::Sensor, i), "channel": channel, "modality": modality}));
        }
        let categories: std::collections::BTreeSet<&str> =
            log.tracks.iter().map(|t| t.category.as_str()).collect();
        for (i, name) in categories.iter().enumerate() {
            let row =
                json!({"token": token(Kind::Category, i), "name": name, "description": "", "index": i + 1});
            self.rows("category").push(row);
        }
        let category =
            |name: &str| token(Kind::Category, categories.iter().position(|c| *c == name).unwrap_or(0));
        for (track, info) in log.tracks.iter().enumerate() {
            let boxes = log.track_boxes(track).len();
            self.rows("instance").push(json!({
                "token": info.id, "category_token": category(&info.category), "nbr_annotations": boxes,
                "first_annotation_token": "", "last_annotation_token": "",
            }));
        }
    }

    fn frame(&mut self, dataset: &dyn LogReader, index: usize, counts: &[usize]) {
        let log = dataset.recording();
        let frame = &log.frames[index];
        self.rows("sample").push(json!({
            "token": token(Kind::Sample, index), "timestamp": frame.t_us, "scene_token": token(Kind::Other,
            0),
            "prev": neighbour(Kind::Sample, index.checked_sub(1)),
            "next": neighbour(Kind::Sample, Some(index + 1).filter(|i| *i < log.frames.len())),
        }));
        for record in by_time(&frame.sweeps, |s| s.t_us) {
            let name = sweep_name(record);
            let sensor = (log.cameras.len(), record.ego_from_lidar, json!([]), [0, 0]);
            self.data(index, record.is_key, name, record.t_us, record.global_from_ego, sensor);
        }
        let keys = frame.images.iter().map(|i| (i, true));
        let images: Vec<_> = keys.chain(frame.between_images.iter().map(|i| (i, false))).collect();
        for &(record, key) in by_time(&images, |(i, _)| i.t_us) {
            let name = image_name(&log.cameras[record.channel], record, key);
            let camera = &record.camera;
            let size = [camera.height, camera.width];
            let sensor = (record.channel, record.ego_from_camera, json!(camera.rows()), size);
            self.data(index, key, name, record.t_us, record.global_from_ego, sensor);
        }
        for (item, count) in frame.boxes.iter().zip(counts) {
            self.annotation(index, &log.tracks[item.track].id, item, *count);
        }
    }

    /// Adds a sensor file: its row, ego pose and calibration. `sensor`: index, extrinsics, intrinsics, height
    /// and width.
    fn data(
        &mut self,
        frame: usize,
        key: bool,
        name: String,
        t_us: i64,
        ego: Pose,
        sensor: (usize, Pose, Value, [u32; 2]),
    ) {
        let (sensor, extrinsics, intrinsics, [height, width]) = sensor;
        let index = self.rows("sample_data").len();
        let pose = token(Kind::Pose, index);
        self.rows("ego_pose").push(json!({
            "token": pose, "timestamp": t_us, "rotation": ego.wxyz(),
            "translation": ego.translation.to_array(),
        }));
        let before = self.last_data.insert(sensor, index);
        if let Some(before) = before {
            self.rows("sample_data")[before]["next"] = json!(token(Kind::SampleData, index));
        }
        let calibration = self.calibration(sensor, extrinsics, intrinsics);
        let format = if name.ends_with(".pcd.bin") { "pcd" } else { "jpg" };
        self.rows("sample_data").push(json!({
            "token": token(Kind::SampleData, index), "sample_token": token(Kind::Sample, frame),
            "ego_pose_token": pose, "calibrated_sensor_token": calibration, "timestamp": t_us,
            "is_key_frame": key,
            "height": height, "width": width, "fileformat": format, "filename": name,
            "prev": neighbour(Kind::SampleData, before), "next": "",
        }));
    }

    /// Returns the token of a sensor's calibration. Equal calibrations share one record.
    fn calibration(&mut self, sensor: usize, extrinsics: Pose, intrinsics: Value) -> String {
        let row = |token: &str| {
            json!({
                "token": token, "sensor_token": self::token(Kind::Sensor, sensor),
                "rotation": extrinsics.wxyz(),
                "translation": extrinsics.translation.to_array(), "camera_intrinsic": intrinsics,
            })
        };
        let rows = self.rows("calibrated_sensor");
        let known =
            rows.iter().find_map(|known| known["token"].as_str().filter(|token| row(token) == *known));
        if let Some(known) = known {
            return known.to_owned();
        }
        let new = token(Kind::Calibration, rows.len());
        rows.push(row(&new));
        new
    }

    fn annotation(&mut self, frame: usize, track: &str, item: &crate::dataset::TrackBox, points: usize) {
        let index = self.rows("sample_annotation").len();
        let before = self.last.insert(item.track, index);
        let own = token(Kind::Annotation, index);
        if let Some(before) = before {
            self.rows("sample_annotation")[before]["next"] = json!(own);
        }
        let instance = &mut self.rows("instance")[item.track];
        instance["last_annotation_token"] = json!(own);
        if before.is_none() {
            instance["first_annotation_token"] = json!(own);
        }
        let (pose, size) = (item.cuboid.pose, item.cuboid.size);
        self.rows("sample_annotation").push(json!({
            "token": own, "sample_token": token(Kind::Sample, frame), "instance_token": track,
            "visibility_token": "4",
            "attribute_tokens": [], "translation": pose.translation.to_array(), "rotation": pose.wxyz(),
            "size": [size.y, size.x, size.z], "prev": neighbour(Kind::Annotation, before), "next": "",
            "num_lidar_pts": points, "num_radar_pts": 0,
        }));
    }

    fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
        for (table, rows) in &self.tables {
            write_json(&folder.join(format!("{table}.json")), rows)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::RigCamera;
    use crate::geometry::{Camera, LensModel};

    /// A log with one camera and no frames.
    struct Bare(Recording);

    impl LogReader for Bare {
        fn recording(&self) -> &Recording {
            &self.0
        }

        fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
            Err(FileError::content("no sweep", "one", &record.path).into())
        }

        fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
            Err(FileError::content("no image", "one", &record.path).into())
        }
    }

    #[test]
    fn distortion_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let rows = [[48.0, 0.0, 48.0], [0.0, 48.0, 32.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("CAM_A", 96, 64, rows).unwrap();
        let write = |k1: f64| {
            let lens = LensModel::from_opencv([k1, 0.0, 0.0, 0.0, 0.0]);
            let camera = Camera { lens, ..camera.clone() };
            let rig = vec![RigCamera { channel: 0, ego_from_camera: Pose::IDENTITY, camera }];
            let log = Recording { cameras: vec!["CAM_A".parse().unwrap()], rig, ..Recording::default() };
            write_log(folder.path(), "v1.0-mini", &Bare(log)).map_err(|e| e.to_string())
        };
        let message = write(-0.1).unwrap_err();
        assert!(
            message
                .starts_with("expected cameras without lens distortion, found one of CAM_A (Brown-Conrady)"),
            "{message}"
        );
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        write(0.0).unwrap();
    }
}
