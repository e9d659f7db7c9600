//! `city_SE3_egovehicle.feather`: ego poses at the times of all sensors.

use std::path::Path;

use crate::dataset::DatasetError;
use crate::dataset::clock::Unit;
use crate::dataset::tables::{ArrowFile, Table};
use crate::error::FileError;
use crate::geometry::Pose;

/// Pose columns.
pub(super) const POSE: [&str; 7] = ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"];

/// `city_from_ego` over time.
pub(super) struct Trajectory {
    /// Nanoseconds, ascending.
    times_ns: Vec<i64>,
    poses: Vec<Pose>,
}

impl Trajectory {
    /// Reads and validates the file.
    ///
    /// # Errors
    /// Fails if the file is damaged or has no poses, times do not increase, or a pose is invalid.
    pub(super) fn read(path: &Path) -> Result<Self, DatasetError> {
        let table = ArrowFile::read(path)?.table(&[&["timestamp_ns"], &POSE[..]].concat(), &[])?;
        let times_ns = table.column("timestamp_ns")?.integers()?;
        if times_ns.is_empty() {
            return Err(FileError::content("at least one ego pose", "none", path).into());
        }
        if let Some(i) = times_ns.windows(2).position(|w| w[0] >= w[1]) {
            let hint = Unit::NANOS.hint(micros(times_ns[i]) as f64);
            let found = format!("{} after {} in row {}{hint}", times_ns[i + 1], times_ns[i], i + 1);
            return Err(FileError::content("timestamps that grow from row to row", found, path).into());
        }
        let poses = poses(&table, |row| format!("row {row}"))?;
        Ok(Self { times_ns, poses })
    }

    /// Returns the first and last time, microseconds.
    pub(super) fn span_us(&self) -> [i64; 2] {
        let ends = self.times_ns.first().zip(self.times_ns.last());
        ends.map_or([0; 2], |(first, last)| [micros(*first), micros(*last)])
    }

    /// Returns the pose at a time, interpolated between rows if necessary. `None` outside the recorded times.
    pub(super) fn at(&self, t_ns: i64) -> Option<Pose> {
        let next = self.times_ns.partition_point(|t| *t < t_ns);
        let after = *self.times_ns.get(next)?;
        if after == t_ns {
            return Some(self.poses[next]);
        }
        let before = self.times_ns[next.checked_sub(1)?];
        let s = t_ns.abs_diff(before) as f64 / after.abs_diff(before) as f64;
        Some(self.poses[next - 1].interpolate(&self.poses[next], s))
    }
}

/// Reads the poses in the columns [`POSE`], row by row; `record` names a row in messages.
pub(super) fn poses(table: &Table, record: impl Fn(usize) -> String) -> Result<Vec<Pose>, DatasetError> {
    let mut columns = Vec::with_capacity(POSE.len());
    for name in POSE {
        columns.push(table.column(name)?.numbers()?);
    }
    let pose = |row: usize| {
        let value = |column: usize| columns[column][row];
        Pose::from_wxyz(std::array::from_fn(value), std::array::from_fn(|i| value(4 + i))).map_err(|source| {
            DatasetError::Pose { source, record: record(row), path: table.path().to_owned() }
        })
    };
    (0..table.rows()).map(pose).collect()
}

/// Returns the index of the nearest time within a tolerance; `times` ascend, all in nanoseconds. Ties go to
/// the earlier one.
pub(super) fn nearest(times_ns: &[i64], t_ns: i64, tolerance_ns: u64) -> Option<usize> {
    let next = times_ns.partition_point(|t| *t < t_ns);
    let candidates = next.saturating_sub(1)..times_ns.len().min(next + 1);
    let best = candidates.min_by_key(|i| times_ns[*i].abs_diff(t_ns))?;
    (times_ns[best].abs_diff(t_ns) <= tolerance_ns).then_some(best)
}

/// Converts nanoseconds to whole microseconds.
pub(super) fn micros(t_ns: i64) -> i64 {
    t_ns.div_euclid(1000)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn poses_between_rows_lie_between() {
        let pose = |x: f64| Pose::from_yaw(0.0, DVec3::new(x, 0.0, 0.0));
        let ego =
            Trajectory { times_ns: vec![1_000, 2_000, 4_000], poses: vec![pose(0.0), pose(1.0), pose(5.0)] };
        let x = |t_ns: i64| ego.at(t_ns).map(|p| p.translation.x);
        assert_eq!([x(1_000), x(2_000), x(4_000)], [Some(0.0), Some(1.0), Some(5.0)]);
        assert_eq!([x(1_500), x(2_500)], [Some(0.5), Some(2.0)]);
        assert_eq!([x(999), x(4_001)], [None, None]);
    }
}
