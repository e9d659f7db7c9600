//! `sensors/`: sweeps and images. File names are times in nanoseconds.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::poses::{Trajectory, micros, nearest};
use crate::dataset::clock::{Offset, Unit};
use crate::dataset::recording::notes::{NO_IMAGE, NO_SWEEP, Notes, note};
use crate::dataset::{Frame, Gap, ImageRecord, RigCamera, SweepRecord};
use crate::error::FileError;
use crate::geometry::Pose;

/// Maximum time difference between a frame and its image, nanoseconds. Ring cameras run at 20 Hz.
const IMAGE_TOLERANCE_NS: u64 = 50_000_000;

/// Maximum time difference between a frame and its own sweep, nanoseconds: more than 64-bit floats round, and
/// less than the ego or an actor needs to move by a voxel.
const SWEEP_TOLERANCE_NS: u64 = 1_000_000;

/// Kind of a gap: the time of a sweep or an image that has no ego pose.
const NO_POSE_OF_SWEEP: &str = "sweeps without an ego pose";
const NO_POSE_OF_IMAGE: &str = "images without an ego pose";

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

/// Assigns sweeps to frames: the nearest within [`SWEEP_TOLERANCE_NS`] is a frame's own. The others belong to
/// the first frame at or after their time. The own sweep that is missing is a missing file, since its name is
/// known.
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
    let own = own_sweeps(&files, times_ns);
    let frame_of: FxHashMap<usize, usize> =
        own.iter().enumerate().filter_map(|(frame, file)| Some(((*file)?, frame))).collect();
    for (i, Timed { t_ns, path }) in files.into_iter().enumerate() {
        let Some(global_from_ego) = ego.at(t_ns) else {
            notes.gap(Gap::record(NO_POSE_OF_SWEEP, format!("sweep at {t_ns}"), folder));
            continue;
        };
        let own_frame = frame_of.get(&i).copied();
        let place = own_frame.unwrap_or_else(|| times_ns.partition_point(|t| *t < t_ns));
        let Some(frame) = frames.get_mut(place) else {
            note(notes, "sweeps after the last frame", 1);
            continue;
        };
        // Sweeps are stored in the ego frame, with motion compensation.
        let (t_us, ego_from_lidar, is_key) = (micros(t_ns), Pose::IDENTITY, own_frame.is_some());
        frame.sweeps.push(SweepRecord { path, row: None, t_us, global_from_ego, ego_from_lidar, is_key });
    }
    for ((frame, t_ns), own) in frames.iter_mut().zip(times_ns).zip(own) {
        // The frame's own sweep first, then the latest.
        frame.sweeps.sort_by_key(|sweep| (!sweep.is_key, std::cmp::Reverse(sweep.t_us)));
        if own.is_none() {
            notes.gap(Gap::missing(NO_SWEEP, folder.join(format!("{t_ns}.feather"))));
        }
    }
    Ok(())
}

/// Returns for each frame the index of its own sweep: of those that are nearer to it than to other frames,
/// the nearest.
fn own_sweeps(files: &[Timed], times_ns: &[i64]) -> Vec<Option<usize>> {
    let mut own: Vec<Option<usize>> = vec![None; times_ns.len()];
    for (i, file) in files.iter().enumerate() {
        let Some(frame) = nearest(times_ns, file.t_ns, SWEEP_TOLERANCE_NS) else { continue };
        let distance = |i: usize| files[i].t_ns.abs_diff(times_ns[frame]);
        if own[frame].is_none_or(|other| distance(i) < distance(other)) {
            own[frame] = Some(i);
        }
    }
    own
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
    let camera = Arc::new(rig.camera.clone());
    for Timed { t_ns, path } in files {
        let Some(global_from_ego) = ego.at(t_ns) else {
            notes.gap(Gap::record(NO_POSE_OF_IMAGE, format!("image at {t_ns}"), &folder));
            continue;
        };
        let RigCamera { channel, ego_from_camera, .. } = *rig;
        let camera = Arc::clone(&camera);
        let t_us = micros(t_ns);
        let token = format!("{log}_{}_{t_ns}", camera.name);
        let record =
            ImageRecord { token, channel, path, row: None, t_us, global_from_ego, ego_from_camera, camera };
        records.push((t_ns, record));
    }
    // Image names are not known, but the name of their folder is. A log without any such folder has no
    // images.
    let has_folder = folder.is_dir() || !folder.parent().is_some_and(Path::is_dir);
    let missing = |t_us: i64| match has_folder {
        true => Gap::record(NO_IMAGE, format!("frame at {t_us}"), &folder),
        false => Gap::missing(NO_IMAGE, folder.clone()),
    };
    let image_times: Vec<i64> = records.iter().map(|(t_ns, _)| *t_ns).collect();
    let mut frame_of = vec![None; records.len()];
    for (place, t_ns) in times_ns.iter().enumerate() {
        match nearest(&image_times, *t_ns, IMAGE_TOLERANCE_NS) {
            Some(image) if frame_of[image].is_none() => frame_of[image] = Some(place),
            _ => notes.gap(missing(frames[place].t_us)),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the index of the image that is taken at a time.
    fn nearest(times_ns: &[i64], t_ns: i64) -> Option<usize> {
        super::nearest(times_ns, t_ns, IMAGE_TOLERANCE_NS)
    }

    #[test]
    fn the_nearest_sweep_within_a_millisecond_is_the_frames_own() {
        let own = |files: &[i64], frames: &[i64]| {
            let file = |t_ns: &i64| Timed { t_ns: *t_ns, path: PathBuf::new() };
            own_sweeps(&files.iter().map(file).collect::<Vec<_>>(), frames)
        };
        let frames = [100_000_000, 200_000_000];
        assert_eq!(own(&[100_000_001, 199_000_000], &frames), [Some(0), Some(1)]);
        assert_eq!(own(&[98_999_999, 201_000_001], &frames), [None, None]);
        assert_eq!(own(&[99_999_000, 100_000_064, 100_000_900], &frames), [Some(1), None]);
        // Of two frames that are close, the nearer one.
        assert_eq!(own(&[500_000], &[0, 500_000]), [None, Some(0)]);
        assert_eq!(own(&[], &frames), [None, None]);
    }

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
