//! `ego_state_se3.arrow`: poses of the ego frame, which py123d calls IMU.

use super::metadata;
use super::sync::{Sync, check_times};
use crate::dataset::DatasetError;
use crate::dataset::tables::ArrowFile;
use crate::error::FileError;
use crate::files::input::is_there;
use crate::geometry::Pose;

pub(super) const KEY: &str = "ego_state_se3";

/// Poses of the ego in order of time.
pub(super) struct Ego {
    times_us: Vec<i64>,
    poses: Vec<Pose>,
    /// Row of each frame.
    rows: Vec<Option<usize>>,
}

impl Ego {
    /// Reads the poses; none if the log has no such table.
    ///
    /// # Errors
    /// Fails if the table is damaged, a pose is invalid, or times decrease.
    pub(super) fn read(log: &std::path::Path, sync: &Sync) -> Result<Self, DatasetError> {
        let path = log.join(format!("{KEY}.arrow"));
        if !is_there(&path)? {
            let rows = vec![None; sync.times_us.len()];
            return Ok(Self { times_us: Vec::new(), poses: Vec::new(), rows });
        }
        let file = ArrowFile::open(&path)?;
        let [time, imu] = [format!("{KEY}.timestamp_us"), format!("{KEY}.imu_se3")];
        let table = file.table(&[&time, &imu], &[])?;
        let times_us = table.column(&time)?.integers()?;
        check_times(&times_us, false, &path)?;
        let mut poses = Vec::with_capacity(times_us.len());
        for (row, values) in table.column(&imu)?.vectors::<7>()?.into_iter().enumerate() {
            let record = format!("row {row} of column {imu}");
            let values =
                values.ok_or_else(|| FileError::content("a pose", format!("none in {record}"), &path))?;
            poses.push(metadata::pose(values, &record, &file)?);
        }
        let rows = sync.rows(KEY, file.rows())?;
        Ok(Self { times_us, poses, rows })
    }

    /// Returns the pose in which the sweep of a frame is stored, which was completed at a time; `None` if
    /// there is none for the frame.
    ///
    /// A table of many more poses than frames is interpolated: py123d names the pose at or after the frame,
    /// and misses the exact one where times were rounded. In other tables the named pose is that of the
    /// sweep, whatever its own time is: in PandaSet it is that of the front camera, 50 ms later.
    pub(super) fn of_frame(&self, frame: usize, t_us: i64) -> Option<Pose> {
        let is_dense = self.poses.len() >= 2 * self.rows.len();
        let is_within = self.times_us.first().is_some_and(|first| *first <= t_us)
            && self.times_us.last().is_some_and(|last| t_us <= *last);
        if is_dense && is_within {
            return self.at(t_us);
        }
        self.rows[frame].map(|row| self.poses[row])
    }

    /// Returns the pose at any time, interpolated; the first or last one beyond the ends. `None` without
    /// poses.
    pub(super) fn at(&self, t_us: i64) -> Option<Pose> {
        let next = self.times_us.partition_point(|time| *time < t_us);
        let (Some(after), Some(before)) = (self.poses.get(next), next.checked_sub(1)) else {
            return self.poses.get(next).or(self.poses.last()).copied();
        };
        let (start, end) = (self.times_us[before], self.times_us[next]);
        let share = (t_us - start) as f64 / (end - start) as f64;
        Some(self.poses[before].interpolate(after, share))
    }
}
