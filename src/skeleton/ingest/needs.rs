//! What a build needs, estimated before it starts.

use std::path::Path;

use super::builder::MAX_BUFFERED_POINTS;
use super::runs::{MERGED_AT_ONCE, PART};
use super::stream::Stream;
use super::sums::VoxelSum;
use crate::cloud::Point;
use crate::files::free_bytes;
use crate::memory::{Available, available};

/// Bytes of a sum in a run that are never exceeded by recordings: see `blocks`.
const RUN_BYTES: u64 = 24;

/// What a build needs at most: as if every point had a color and a voxel of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildNeeds {
    /// Number of sweeps.
    pub sweeps: usize,
    /// Number of points, estimated from a frame of each log.
    pub points: u64,
    /// Size of the skeleton, bytes.
    pub skeleton_bytes: u64,
    /// Disk space during the build, bytes: the skeleton and intermediate files.
    pub disk_bytes: u64,
    /// Free disk space, bytes; `None` if the system does not say.
    pub free_bytes: Option<u64>,
    /// Memory beyond that of the opened logs, bytes: it does not depend on the number of frames.
    pub memory_bytes: u64,
    /// Available memory.
    pub available: Available,
}

impl BuildNeeds {
    /// Estimates the needs of a build in a folder.
    pub(super) fn of(streams: &[Stream<'_>], out: &Path) -> Self {
        let (mut sweeps, mut points, mut window) = (0, 0, 0);
        for stream in streams {
            let per_sweep = stream.points_of_a_sweep();
            let own = stream.frames.iter().map(|frame| stream.sweeps(frame).count()).sum::<usize>();
            sweeps += own;
            points += own as u64 * per_sweep;
            window = window.max(stream.window_bytes(per_sweep));
        }
        let sum = size_of::<VoxelSum>() as u64;
        // Sorting takes half of them again.
        let buffered = MAX_BUFFERED_POINTS as u64 * sum * 3 / 2;
        let merging =
            (PART * rayon::current_num_threads()) as u64 * (sum * 3 / 2 + 2 * size_of::<Point>() as u64);
        let skeleton_bytes = points * size_of::<Point>() as u64;
        let runs = (points + points.min((MERGED_AT_ONCE * MAX_BUFFERED_POINTS) as u64)) * RUN_BYTES;
        Self {
            sweeps,
            points,
            skeleton_bytes,
            disk_bytes: skeleton_bytes + runs,
            free_bytes: free_bytes(out),
            // Runs are merged while a log is read.
            memory_bytes: window + buffered + merging,
            available: available(),
        }
    }
}
