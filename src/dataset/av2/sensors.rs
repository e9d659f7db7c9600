//! `sensors/`: sweeps and images. File names are times in nanoseconds.

use std::path::{Path, PathBuf};

use super::poses::{Trajectory, micros};
use crate::dataset::clock::{Offset, Unit};
use crate::dataset::notes::{NO_IMAGE, NO_SWEEP, Notes, note};
use crate::dataset::{Frame, Gap, ImageRecord, RigCamera, SweepRecord};
use crate::error::FileError;
use crate::geometry::Pose;

/// Maximum time difference between a frame and its image, nanoseconds. Ring cameras run at 20 Hz.
const IMAGE_TOLERANCE_NS: u64 = 50_000_000;

/// File named by its time.
struct Timed {
    t_ns: i64,
    path: PathBuf,
}

/// Lists the files of a sensor by time; empty if the folder does not exist. Counts files with other names.
fn list(folder: &Path, extensions: &[&str], notes: &mut Notes) -> Result<Vec<Timed>, FileError> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
        let path = entry.map_err(FileError::io("read", folder))?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let time = path.file_stem().and_then(|name| name.to_str()?.parse().ok());
        match time {
            Some(t_ns) if extensions.contains(&extension) => files.push(Timed { t_ns, path }),
            _ => note(notes, "sensor files without a time for a name", 1),
        }
    }
    files.sort_by(|a, b| (a.t_ns, &a.path).cmp(&(b.t_ns, &b.path)));
    Ok(files)
}

/// Returns the times of the sweeps in a folder, nanoseconds.
///
/// # Errors
/// Fails if the folder cannot be read.
pub(super) fn times_ns(folder: &Path) -> Result<Vec<i64>, FileError> {
    Ok(list(folder, &["feather"], &mut Notes::new())?.iter().map(|file| file.t_ns).collect())
}

/// Assigns sweeps to frames: each belongs to the first frame at or after its time.
///
/// # Errors
/// Fails if the folder cannot be read.
pub(super) fn add_sweeps(
    folder: &Path,
    times_ns: &[i64],
    ego: &Trajectory,
    frames: &mut [Frame],
    notes: &mut Notes,
) -> Result<(), FileError> {
    let files = list(folder, &["feather"], notes)?;
    check_clock(&files, "sweeps", times_ns)?;
    for Timed { t_ns, path } in files {
        let place = times_ns.partition_point(|t| *t < t_ns);
        let (Some(frame), Some(global_from_ego)) = (frames.get_mut(place), ego.at(t_ns)) else {
            note(notes, "sweeps after the last frame or without an ego pose", 1);
            continue;
        };
        let (t_us, is_key) = (micros(t_ns), times_ns[place] == t_ns);
        // Sweeps are stored in the ego frame, with motion compensation.
        let ego_from_lidar = Pose::IDENTITY;
        // Sweeps arrive in time order, so the frame's own ends up first, then the latest.
        let record = SweepRecord { path, t_us, global_from_ego, ego_from_lidar, is_key };
        frame.sweeps.insert(0, record);
    }
    for frame in frames.iter().filter(|frame| !frame.sweeps.first().is_some_and(|sweep| sweep.is_key)) {
        notes.gap(Gap::record(NO_SWEEP, format!("frame at {}", frame.t_us), folder));
    }
    Ok(())
}

/// Assigns a camera's images to frames: the nearest in time to each frame, the others between frames.
///
/// # Errors
/// Fails if the folder cannot be read.
pub(super) fn add_images(
    folder: &Path,
    log: &str,
    times_ns: &[i64],
    ego: &Trajectory,
    rig: &RigCamera,
    frames: &mut [Frame],
    notes: &mut Notes,
) -> Result<(), FileError> {
    let (mut records, folder) = (Vec::new(), folder.join(&rig.camera.name));
    let files = list(&folder, &["jpg", "jpeg", "png"], notes)?;
    check_clock(&files, "images", times_ns)?;
    for Timed { t_ns, path } in files {
        let Some(global_from_ego) = ego.at(t_ns) else {
            note(notes, "images without an ego pose", 1);
            continue;
        };
        let RigCamera { channel, ego_from_camera, camera } = rig.clone();
        let t_us = micros(t_ns);
        let token = format!("{log}_{}_{t_ns}", camera.name);
        let record = ImageRecord { token, channel, path, t_us, global_from_ego, ego_from_camera, camera };
        records.push((t_ns, record));
    }
    let image_times: Vec<i64> = records.iter().map(|(t_ns, _)| *t_ns).collect();
    let mut frame_of = vec![None; records.len()];
    for (place, t_ns) in times_ns.iter().enumerate() {
        match nearest(&image_times, *t_ns) {
            Some(image) if frame_of[image].is_none() => frame_of[image] = Some(place),
            _ => notes.gap(Gap::record(NO_IMAGE, format!("frame at {}", frames[place].t_us), &folder)),
        }
    }
    for ((t_ns, record), own) in records.into_iter().zip(frame_of) {
        let interval = times_ns.partition_point(|t| *t < t_ns);
        match (own, frames.get_mut(interval)) {
            (Some(place), _) => frames[place].images.push(record),
            (None, Some(frame)) => frame.between_images.push(record),
            (None, None) => note(notes, "images after the last frame", 1),
        }
    }
    Ok(())
}

/// Fails if the files of a sensor are from another time than the annotations.
fn check_clock(files: &[Timed], kind: &str, times_ns: &[i64]) -> Result<(), FileError> {
    let Some((first, last)) = times_ns.first().zip(times_ns.last()) else { return Ok(()) };
    let times = files.iter().map(|file| micros(file.t_ns));
    let offset = Offset::of_all(times, [micros(*first), micros(*last)], Unit::NANOS);
    let Some((offset, file)) = offset.zip(files.first()) else { return Ok(()) };
    let expected = format!("{kind} within a second of the annotated times");
    Err(FileError::content(expected, format!("the first one {offset}"), &file.path))
}

/// Returns the index of the nearest of ascending times within [`IMAGE_TOLERANCE_NS`]. Ties go to the earlier one.
fn nearest(times_ns: &[i64], t_ns: i64) -> Option<usize> {
    let next = times_ns.partition_point(|t| *t < t_ns);
    let candidates = next.saturating_sub(1)..times_ns.len().min(next + 1);
    let best = candidates.min_by_key(|i| times_ns[*i].abs_diff(t_ns))?;
    (times_ns[best].abs_diff(t_ns) <= IMAGE_TOLERANCE_NS).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_image_is_taken_within_the_tolerance() {
        let ms = |v: i64| v * 1_000_000;
        let times = [ms(0), ms(40), ms(200)];
        assert_eq!(
            [nearest(&times, ms(19)), nearest(&times, ms(20)), nearest(&times, ms(21))],
            [Some(0), Some(0), Some(1)]
        );
        assert_eq!([nearest(&times, ms(90)), nearest(&times, ms(91))], [Some(1), None]);
        assert_eq!(
            [nearest(&times, ms(149)), nearest(&times, ms(150)), nearest(&times, ms(250))],
            [None, Some(2), Some(2)]
        );
        assert_eq!(
            [nearest(&times, ms(-50)), nearest(&times, ms(251)), nearest(&[], 0)],
            [Some(0), None, None]
        );
        assert_eq!([micros(1_999), micros(-1)], [1, -1]);
    }
}
