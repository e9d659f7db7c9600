//! Sweeps and images of a scene, grouped by frame.
//!
//! Key frames belong to the sample they reference. Other data belongs to the first frame at or after its
//! timestamp; a sample without key frames is no frame. Data after the last frame has no later boxes, so it is
//! skipped and counted.

use std::path::Path;

use rustc_hash::{FxHashMap, FxHashSet};

use super::chain::Chain;
use super::lens::{self, lens};
use super::retime::retime;
use super::sensors::{Origin, SensorKind, Sensors, compare_pose};
use super::tables::{SampleData, Scene, Table};
use super::version::Version;
use crate::dataset::clock::{KeyTimes, PoseTimes, Unit};
use crate::dataset::limits::MAX_CAMERAS;
use crate::dataset::recording::notes::{NO_IMAGE, NO_SWEEP, Notes, note};
use crate::dataset::{DatasetError, Gap, ImageDistortion, ImageRecord, SweepRecord};
use crate::error::FileError;
use crate::files::input::DataRoot;
use crate::files::{FileName, first_twice};
use crate::geometry::{Camera, CameraError, LensModel, Pose};

/// The six cameras in ring order, each next to its neighbors.
const RING: [&str; 6] =
    ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"];

/// LiDAR that defines the ego pose of a frame.
pub(super) const MAIN_LIDAR: &str = "LIDAR_TOP";

/// Kind of a gap: a sample that neither a sweep nor an image gives an ego pose.
const NO_DATA: &str = "samples without data";

/// Note on data between key frames to which no frame belongs: all later samples are without key frames.
const NO_LATER_FRAME: &str = "sweeps and images after the last sample with key frames";

/// Cameras and frames of a scene.
pub(super) struct SceneFrames {
    pub(super) cameras: Vec<FileName>,
    /// In the order of the chain; `None` for samples without data.
    pub(super) frames: Vec<Option<FrameRecord>>,
}

/// Sensor data and ego pose of a frame.
#[derive(Debug)]
pub(super) struct FrameRecord {
    pub(super) global_from_ego: Pose,
    pub(super) sweeps: Vec<SweepRecord>,
    pub(super) images: Vec<ImageRecord>,
    pub(super) between_images: Vec<ImageRecord>,
}

/// Sweep before sorting into a frame.
struct RawSweep {
    channel: String,
    is_key: bool,
    token: String,
    record: SweepRecord,
}

/// Unsorted sweeps and images of one frame.
#[derive(Default)]
struct UnsortedFrame {
    sweeps: Vec<RawSweep>,
    images: Vec<ImageRecord>,
    between_images: Vec<ImageRecord>,
}

/// Reads the sensor data of every sample of the chain.
pub(super) fn read(
    root: &DataRoot,
    version: &Version,
    scene: &Scene,
    chain: &Chain,
    distortion: ImageDistortion,
    notes: &mut Notes,
) -> Result<SceneFrames, DatasetError> {
    let rows = version.rows()?;
    let mut data = rows.data(scene)?;
    data.retain(|d| chain.place.contains_key(&d.sample_token));
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
            Some(pile) => sensors.add(pile, data, origin, root, &cameras, notes)?,
            None => note(notes, "sweeps and images after the last sample", 1),
        }
    }
    key_times.note(notes);
    pose_times.note(notes);
    let path = &sensors.data.path;
    check_growth(&piles, path)?;
    let dangling = notes.gaps.first().cloned();
    let frames = finish(piles, &cameras, &chain.times_us, path, notes);
    if frames.iter().all(Option::is_none) {
        return Err(sensors.no_key_frames(dangling.as_ref()).into());
    }
    Ok(SceneFrames { frames, cameras })
}

impl Sensors {
    /// Returns the camera channels of the scene: the six of nuScenes in ring order, then others by name.
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

    /// Adds a sweep or image to a frame's data.
    fn add(
        &self,
        pile: &mut UnsortedFrame,
        data: &SampleData,
        origin: Origin<'_>,
        root: &DataRoot,
        cameras: &[FileName],
        notes: &mut Notes,
    ) -> Result<(), DatasetError> {
        let Origin { sensor, calibrated, ego } = origin;
        let global_from_ego = pose(&self.poses, ego, ego.rotation, ego.translation)?;
        let ego_from_sensor =
            pose(&self.calibrated, calibrated, calibrated.rotation, calibrated.translation)?;
        let path = root.resolve(&data.filename).map_err(|error| {
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
                let camera = self.camera(data, origin)?;
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

/// Sorts the frames. A sample without an ego pose is no frame, and its data belongs to the next one.
fn finish(
    piles: Vec<UnsortedFrame>,
    cameras: &[FileName],
    times_us: &[i64],
    path: &Path,
    notes: &mut Notes,
) -> Vec<Option<FrameRecord>> {
    let (mut frames, mut carried) = (Vec::with_capacity(piles.len()), UnsortedFrame::default());
    for (mut pile, t_us) in piles.into_iter().zip(times_us) {
        pile.sweeps.append(&mut carried.sweeps);
        pile.between_images.append(&mut carried.between_images);
        match pile.finish(cameras, *t_us, path, notes) {
            Ok(frame) => frames.push(Some(frame)),
            Err(pile) => {
                carried = pile;
                frames.push(None);
            }
        }
    }
    note(notes, NO_LATER_FRAME, carried.sweeps.len() + carried.between_images.len());
    frames
}

impl UnsortedFrame {
    /// Sorts a frame.
    ///
    /// # Errors
    /// Returns the data if there is neither a key sweep nor a key image to provide the ego pose.
    fn finish(
        mut self,
        cameras: &[FileName],
        t_us: i64,
        path: &Path,
        notes: &mut Notes,
    ) -> Result<FrameRecord, Self> {
        for (channel, name) in cameras.iter().enumerate() {
            if !self.images.iter().any(|i| i.channel == channel) {
                notes.gap(Gap::record(NO_IMAGE, format!("{name} of the sample at {t_us}"), path));
            }
        }
        self.images.sort_by_key(|i| i.channel);
        self.between_images.sort_by_key(|i| (i.t_us, i.channel));
        self.sweeps.sort_by(|a, b| {
            let rank = |s: &RawSweep| (!s.is_key, s.is_key && s.channel != MAIN_LIDAR);
            let by_rank = rank(a).cmp(&rank(b));
            let by_time =
                if a.is_key { std::cmp::Ordering::Equal } else { b.record.t_us.cmp(&a.record.t_us) };
            by_rank.then(by_time).then_with(|| a.channel.cmp(&b.channel))
        });
        if !self.sweeps.first().is_some_and(|s| s.is_key) {
            notes.gap(Gap::record(NO_SWEEP, format!("sample at {t_us}"), path));
        }
        let of_sweep = self.sweeps.first().filter(|s| s.is_key).map(|s| s.record.global_from_ego);
        let of_image = || self.images.iter().min_by_key(|i| i.t_us).map(|i| i.global_from_ego);
        let Some(global_from_ego) = of_sweep.or_else(of_image) else {
            notes.gap(Gap::record(NO_DATA, format!("sample at {t_us}"), path));
            return Err(self);
        };
        let sweeps = self.sweeps.into_iter().map(|s| s.record).collect();
        Ok(FrameRecord { global_from_ego, sweeps, images: self.images, between_images: self.between_images })
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

/// Checks that the times of a sensor's key frames grow from frame to frame. An image may be repeated.
fn check_growth(frames: &[UnsortedFrame], path: &Path) -> Result<(), FileError> {
    let mut last: FxHashMap<String, (i64, &Path)> = FxHashMap::default();
    for frame in frames {
        let sweeps = frame.sweeps.iter().filter(|sweep| sweep.is_key);
        let sweeps = sweeps.map(|s| (s.channel.clone(), &s.token, s.record.t_us, s.record.path.as_path()));
        let images =
            frame.images.iter().map(|i| (i.camera.name.to_string(), &i.token, i.t_us, i.path.as_path()));
        for (channel, token, t_us, file) in sweeps.chain(images) {
            let before = last.insert(channel.clone(), (t_us, file));
            if let Some((before_us, _)) = before.filter(|(t, known)| *t >= t_us && *known != file) {
                let expected = "times of key frames that grow from sample to sample";
                let hint = Unit::MICROS.hint(t_us as f64);
                let found = format!("{t_us} in sample_data {token} of {channel} after {before_us}{hint}");
                return Err(FileError::content(expected, found, path));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweep(t_us: i64, is_key: bool) -> RawSweep {
        let (global_from_ego, ego_from_lidar) = (Pose::IDENTITY, Pose::IDENTITY);
        let record = SweepRecord {
            path: format!("{t_us}.pcd.bin").into(),
            row: None,
            t_us,
            global_from_ego,
            ego_from_lidar,
            is_key,
        };
        RawSweep { channel: MAIN_LIDAR.to_owned(), is_key, token: t_us.to_string(), record }
    }

    fn image(t_us: i64) -> ImageRecord {
        let rows = [[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]];
        ImageRecord {
            token: t_us.to_string(),
            channel: 0,
            path: format!("{t_us}.jpg").into(),
            row: None,
            t_us,
            global_from_ego: Pose::IDENTITY,
            ego_from_camera: Pose::IDENTITY,
            camera: Camera::new("c", 10, 10, rows).unwrap(),
        }
    }

    #[test]
    fn data_of_a_sample_without_key_frames_belongs_to_the_next_frame() {
        let pile = |t_us: i64, has_key: bool| {
            let mut pile = UnsortedFrame::default();
            pile.sweeps.push(sweep(t_us - 50, false));
            pile.sweeps.extend(has_key.then(|| sweep(t_us, true)));
            pile.between_images.push(image(t_us - 40));
            pile
        };
        let piles =
            vec![pile(100, true), pile(200, false), pile(300, false), pile(400, true), pile(500, false)];
        let mut notes = Notes::new();
        let frames = finish(piles, &[], &[100, 200, 300, 400, 500], Path::new("a.json"), &mut notes);
        let times = |frame: &Option<FrameRecord>| {
            let frame = frame.as_ref()?;
            let sweeps: Vec<i64> = frame.sweeps.iter().map(|sweep| sweep.t_us).collect();
            Some((sweeps, frame.between_images.iter().map(|image| image.t_us).collect::<Vec<i64>>()))
        };
        let found: Vec<_> = frames.iter().map(times).collect();
        let last = Some((vec![400_i64, 350, 250, 150], vec![160_i64, 260, 360]));
        assert_eq!(found, [Some((vec![100, 50], vec![60])), None, None, last, None]);
        assert_eq!((notes.counts[NO_DATA], notes.counts[NO_LATER_FRAME]), (3, 2));
    }
}
