//! Images: each frame gets the nearest one of every camera.
//!
//! Cameras run at 10 Hz and the LiDAR at 20 Hz, so an image may belong to two frames.

use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::clocks::check_sweeps;
use super::database::{Database, Query, Row, hex};
use super::frames::{POSE_COLUMNS, ego_pose, extrinsics, unpickled};
use super::pickle;
use super::place::LogPaths;
use crate::dataset::clock::{Offset, Unit};
use crate::dataset::limits::MAX_CAMERAS;
use crate::dataset::recording::notes::{DANGLING_DATA, NO_IMAGE, Notes, note};
use crate::dataset::{DatasetError, Gap, ImageDistortion, ImageRecord, RigCamera};
use crate::error::FileError;
use crate::files::first_twice;
use crate::geometry::{Camera, Distortion, LensModel, Pose};

/// Maximum time difference between a frame and its image, microseconds: half the image interval, plus half of
/// that for uneven clocks.
const TOLERANCE_US: u64 = 75_000;

/// The eight cameras in ring order, each next to its neighbors.
const RING: [&str; 8] = ["CAM_F0", "CAM_R0", "CAM_R1", "CAM_R2", "CAM_B0", "CAM_L2", "CAM_L1", "CAM_L0"];

/// Note for images after the last frame, or more than the tolerance outside the frames' time range.
const OUTSIDE: &str = "images outside of the frames' time";

/// Note for cameras without distortion coefficients.
const NO_LENS: &str = "cameras without distortion (NULL), whose images are read as rectified";

/// Cameras, and their images per frame.
pub(super) struct CameraImages {
    /// In ring order.
    pub(super) rig: Vec<RigCamera>,
    pub(super) frames: Vec<FrameImages>,
}

/// Images of a frame.
#[derive(Clone, Default)]
pub(super) struct FrameImages {
    pub(super) images: Vec<ImageRecord>,
    pub(super) between_images: Vec<ImageRecord>,
}

/// Row of `camera`.
struct RawCamera {
    token: Vec<u8>,
    ego_from_camera: Pose,
    camera: Arc<Camera>,
}

/// Row of `image`.
struct RawImage {
    record: ImageRecord,
    is_used: bool,
}

/// Times of the frames to which images belong.
pub(super) struct FrameTimes<'a> {
    /// Ascending.
    pub(super) times_us: &'a [i64],
    /// First and last time of the whole log.
    pub(super) span_us: [i64; 2],
    /// Whether the frames are the whole log, so that images outside of their time are counted.
    pub(super) is_whole: bool,
}

/// Reads the cameras and the images of frames.
pub(super) fn read(
    database: &Database,
    place: &LogPaths,
    within: &FrameTimes<'_>,
    distortion: ImageDistortion,
    notes: &mut Notes,
) -> Result<CameraImages, DatasetError> {
    let FrameTimes { times_us, is_whole, .. } = *within;
    let cameras = cameras(database, distortion, notes)?;
    let mut frames = vec![FrameImages::default(); times_us.len()];
    let (mut images, outside) = images(database, place, &cameras, within, notes)?;
    note(notes, OUTSIDE, if is_whole { outside } else { 0 });
    for (channel, camera) in images.iter_mut().zip(&cameras) {
        for (frame, t_us) in frames.iter_mut().zip(times_us) {
            match nearest(channel, *t_us) {
                None => {
                    let record = format!("{} of the frame at {t_us}", camera.camera.name);
                    notes.gap(Gap::record(NO_IMAGE, record, database.path()));
                }
                Some(image) => {
                    image.is_used = true;
                    frame.images.push(image.record.clone());
                }
            }
        }
    }
    for image in images.into_iter().flatten().filter(|image| !image.is_used) {
        match frames.get_mut(times_us.partition_point(|t| *t < image.record.t_us)) {
            Some(frame) => frame.between_images.push(image.record),
            None => note(notes, OUTSIDE, usize::from(is_whole)),
        }
    }
    frames.iter_mut().for_each(|f| f.between_images.sort_by_key(|i| (i.t_us, i.channel)));
    let rig = |(channel, RawCamera { ego_from_camera, camera, .. }): (usize, &RawCamera)| RigCamera {
        channel,
        ego_from_camera: *ego_from_camera,
        camera: Camera::clone(camera),
    };
    Ok(CameraImages { rig: cameras.iter().enumerate().map(rig).collect(), frames })
}

/// Returns the image nearest to a time, within the tolerance. Ties go to the earlier one.
fn nearest(images: &mut [RawImage], t_us: i64) -> Option<&mut RawImage> {
    let place = nearest_time(images, t_us, |image| image.record.t_us)?;
    images.get_mut(place)
}

fn nearest_time<T>(sorted: &[T], t_us: i64, time: impl Fn(&T) -> i64) -> Option<usize> {
    let next = sorted.partition_point(|item| time(item) < t_us);
    let near = [next.checked_sub(1), Some(next)].into_iter().flatten().filter(|i| *i < sorted.len());
    let best = near.min_by_key(|i| time(&sorted[*i]).abs_diff(t_us))?;
    (time(&sorted[best]).abs_diff(t_us) <= TOLERANCE_US).then_some(best)
}

/// Reads the cameras in ring order; others follow by name.
fn cameras(
    database: &Database,
    distortion: ImageDistortion,
    notes: &mut Notes,
) -> Result<Vec<RawCamera>, DatasetError> {
    let columns =
        &["token", "translation", "rotation", "channel", "intrinsic", "distortion", "width", "height"];
    let mut cameras = Vec::new();
    database.rows(&Query { table: "camera", columns, from: "FROM camera" }, |row| {
        let (token, ego_from_camera) = (row.blob(0)?.to_owned(), extrinsics(row, 1, database)?);
        note(notes, NO_LENS, usize::from(row.is_null(5)));
        cameras.push(RawCamera { token, ego_from_camera, camera: camera(row, distortion, database)?.into() });
        Ok(())
    })?;
    if cameras.len() > MAX_CAMERAS {
        let expected = format!("at most {MAX_CAMERAS} rows in camera");
        return Err(FileError::content(expected, cameras.len().to_string(), database.path()).into());
    }
    let place = |camera: &RawCamera| RING.iter().position(|r| camera.camera.name == *r).unwrap_or(RING.len());
    cameras.sort_by(|a, b| place(a).cmp(&place(b)).then_with(|| a.camera.name.cmp(&b.camera.name)));
    if let Some(name) = first_twice(cameras.iter().map(|camera| &camera.camera.name)) {
        let found = format!("two of {name}");
        return Err(FileError::content("one row in camera for a channel", found, database.path()).into());
    }
    Ok(cameras)
}

/// Returns size, intrinsics and distortion from a `camera` row. Coefficients are not read if the images are
/// rectified.
fn camera(row: &Row<'_>, option: ImageDistortion, database: &Database) -> Result<Camera, DatasetError> {
    let rows = unpickled(row, 4, "a pickled 3x3 matrix", pickle::Value::matrix)?;
    let is_rectified = row.is_null(5) || option == ImageDistortion::Ignore;
    let distortion = if is_rectified { [0.0; 5] } else { coefficients(row)? };
    let side = |column: usize| {
        let number = row.number(column)?;
        let whole = number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number);
        if whole { Ok(number as u32) } else { Err(row.wrong(column, "whole pixels", &number.to_string())) }
    };
    let camera = Camera::new(row.text(3)?, side(6)?, side(7)?, rows).map_err(|source| {
        DatasetError::Camera { source, record: row.name(), path: database.path().to_owned() }
    })?;
    // The column has OpenCV's order, k1 k2 p1 p2 k3.
    Ok(Camera { lens: LensModel::from_opencv(distortion), ..camera })
}

/// Returns the distortion coefficients from a `camera` row: `k1 k2 p1 p2`, then `k3` or further zeros.
fn coefficients(row: &Row<'_>) -> Result<[f64; 5], DatasetError> {
    const EXPECTED: &str = "a pickled list of 4 or 5 numbers";
    let all = unpickled(row, 5, EXPECTED, |value| value.numbers().filter(|all| all.len() >= 4))?;
    if !all.iter().all(|v| v.is_finite()) {
        return Err(row.wrong(5, "finite numbers", &format!("{all:?}")));
    }
    Distortion::first_five(&all).ok_or_else(|| row.wrong(5, EXPECTED, &format!("{all:?}")))
}

/// Reads the images of each camera in time order, if they are within the tolerance of the frames' time range.
/// Also returns the number of other images.
fn images(
    database: &Database,
    place: &LogPaths,
    cameras: &[RawCamera],
    within: &FrameTimes<'_>,
    notes: &mut Notes,
) -> Result<(Vec<Vec<RawImage>>, usize), DatasetError> {
    let times_us = within.times_us;
    let channels: FxHashMap<&[u8], usize> =
        cameras.iter().enumerate().map(|(i, camera)| (camera.token.as_slice(), i)).collect();
    let ends = times_us.first().zip(times_us.last());
    let near = |t_us: i64| {
        ends.is_some_and(|(a, b)| {
            (*a..=*b).contains(&t_us) || a.abs_diff(t_us).min(b.abs_diff(t_us)) <= TOLERANCE_US
        })
    };
    let mut columns = vec![
        "image.token",
        "image.timestamp",
        "image.camera_token",
        "image.filename_jpg",
        "image.ego_pose_token",
        "ego_pose.token",
    ];
    columns.extend(POSE_COLUMNS);
    let from = "FROM image LEFT JOIN ego_pose ON ego_pose.token = image.ego_pose_token \
        ORDER BY image.timestamp, image.token";
    let mut images: Vec<Vec<RawImage>> = cameras.iter().map(|_| Vec::new()).collect();
    let mut outside = 0;
    let mut clocks: Vec<ImageClock> = cameras.iter().map(|_| ImageClock::default()).collect();
    database.rows(&Query { table: "image", columns: &columns, from }, |row| {
        let (t_us, token) = (row.time_us(1)?, row.reference(2)?);
        let Some(channel) = token.and_then(|token| channels.get(token)).copied() else {
            if near(t_us) {
                notes.gap(row.dangling(DANGLING_DATA, "camera", token));
            }
            return Ok(());
        };
        if images[channel].last().is_some_and(|last| last.record.t_us == t_us) {
            let hint = Unit::MICROS.hint(t_us as f64);
            let found = format!("{t_us} twice, {}{hint}", cameras[channel].camera.name);
            return Err(row.wrong(1, "timestamps that grow from image to image", &found));
        }
        clocks[channel].add(t_us, row.blob(0)?);
        if near(t_us) {
            match record(row, channel, &cameras[channel], place, database)? {
                Some(record) => images[channel].push(RawImage { record, is_used: false }),
                None => notes.gap(row.dangling(DANGLING_DATA, "ego_pose", row.reference(4)?)),
            }
        } else {
            outside += 1;
        }
        Ok(())
    })?;
    for (camera, clock) in cameras.iter().zip(clocks) {
        clock.check(&camera.camera.name, within.span_us, database)?;
    }
    Ok((images, outside))
}

/// First and last image of a camera.
#[derive(Default)]
struct ImageClock {
    ends: Option<[(i64, Vec<u8>); 2]>,
}

impl ImageClock {
    /// Adds an image; images arrive in time order.
    fn add(&mut self, t_us: i64, token: &[u8]) {
        let image = (t_us, token.to_owned());
        match &mut self.ends {
            None => self.ends = Some([image.clone(), image]),
            Some([_, last]) => *last = image,
        }
    }

    /// Fails if the images are from another time than the sweeps of the log.
    fn check(&self, name: &str, span_us: [i64; 2], database: &Database) -> Result<(), DatasetError> {
        let Some([first, last]) = &self.ends else { return Ok(()) };
        let times = [first.0, last.0];
        let Some(offset) = Offset::of_all(times.into_iter(), span_us, Unit::MICROS) else { return Ok(()) };
        check_sweeps(database, span_us, times)?;
        let token = hex(&first.1);
        let expected = format!("images of {name} within a second of the log's lidar_pc");
        Err(FileError::content(expected, format!("image {token} {offset}"), database.path()).into())
    }
}

/// Returns the record of a row's image; `None` if its ego pose is missing.
fn record(
    row: &Row<'_>,
    channel: usize,
    camera: &RawCamera,
    place: &LogPaths,
    database: &Database,
) -> Result<Option<ImageRecord>, DatasetError> {
    let Some(global_from_ego) = ego_pose(row, 4, database)? else { return Ok(None) };
    let (t_us, name) = (row.time_us(1)?, row.text(3)?);
    let path = place.sensors.resolve(name).map_err(|error| row.wrong(3, &error.expected, &error.found))?;
    let (ego_from_camera, camera) = (camera.ego_from_camera, Arc::clone(&camera.camera));
    let token = hex(row.blob(0)?);
    Ok(Some(ImageRecord { token, channel, path, row: None, t_us, global_from_ego, ego_from_camera, camera }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the time of the image that is taken at each of some times.
    fn taken<const N: usize>(images: &[i64], times: [i64; N]) -> [Option<i64>; N] {
        times.map(|t_us| nearest_time(images, t_us, |t| *t).map(|place| images[place]))
    }

    #[test]
    fn the_nearest_image_within_the_tolerance_is_taken() {
        let images = [0, 100_000, 200_000];
        assert_eq!(taken(&images, [-75_000, -75_001, 0, 49_999]), [Some(0), None, Some(0), Some(0)]);
        assert_eq!(taken(&images, [50_000, 50_001, 150_000]), [Some(0), Some(100_000), Some(100_000)]);
        assert_eq!(taken(&images, [275_000, 275_001]), [Some(200_000), None]);
        assert_eq!(taken(&[], [0]), [None]);
    }

    /// Cameras at about 10 Hz and a LiDAR at 20 Hz, with any offset between their clocks.
    #[test]
    fn every_frame_has_an_image_despite_uneven_clocks() {
        let images = [0, 101_000, 199_000];
        let frames = |first_us: i64| std::array::from_fn::<i64, 5, _>(|i| first_us + i as i64 * 50_000);
        let even = [0, 0, 101_000, 101_000, 199_000].map(Some);
        assert_eq!(taken(&images, frames(0)), even);
        // With an offset of 0.4 ms, the second frame is 50.4 ms from the image before and 50.6 ms from the
        // next.
        let late = [0, 0, 101_000, 199_000, 199_000].map(Some);
        assert_eq!(taken(&images, frames(400)), late);
    }
}
