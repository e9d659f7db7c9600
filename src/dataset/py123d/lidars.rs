//! `lidar.ID.arrow`: sweeps of one LiDAR, or of several that are merged.

use std::cmp::Reverse;

use super::cells::{CellKind, CellTable};
use super::files::PointFiles;
use super::metadata::{self, SweepMetadata};
use super::sync::{Sync, check_times};
use super::target::{Target, resolve};
use crate::dataset::recording::notes::{NO_SWEEP, Notes, note};
use crate::dataset::tables::ArrowFile;
use crate::dataset::{DatasetError, Gap, SweepRecord};
use crate::error::FileError;
use crate::files::input::DataRoot;
use crate::geometry::Pose;

/// Table of sweeps.
pub(super) struct LidarTable {
    pub(super) cells: CellTable,
    /// Ids of merged LiDARs in ascending order; the first one is LiDAR 0 of a sweep.
    pub(super) ids: Vec<u8>,
    /// Times of the ego poses in which sweeps are stored.
    times_us: Vec<i64>,
    /// Whether sweeps are in the ego frame at their end, as in nuScenes; otherwise at their nominal time,
    /// which is that of the frame.
    is_placed_by_end: bool,
    /// Mounting pose of the first LiDAR.
    pub(super) mount: Pose,
    /// Identity for stored points, which are in the ego frame.
    ego_from_lidar: Pose,
}

impl LidarTable {
    /// Opens a table. `files` is the format of the files that it may name.
    ///
    /// # Errors
    /// Fails if the table is damaged.
    pub(super) fn open(file: ArrowFile, key: &str, files: Option<PointFiles>) -> Result<Self, DatasetError> {
        let lidars = metadata::read::<SweepMetadata>(&file)?.lidars();
        let mount = lidars.first().map(|lidar| lidar.ego_from_lidar(&file)).transpose()?;
        let mount = mount.unwrap_or(Pose::IDENTITY);
        let cells = CellTable::new(file, key)?;
        let is_raw = cells.kind == CellKind::Path && files.is_some_and(PointFiles::are_in_lidar_frame);
        let ego_from_lidar = if is_raw { mount } else { Pose::IDENTITY };
        let is_placed_by_end = files == Some(PointFiles::NuScenes);
        let at = cells.column(if is_placed_by_end { "end_timestamp_us" } else { "timestamp_us" });
        let times_us = cells.file.table(&[&at], &[])?.column(&at)?.integers()?;
        check_times(&times_us, false, cells.file.path())?;
        let cells = cells.ready()?;
        let ids = lidars.iter().map(|lidar| lidar.lidar_id).collect();
        Ok(Self { cells, ids, times_us, is_placed_by_end, mount, ego_from_lidar })
    }

    /// Returns the time of the pose in which the sweep of each row of `sync` is stored, where it may be
    /// another than that of the row; else `None`.
    ///
    /// # Errors
    /// Fails if `sync` names a row that does not exist.
    pub(super) fn pose_times(&self, sync: &Sync) -> Result<Vec<Option<i64>>, FileError> {
        let rows = sync.rows(&self.cells.key, self.cells.file.rows())?;
        let time = |row: Option<usize>| row.filter(|_| self.is_placed_by_end).map(|row| self.times_us[row]);
        Ok(rows.into_iter().map(time).collect())
    }

    /// Adds the sweeps to the frames.
    ///
    /// # Errors
    /// Fails if `sync` names a row that does not exist, or a path leads out of its folder.
    pub(super) fn add_sweeps(&self, target: &mut Target<'_>, notes: &mut Notes) -> Result<(), DatasetError> {
        let Target { sync, rows, ego, root, frames } = target;
        let named = sync.rows(&self.cells.key, self.cells.file.rows())?;
        let names = self.cells.names()?;
        let mut is_named = vec![false; self.times_us.len()];
        for (frame, row) in frames.iter_mut().zip(rows.iter()) {
            let row = named[*row].inspect(|row| is_named[*row] = true);
            // py123d places the sweep of a frame by the ego pose of the frame.
            let record =
                row.map(|row| self.record(row, frame.t_us, frame.global_from_ego, true, &names, *root));
            match record.transpose()?.flatten() {
                Some(record) => frame.sweeps.push(record),
                None => {
                    let record = format!("frame at {}", frame.t_us);
                    notes.gap(Gap::record(NO_SWEEP, record, self.cells.file.path()));
                }
            }
        }
        for row in (0..is_named.len()).filter(|row| !is_named[*row]) {
            let t_us = self.times_us[row];
            let next = frames.partition_point(|frame| frame.t_us < t_us);
            let Some(frame) = frames.get_mut(next) else {
                note(notes, "sweeps after the last frame", 1);
                continue;
            };
            let record = ego.at(t_us).map(|pose| self.record(row, t_us, pose, false, &names, *root));
            match record.transpose()?.flatten() {
                Some(record) => frame.sweeps.push(record),
                None => note(notes, "sweeps without data or pose", 1),
            }
        }
        for frame in frames.iter_mut() {
            frame.sweeps.sort_by_key(|sweep| {
                (!sweep.is_key, if sweep.is_key { Reverse(0) } else { Reverse(sweep.t_us) })
            });
        }
        Ok(())
    }

    /// Returns the record of a row; `None` if it has no data.
    fn record(
        &self,
        row: usize,
        t_us: i64,
        global_from_ego: Pose,
        is_key: bool,
        names: &[Option<String>],
        root: Option<&DataRoot>,
    ) -> Result<Option<SweepRecord>, DatasetError> {
        let table = self.cells.file.path();
        let (path, row) = match (self.cells.kind, root, &names[row]) {
            (CellKind::Path, Some(root), Some(name)) => (resolve(root, name, row, table)?, None),
            (CellKind::Path, ..) => return Ok(None),
            _ => (table.to_owned(), u32::try_from(row).ok()),
        };
        let ego_from_lidar = self.ego_from_lidar;
        Ok(Some(SweepRecord { path, row, t_us, global_from_ego, ego_from_lidar, is_key }))
    }
}
