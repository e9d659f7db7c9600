//! Files of sweeps that tables name by paths: they are as the data set has them.

use std::path::Path;

use crate::dataset::sweeps::pcd::{check_pcd_file, pcd_rows};
use crate::dataset::sweeps::{RingDecision, SweepRows};
use crate::dataset::{Recording, Sweep, SweepRecord, av2, nuscenes};
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, read_file};

/// Format of sweep files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PointFiles {
    NuScenes,
    NuPlan,
    Argoverse,
    Kitti360,
}

impl PointFiles {
    /// Returns the format of a data set; `None` if it is not read.
    pub(super) fn of_dataset(name: &str) -> Option<Self> {
        match name.replace('_', "-").as_str() {
            "nuscenes" => Some(Self::NuScenes),
            "nuplan" => Some(Self::NuPlan),
            "av2-sensor" => Some(Self::Argoverse),
            "kitti360" => Some(Self::Kitti360),
            _ => None,
        }
    }

    /// Returns whether points are in the frame of the LiDAR; otherwise they are in the ego frame.
    pub(super) fn are_in_lidar_frame(self) -> bool {
        matches!(self, Self::NuScenes | Self::Kitti360)
    }

    /// Reads a sweep of a log.
    ///
    /// # Errors
    /// Fails if the file is missing or damaged.
    pub(super) fn read(
        self,
        record: &SweepRecord,
        log: &Recording,
        rings: &RingDecision,
    ) -> Result<Sweep, FileError> {
        let plain = |record: &SweepRecord| nuscenes::sweep_rows(&record.path, None);
        let pcd = |record: &SweepRecord| -> Result<SweepRows, FileError> {
            pcd_rows(&read_file(&record.path, SWEEP_BYTES)?, |_| None, &record.path)
        };
        match self {
            Self::NuScenes | Self::Kitti360 => rings.read(log, record, plain),
            Self::NuPlan => rings.read(log, record, pcd),
            Self::Argoverse => av2::read_sweep_as(&record.path, log.reading.rings),
        }
    }

    /// Returns the number of points that a file declares.
    ///
    /// # Errors
    /// Fails as [`PointFiles::read`], except for errors in the points themselves.
    pub(super) fn check(self, path: &Path) -> Result<u64, FileError> {
        match self {
            Self::NuScenes | Self::Kitti360 => nuscenes::check_sweep(path, None),
            Self::NuPlan => check_pcd_file(path),
            Self::Argoverse => av2::declared_points(path),
        }
    }
}

/// Creates the error for a file of another data set's format.
pub(super) fn unsupported(path: &Path, dataset: &str) -> FileError {
    let expected = "sweeps of nuScenes, nuPlan, Argoverse 2 or KITTI-360, or stored in the table \
        (convert again with the option lidar_store_option=binary of py123d)";
    FileError::content(expected, format!("a file of {dataset}"), path)
}
