//! `camera.ID.arrow`: images of a camera, with the pose of each.

use std::sync::Arc;

use super::cells::{CellKind, CellTable};
use super::ego::Ego;
use super::lens;
use super::metadata::{self, CameraMetadata};
use super::nearest::{Assignment, assign};
use super::sync::check_times;
use super::target::{Target, resolve};
use crate::dataset::recording::notes::{NO_IMAGE, Notes, note};
use crate::dataset::tables::ArrowFile;
use crate::dataset::{DatasetError, Gap, ImageRecord, ReadOptions, RigCamera};
use crate::geometry::{Camera, Pose};

/// Table of a camera's images.
pub(super) struct CameraTable {
    pub(super) cells: CellTable,
    pub(super) camera: Arc<Camera>,
    pub(super) ego_from_camera: Pose,
    times_us: Vec<i64>,
    /// Poses of the images; `None` where they follow from the ego's.
    poses: Vec<Option<Pose>>,
}

impl CameraTable {
    /// Opens a table; `None` if the model of the camera is not supported, which is counted.
    ///
    /// # Errors
    /// Fails if the table is damaged, or the camera or a pose is invalid.
    pub(super) fn open(
        file: ArrowFile,
        key: &str,
        ego: &Ego,
        reading: &ReadOptions,
        notes: &mut Notes,
    ) -> Result<Option<Self>, DatasetError> {
        let about: CameraMetadata = metadata::read(&file)?;
        let name = key.rsplit('.').next().unwrap_or(key).to_uppercase();
        let Some(camera) = lens::camera(&name, &about, reading.distortion, file.path(), notes)? else {
            return Ok(None);
        };
        let ego_from_camera = about.ego_from_camera(&file)?;
        let cells = CellTable::new(file, key)?;
        let [time, pose] = ["timestamp_us", "camera_to_global_se3"].map(|name| cells.column(name));
        let table = cells.file.table(&[&time, &pose], &[])?;
        let times_us = table.column(&time)?.integers()?;
        check_times(&times_us, false, cells.file.path())?;
        let mut poses = Vec::with_capacity(times_us.len());
        for (row, values) in table.column(&pose)?.vectors::<7>()?.into_iter().enumerate() {
            let record = || format!("row {row} of column {pose}");
            poses.push(values.map(|values| metadata::pose(values, &record(), &cells.file)).transpose()?);
        }
        let cells = cells.ready()?;
        let mut table = Self { cells, camera: camera.into(), ego_from_camera, times_us, poses };
        table.check_extrinsic(ego, notes);
        Ok(Some(table))
    }

    /// Replaces the mounting pose by the median of the images' own, if they contradict it: some versions of
    /// py123d wrote a wrong one.
    fn check_extrinsic(&mut self, ego: &Ego, notes: &mut Notes) {
        const FAR_M: f64 = 0.5;
        const FAR_DEG: f64 = 5.0;
        let own = self.times_us.iter().zip(&self.poses);
        let own: Vec<Pose> =
            own.filter_map(|(t_us, pose)| Some(ego.at(*t_us)?.inverse() * (*pose)?)).collect();
        let distances = own.iter().map(|pose| (pose.translation - self.ego_from_camera.translation).length());
        let angles = own.iter().map(|pose| pose.rotation.angle_between(self.ego_from_camera.rotation));
        let is_far = |median: Option<f64>, most: f64| median.is_some_and(|median| median > most);
        if is_far(median(distances), FAR_M) || is_far(median(angles), FAR_DEG.to_radians()) {
            note(
                notes,
                "cameras whose mounting pose contradicts their images' poses (the latter are used)",
                1,
            );
            self.ego_from_camera = median_pose(&own, self.ego_from_camera);
        }
    }

    /// Adds the images to the frames.
    ///
    /// # Errors
    /// Fails if `sync` names a row that does not exist, or a path leads out of its folder.
    pub(super) fn add_images(
        &self,
        channel: usize,
        target: &mut Target<'_>,
        notes: &mut Notes,
    ) -> Result<(), DatasetError> {
        let named = target.sync.rows(&self.cells.key, self.cells.file.rows())?;
        let named: Vec<Option<usize>> = target.rows.iter().map(|row| named[*row]).collect();
        let names = self.cells.names()?;
        let times_us: Vec<i64> = target.frames.iter().map(|frame| frame.t_us).collect();
        for (row, place) in assign(&self.times_us, &named, &times_us).into_iter().enumerate() {
            let record = self.record(row, channel, target, &names)?;
            let frames = &mut *target.frames;
            let Some(record) = record else {
                note(notes, "images without data or pose", 1);
                continue;
            };
            match place {
                Assignment::Frames(places) => {
                    places.into_iter().for_each(|place| frames[place].images.push(record.clone()));
                }
                Assignment::Before(place) => frames[place].between_images.push(record),
                Assignment::Beyond => note(notes, "images after the last frame", 1),
            }
        }
        for frame in
            target.frames.iter().filter(|frame| frame.images.iter().all(|image| image.channel != channel))
        {
            let record = format!("{} in the frame at {}", self.camera.name, frame.t_us);
            notes.gap(Gap::record(NO_IMAGE, record, self.cells.file.path()));
        }
        Ok(())
    }

    /// Returns the record of a row; `None` if it has no file, or no pose is known.
    fn record(
        &self,
        row: usize,
        channel: usize,
        target: &Target<'_>,
        names: &[Option<String>],
    ) -> Result<Option<ImageRecord>, DatasetError> {
        let t_us = self.times_us[row];
        let pose = self.poses[row].map(|pose| pose * self.ego_from_camera.inverse());
        let Some(global_from_ego) = pose.or_else(|| target.ego.at(t_us)) else { return Ok(None) };
        let table = self.cells.file.path();
        let (path, row) = match (self.cells.kind, target.root, &names[row]) {
            (CellKind::Path, Some(root), Some(name)) => (resolve(root, name, row, table)?, None),
            (CellKind::Path, ..) => return Ok(None),
            (CellKind::Bytes, ..) => (table.to_owned(), u32::try_from(row).ok()),
            (CellKind::Video, ..) => (table.with_extension("mp4"), u32::try_from(row).ok()),
        };
        let (camera, ego_from_camera) = (Arc::clone(&self.camera), self.ego_from_camera);
        let token = format!("{}_{}_{t_us}", target.sync.about.log_name, camera.name);
        Ok(Some(ImageRecord { token, channel, path, row, t_us, global_from_ego, ego_from_camera, camera }))
    }

    /// Returns the camera for the rig.
    pub(super) fn rig(&self, channel: usize) -> RigCamera {
        RigCamera { channel, ego_from_camera: self.ego_from_camera, camera: Camera::clone(&self.camera) }
    }
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Returns the median of each coordinate, and of each component of the quaternions that are nearest to the
/// first one, normalized.
fn median_pose(poses: &[Pose], otherwise: Pose) -> Pose {
    let Some(first) = poses.first().map(|pose| pose.rotation) else { return otherwise };
    let of = |value: &dyn Fn(&Pose) -> f64| median(poses.iter().map(value)).unwrap_or_default();
    let near = |pose: &Pose| if pose.rotation.dot(first) < 0.0 { -pose.rotation } else { pose.rotation };
    let translation = [0, 1, 2].map(|axis| of(&|pose| pose.translation[axis]));
    let [x, y, z, w] = [0, 1, 2, 3].map(|part| of(&|pose| near(pose).to_array()[part]));
    let length = (w * w + x * x + y * y + z * z).sqrt();
    Pose::from_wxyz([w, x, y, z].map(|part| part / length), translation).unwrap_or(otherwise)
}
