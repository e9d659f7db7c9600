//! The chunks of all clouds: which are loaded, and loading those that a frame needs.

use glam::DVec3;

use super::arena::{Arena, Load, PackedBlock, ROW_BYTES, SEGMENT_ROWS};
use super::packed::PackedCloud;
use crate::cloud::Cloud;
use crate::memory::{Need, Reservation};
use crate::raster::chunk::{CHUNK, CULL_BLOCK};
use crate::raster::residency::{DEFAULT_MEMORY_BYTES, Residency};
use crate::raster::sight::{SeenInstance, seen_chunks};
use crate::raster::{CloudSet, FrameJob, Instance, RasterError};

/// Clouds are read ahead if they are at most this much farther than what cameras see, meters.
const AHEAD_M: f64 = 40.0;
/// Clouds that are read ahead per frame: the system may wait for the disk.
const CLOUDS_AHEAD: usize = 2;

/// All clouds with their loaded chunks.
pub(super) struct Chunks<'a> {
    pub(super) clouds: Vec<PackedCloud<'a>>,
    residency: Residency,
    arena: Arena,
    /// Memory of the arena.
    taken: Reservation,
    /// Whether each cloud was near the cameras in the last frame.
    near: Vec<bool>,
    /// Number of rows from which on chunks are evicted.
    rows: usize,
    /// Budget, bytes.
    bytes: u64,
    /// Whether a frame that needs more rows is refused.
    is_limited: bool,
}

impl<'a> Chunks<'a> {
    /// Prepares clouds, without loading them. `memory_bytes` limits the memory of loaded chunks.
    pub(super) fn new(clouds: CloudSet<'a>, memory_bytes: Option<u64>) -> Self {
        let clouds: Vec<PackedCloud> = clouds.into_iter().map(PackedCloud::new).collect();
        let residency = Residency::new(clouds.iter().map(|cloud| &cloud.chunked));
        let bytes = memory_bytes.unwrap_or(DEFAULT_MEMORY_BYTES);
        let rows = (bytes / ROW_BYTES as u64) as usize;
        let (arena, taken, near) = (Arena::default(), Reservation::default(), vec![false; clouds.len()]);
        Self { clouds, residency, arena, taken, near, rows, bytes, is_limited: memory_bytes.is_some() }
    }

    /// Loads the chunks that a camera may see.
    ///
    /// # Errors
    /// Fails if they need more memory than allowed or available, and if points cannot be read or are damaged.
    pub(super) fn load(&mut self, job: &FrameJob<'_>, seen: &[SeenInstance]) -> Result<(), RasterError> {
        if self.residency.is_complete() {
            return Ok(());
        }
        self.residency.next_frame();
        let mut needed = seen_chunks(job, seen, &self.clouds);
        let count = needed.len();
        needed.retain(|(cloud, chunk)| self.residency.row(*cloud, *chunk).is_none());
        if needed.is_empty() {
            return Ok(());
        }
        self.make_room(count, needed.len())?;
        let rows = self.residency.oldest(needed.len());
        rows.iter().for_each(|row| self.residency.forget(*row));
        let loads: Vec<Load> =
            needed.iter().zip(rows).map(|((cloud, chunk), row)| (*cloud, *chunk, row)).collect();
        self.arena.load(&self.clouds, &loads)?;
        loads.iter().for_each(|(cloud, chunk, row)| self.residency.replace(*cloud, *chunk, *row));
        Ok(())
    }

    /// Allocates rows for a frame that needs some number of chunks, of which some are missing.
    fn make_room(&mut self, needed: usize, missing: usize) -> Result<(), RasterError> {
        if self.is_limited && needed > self.rows {
            let (needed_bytes, allowed_bytes) = ((needed * ROW_BYTES) as u64, self.bytes);
            return Err(RasterError::PointBudget { needed_bytes, allowed_bytes, option: "--memory" });
        }
        // Rows are only evicted once the budget is used up.
        let loaded = self.residency.loaded() + missing;
        let wanted = loaded.min(self.rows).max(needed).min(self.residency.chunks());
        while self.arena.rows() < wanted {
            let bytes = ((self.arena.rows() + SEGMENT_ROWS) * ROW_BYTES) as u64;
            let advice = "a smaller budget for points (--memory), a smaller distance or fewer cameras help";
            self.taken.grow(bytes, || Need { what: "points near the cameras".to_owned(), bytes, advice })?;
            self.arena.grow();
        }
        self.residency.grow(wanted.min(self.arena.rows()));
        Ok(())
    }

    /// Lets the system read clouds that come near the cameras, before they are seen.
    pub(super) fn load_ahead(&mut self, job: &FrameJob<'_>) {
        if self.residency.is_complete() {
            return;
        }
        let eyes: Vec<DVec3> =
            job.views.iter().map(|view| view.camera_from_world.inverse().translation).collect();
        let reach_m = f64::from(job.schedule.z_far_m()) + AHEAD_M;
        let mut left = CLOUDS_AHEAD;
        for Instance { cloud, world_from_local, .. } in job.geometry {
            let (Some(PackedCloud { chunked, .. }), Some(is_near)) =
                (self.clouds.get(*cloud), self.near.get_mut(*cloud))
            else {
                continue;
            };
            let (Cloud::Stored(stored), Some(bounds)) = (chunked.cloud, &chunked.all) else { continue };
            let [low, high] = [bounds.min, bounds.max].map(|corner| DVec3::from(corner.map(f64::from)));
            let distance_m = |eye: &DVec3| {
                let eye = world_from_local.inverse().transform_point3(*eye);
                (eye - eye.clamp(low, high)).length()
            };
            let was_near = std::mem::replace(is_near, eyes.iter().any(|eye| distance_m(eye) < reach_m));
            if *is_near && !was_near {
                if left == 0 {
                    *is_near = false;
                    continue;
                }
                left -= 1;
                stored.load_ahead();
            }
        }
    }

    /// Returns a block of a cloud; `None` if it is not loaded.
    pub(super) fn block(&self, cloud: usize, block: usize) -> Option<PackedBlock<'_>> {
        const BLOCKS: usize = CHUNK / CULL_BLOCK;
        Some(self.arena.block(self.residency.row_of(cloud, block / BLOCKS)?, block % BLOCKS))
    }
}
