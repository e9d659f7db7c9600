//! Sweeps and images of a scene, grouped by frame (`unsorted`).
//!
//! Key frames belong to the sample they reference. Other data belongs to the first frame at or after its
//! timestamp; a sample without key frames is no frame. Data after the last frame has no later boxes, so it is
//! skipped and counted.

use std::path::PathBuf;

use rustc_hash::{FxHashMap, FxHashSet};

use super::chain::Chain;
use super::folders::SensorFiles;
use super::lens::{self, lens};
use super::retime::retime;
use super::sensors::{Origin, SensorKind, Sensors, compare_pose};
use super::tables::{SampleData, Scene, Table};
use super::unsorted::{FrameRecord, RawSweep, UnsortedFrame, check_growth, finish};
use super::version::Version;
use crate::dataset::clock::{KeyTimes, PoseTimes};
use crate::dataset::limits::MAX_CAMERAS;
use crate::dataset::recording::notes::{Notes, note};
use crate::dataset::{DatasetError, ImageDistortion, ImageRecord, SweepRecord};
use crate::error::FileError;
use crate::files::{FileName, first_twice};
use crate::geometry::{Camera, CameraError, LensModel, Pose};

/// Cameras around the vehicle, each next to its neighbors: the six of nuScenes, Lyft Level 5 and T4, and the
/// four of TruckScenes.
const RING: [&str; 10] = [
    "CAM_FRONT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK_RIGHT",
    "CAM_BACK",
    "CAM_BACK_LEFT",
    "CAM_FRONT_LEFT",
    "CAMERA_LEFT_FRONT",
    "CAMERA_RIGHT_FRONT",
    "CAMERA_RIGHT_BACK",
    "CAMERA_LEFT_BACK",
];

/// Paths of the files that describe sweeps, by the path of the sweep.
pub(super) type SweepInfos = FxHashMap<PathBuf, PathBuf>;

/// Cameras and frames of a scene.
pub(super) struct SceneFrames {
    pub(super) cameras: Vec<FileName>,
    /// In the order of the chain; `None` for samples without data.
    pub(super) frames: Vec<Option<FrameRecord>>,
    pub(super) infos: SweepInfos,
}

/// Reads the sensor data of every sample of the chain.
pub(super) fn read(
    files: &SensorFiles,
    version: &Version,
    scene: &Scene,
    chain: &Chain,
    distortion: ImageDistortion,
    notes: &mut Notes,
) -> Result<SceneFrames, DatasetError> {
    let rows = version.rows()?;
    note(
        notes,
        "sweeps and images without a sample, in tables of several scenes (not used)",
        rows.unassigned_data(),
    );
    let mut data = rows.data(scene)?;
    let read = data.records.len();
    data.retain(|d| !(d.sample_token.is_empty() && d.is_key_frame.0));
    note(notes, "key frames without a sample (not used)", read - data.records.len());
    data.retain(|d| d.sample_token.is_empty() || chain.place.contains_key(&d.sample_token));
    let all = data.records.len();
    let unclear = data.records.iter().filter(|d| d.is_marked_valid().is_none()).count();
    note(notes, "sweeps and images whose is_valid is neither true nor false (used)", unclear);
    data.retain(|d| d.is_marked_valid() != Some(false));
    note(
        notes,
        "sweeps and images that are marked as invalid (is_valid; not used)",
        all - data.records.len(),
    );
    let needed: FxHashSet<&str> = data.records.iter().map(|d| d.ego_pose_token.as_str()).collect();
    let poses = rows.poses(needed.into_iter())?;
    let (calibrated, sensors) = (Table::load(&version.folder)?, Table::load(&version.folder)?);
    let mut sensors = Sensors { data, poses, calibrated, sensors, distortion };
    retime(&mut sensors, chain, notes);
    let cameras = sensors.cameras()?;
    let mut piles: Vec<UnsortedFrame> = chain.times_us.iter().map(|_| UnsortedFrame::default()).collect();
    let (mut key_times, mut pose_times) = (KeyTimes::default(), PoseTimes::default());
    let mut lenses = FxHashSet::default();
    for data in &sensors.data.records {
        let origin = match sensors.origin(data) {
            Ok(origin) => origin,
            Err(gap) => {
                notes.gap(gap);
                continue;
            }
        };
        let Origin { sensor, calibrated, ego } = origin;
        sensors.check_clock(data, sensor, chain, &mut key_times)?;
        compare_pose(data, sensor, ego, &mut pose_times);
        if sensor.kind() == SensorKind::Camera && lenses.insert(calibrated.token.as_str()) {
            lens::unread(calibrated, sensor, distortion).iter().for_each(|text| note(notes, text, 1));
        }
        if !data.is_key_frame.0 && chain.is_long_before(data.timestamp.0) {
            note(notes, "sweeps and images long before the first sample (not used)", 1);
            continue;
        }
        let place = match chain.place.get(&data.sample_token) {
            Some(place) if data.is_key_frame.0 => *place,
            _ => chain.times_us.partition_point(|t| *t < data.timestamp.0),
        };
        match piles.get_mut(place) {
            Some(pile) => sensors.add(pile, data, origin, files, &cameras, notes)?,
            None => note(notes, "sweeps and images after the last sample", 1),
        }
    }
    let infos = sensors.infos(files)?;
    key_times.note(notes);
    pose_times.note(notes);
    let path = &sensors.data.path;
    check_growth(&piles, path)?;
    let dangling = notes.gaps.first().cloned();
    let frames = finish(piles, &cameras, &chain.times_us, path, notes);
    if frames.iter().all(Option::is_none) {
        return Err(sensors.no_key_frames(dangling.as_ref()).into());
    }
    Ok(SceneFrames { frames, cameras, infos })
}

impl Sensors {
    /// Returns the camera channels of the scene: those of [`RING`] in its order, then others by name.
    ///
    /// # Errors
    /// Fails if a channel is not a valid folder name, two channels differ only in case, or there are too many
    /// cameras.
    fn cameras(&self) -> Result<Vec<FileName>, DatasetError> {
        let mut channels: Vec<FileName> = Vec::new();
        for data in &self.data.records {
            let Ok((sensor, _)) = self.sensor_of(data) else { continue };
            if sensor.kind() == SensorKind::Camera && !channels.iter().any(|known| *known == sensor.channel) {
                let channel = FileName::new(&sensor.channel);
                channels.push(channel.map_err(|error| error.in_file(&self.sensors.path))?);
            }
            if channels.len() > MAX_CAMERAS {
                let expected = format!("at most {MAX_CAMERAS} cameras");
                return Err(FileError::content(expected, "more", &self.sensors.path).into());
            }
        }
        if let Some(channel) = first_twice(&channels) {
            let expected = "channels of cameras that differ in more than case";
            return Err(FileError::content(expected, format!("{channel:?} twice"), &self.sensors.path).into());
        }
        let place = |channel: &FileName| RING.iter().position(|r| *channel == *r).unwrap_or(RING.len());
        channels.sort_by(|a, b| place(a).cmp(&place(b)).then_with(|| a.cmp(b)));
        Ok(channels)
    }

    /// Returns the files that describe sweeps.
    ///
    /// # Errors
    /// Fails if a name points outside the folder of sweeps and images.
    fn infos(&self, files: &SensorFiles) -> Result<SweepInfos, DatasetError> {
        let is_sweep = |data: &SampleData| {
            self.sensor_of(data).is_ok_and(|(sensor, _)| sensor.kind() == SensorKind::Lidar)
        };
        let described =
            self.data.records.iter().filter(|data| !data.info_filename.is_empty() && is_sweep(data));
        let info = |data: &SampleData| {
            let path = |field: &str, name: &str| {
                let path = files.resolve(name);
                path.map_err(|error| {
                    error.of(&format!("{field} of sample_data {}", data.token)).in_file(&self.data.path)
                })
            };
            Ok((path("filename", &data.filename)?, path("info_filename", &data.info_filename)?))
        };
        described.map(info).collect()
    }

    /// Adds a sweep or image to a frame's data.
    fn add(
        &self,
        pile: &mut UnsortedFrame,
        data: &SampleData,
        origin: Origin<'_>,
        files: &SensorFiles,
        cameras: &[FileName],
        notes: &mut Notes,
    ) -> Result<(), DatasetError> {
        let Origin { sensor, calibrated, ego } = origin;
        let global_from_ego = pose(&self.poses, ego, ego.rotation, ego.translation)?;
        let ego_from_sensor =
            pose(&self.calibrated, calibrated, calibrated.rotation, calibrated.translation)?;
        let path = files.resolve(&data.filename).map_err(|error| {
            let error = error.of(&format!("filename of sample_data {}", data.token));
            error.in_file(&self.data.path)
        })?;
        let t_us = data.timestamp.0;
        let twice = |channel: &str| {
            let found = format!("a second key frame of {channel} in sample {}", data.sample_token);
            DatasetError::from(FileError::content(
                "one key frame per sensor and sample",
                found,
                &self.data.path,
            ))
        };
        match (sensor.kind(), cameras.iter().position(|c| *c == sensor.channel)) {
            (SensorKind::Camera, Some(channel)) => {
                let camera = self.camera(data, origin)?.into();
                let ego_from_camera = ego_from_sensor;
                let token = data.token.clone();
                let record = ImageRecord {
                    token,
                    channel,
                    path,
                    row: None,
                    t_us,
                    global_from_ego,
                    ego_from_camera,
                    camera,
                };
                if !data.is_key_frame.0 {
                    pile.between_images.push(record);
                } else if pile.images.iter().any(|i| i.channel == channel) {
                    return Err(twice(&sensor.channel));
                } else {
                    pile.images.push(record);
                }
            }
            (SensorKind::Lidar, _) => {
                let (channel, is_key) = (sensor.channel.clone(), data.is_key_frame.0);
                if is_key && pile.sweeps.iter().any(|s| s.is_key && s.channel == channel) {
                    return Err(twice(&channel));
                }
                let record = SweepRecord {
                    path,
                    row: None,
                    t_us,
                    global_from_ego,
                    ego_from_lidar: ego_from_sensor,
                    is_key,
                };
                let token = data.token.clone();
                pile.sweeps.push(RawSweep { channel, is_key, token, record });
            }
            _ => note(notes, &format!("{} sweeps (not read)", sensor.modality), 1),
        }
        Ok(())
    }

    /// Returns the camera of an image: size and intrinsics.
    fn camera(&self, data: &SampleData, origin: Origin<'_>) -> Result<Camera, DatasetError> {
        let Origin { sensor, calibrated, .. } = origin;
        let record = format!("calibrated_sensor {} ({})", calibrated.token, sensor.channel);
        let path = self.calibrated.path.clone();
        let rows: Option<Vec<[f64; 3]>> =
            calibrated.camera_intrinsic.iter().map(|row| row.as_slice().try_into().ok()).collect();
        let Some(rows) = rows.and_then(|rows| <[[f64; 3]; 3]>::try_from(rows).ok()) else {
            let found = format!("{:?} in {record}", calibrated.camera_intrinsic);
            return Err(FileError::content("a 3x3 camera_intrinsic", found, &path).into());
        };
        let (Some(width), Some(height)) = (data.width.get(), data.height.get()) else {
            let found = format!("{} and {} in sample_data {}", data.width, data.height, data.token);
            return Err(FileError::content("width and height of an image", found, &self.data.path).into());
        };
        let lens = lens(calibrated, sensor, self.distortion, &record, &path)?;
        let camera = Camera::new(&sensor.channel, width, height, rows);
        let camera = camera.map_err(|source| {
            let (record, path) = match source {
                CameraError::Size { .. } => {
                    (format!("sample_data {} ({})", data.token, sensor.channel), self.data.path.clone())
                }
                _ => (record, path),
            };
            DatasetError::Camera { source, record, path }
        })?;
        Ok(Camera { lens: lens.distortion.map(LensModel::from), ..camera })
    }
}

/// Returns the pose of a record.
pub(super) fn pose<R: super::tables::Record>(
    table: &Table<R>,
    record: &R,
    rotation: [f64; 4],
    translation: [f64; 3],
) -> Result<Pose, DatasetError> {
    Pose::from_wxyz(rotation, translation).map_err(|source| DatasetError::Pose {
        source,
        record: format!("{} {}", R::TABLE, record.token()),
        path: table.path.clone(),
    })
}
