//! What a build needs, estimated before it starts.

use std::path::Path;

use super::builder::MAX_BUFFERED_POINTS;
use super::request::BuildNeeds;
use super::runs::{MERGED_AT_ONCE, PART};
use super::stream::Stream;
use super::sums::VoxelSum;
use crate::cloud::Point;
use crate::files::free_bytes;
use crate::memory::available;

/// Bytes of a sum in a run that are never exceeded by recordings: see `blocks`.
const RUN_BYTES: u64 = 24;

/// Estimates the needs of a build in a folder.
pub(super) fn estimate(streams: &[Stream<'_>], out: &Path) -> BuildNeeds {
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
    BuildNeeds {
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
