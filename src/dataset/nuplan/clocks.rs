//! Times of sweeps and images, compared with the ego poses that they refer to.

use super::database::{Database, Query, hex};
use crate::dataset::DatasetError;
use crate::dataset::clock::{Offset, PoseTimes, Unit};
use crate::dataset::recording::notes::Notes;
use crate::error::FileError;

/// Counts the poses that are not from the time of their sweep or image. The tables link them, so they are
/// used nevertheless.
pub(super) fn note_pose_times(database: &Database, notes: &mut Notes) -> Result<(), DatasetError> {
    if !database.has_column("ego_pose", "timestamp")? {
        return Ok(());
    }
    let mut times = PoseTimes::default();
    let columns = &["lidar_pc.token", "lidar_pc.timestamp", "ego_pose.timestamp", "ego_pose.token"];
    let from = "FROM lidar_pc JOIN ego_pose ON ego_pose.token = lidar_pc.ego_pose_token \
        ORDER BY lidar_pc.timestamp, lidar_pc.token";
    database.rows(&Query { table: "lidar_pc", columns, from }, |row| {
        if let (Ok(sweep_us), Ok(pose_us)) = (row.time_us(1), row.integer(2)) {
            let token = || row.blob(3).map(hex).unwrap_or_default();
            times.compare(pose_us, sweep_us, || ["lidar_pc".to_owned(), token()]);
        }
        Ok(())
    })?;
    let columns =
        &["image.token", "image.timestamp", "ego_pose.timestamp", "ego_pose.token", "camera.channel"];
    let from = "FROM image JOIN ego_pose ON ego_pose.token = image.ego_pose_token \
        JOIN camera ON camera.token = image.camera_token ORDER BY image.timestamp, image.token";
    database.rows(&Query { table: "image", columns, from }, |row| {
        if let (Ok(image_us), Ok(pose_us)) = (row.time_us(1), row.integer(2)) {
            let token = || row.blob(3).map(hex).unwrap_or_default();
            times.compare(pose_us, image_us, || [row.text(4).unwrap_or_default().to_owned(), token()]);
        }
        Ok(())
    })?;
    times.note(notes);
    Ok(())
}

/// Checks sweeps, given as their first and last time, that differ from some images: if only the images have
/// the clock of the ego poses, then the sweeps are wrong.
///
/// # Errors
/// Fails with the offset of the sweeps if they are wrong.
pub(super) fn check_sweeps(
    database: &Database,
    sweeps_us: [i64; 2],
    images_us: [i64; 2],
) -> Result<(), DatasetError> {
    if !database.has_column("ego_pose", "timestamp")? {
        return Ok(());
    }
    let mut poses_us = None;
    let columns = &["min(timestamp)", "max(timestamp)"];
    database.rows(&Query { table: "ego_pose", columns, from: "FROM ego_pose" }, |row| {
        poses_us = row.integer(0).ok().zip(row.integer(1).ok());
        Ok(())
    })?;
    let Some((first, last)) = poses_us else { return Ok(()) };
    let offset = |times: [i64; 2]| Offset::of_all(times.into_iter(), [first, last], Unit::MICROS);
    match (offset(sweeps_us), offset(images_us)) {
        (Some(sweeps), None) => {
            let expected = "sweeps within a second of the log's ego poses and images";
            let found = format!("lidar_pc at {}, {sweeps}", sweeps_us[0]);
            Err(FileError::content(expected, found, database.path()).into())
        }
        _ => Ok(()),
    }
}
