//! Points of the graphics-pipeline rasterizer: the chunks that a camera may see, in rows of a few large
//! buffers.
//!
//! A page is a buffer as large as a shader can bind. A piece is a run of consecutive chunks in consecutive
//! rows of one page, drawn with the pose of one instance. Pieces are drawn in the order of their points, so
//! the smallest number still wins ties.

use std::sync::Arc;

use ash::vk::BufferUsageFlags as Usage;
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use crate::cloud::Point;
use crate::error::FileError;
use crate::gpu::{
    Bind, Buffer, BufferDesc, Commands, DescriptorSet, Device, GpuError, Memory, PipelineLayout, Scope,
    assert_layout, shaders,
};
use crate::raster::chunk::{CHUNK, ChunkedCloud};
use crate::raster::residency::Residency;
use crate::raster::{DEFAULT_MEMORY_BYTES, Draw, MapSet, RasterError};

/// Descriptor set number of a page.
const PAGE_SET: u32 = 1;
/// Size of a row, bytes.
const ROW_BYTES: u64 = (CHUNK * size_of::<Point>()) as u64;
/// Maximum number of rows that are uploaded at once.
const STAGED_ROWS: u64 = 256;
/// Maximum size of a page, bytes.
const MAX_PAGE_BYTES: u64 = 1 << 30;

/// Points within one page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Slice {
    /// Page index.
    pub(super) page: u32,
    /// First point within the page.
    pub(super) first: u32,
    /// Number of points.
    pub(super) count: u32,
    /// Index of that first point within the cloud.
    pub(super) first_in_cloud: u32,
}

/// A slice to draw.
pub(super) struct PieceDraw {
    /// Index of the draw in the job.
    pub(super) draw: usize,
    /// Points to draw.
    pub(super) slice: Slice,
}

/// Entry of the piece table.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct Piece {
    /// Added (wrapping) to the point within the page to get the point's number in the job.
    pub(super) number_bias: u32,
    /// Value in the instance map.
    pub(super) instance: u32,
    /// Page of its points.
    pub(super) page: u32,
    pub(super) pad: u32,
}
assert_layout!(Piece, shaders::resolve_comp::piece, [
    number_bias: NUMBER_BIAS,
    instance: INSTANCE,
    page: PAGE,
    pad: PAD,
]);

/// A buffer of points, and the descriptor set that binds it to the resolve shader.
pub(super) struct Page {
    pub(super) points: Arc<Buffer>,
    pub(super) set: DescriptorSet,
}

/// Loaded chunks on the device.
pub(super) struct Pages {
    pub(super) pages: Vec<Page>,
    /// Rows of every page but the last.
    page_rows: u32,
    residency: Residency,
    staging: Option<Buffer>,
    /// Number of rows from which on chunks are evicted.
    rows: usize,
    /// Budget, bytes.
    bytes: u64,
}

impl Pages {
    /// Prepares pages for some clouds, without loading them. `memory_bytes` is the budget for points,
    /// `page_points` limits the size of a page; the device may limit it further.
    pub(super) fn new(
        device: &Device,
        clouds: &[ChunkedCloud<'_>],
        page_points: Option<u32>,
        memory_bytes: Option<u64>,
    ) -> Self {
        let largest = device.max_storage_buffer().min(MAX_PAGE_BYTES) / ROW_BYTES;
        let page_rows = page_points.map_or(largest, |points| largest.min(u64::from(points) / CHUNK as u64));
        let bytes = memory_bytes.or(device.is_cpu().then_some(DEFAULT_MEMORY_BYTES)).unwrap_or(u64::MAX);
        Self {
            pages: Vec::new(),
            page_rows: page_rows.max(1) as u32,
            residency: Residency::new(clouds.iter()),
            staging: None,
            rows: usize::try_from(bytes / ROW_BYTES).unwrap_or(usize::MAX),
            bytes,
        }
    }

    /// Loads chunks, which are pairs of cloud and chunk.
    ///
    /// # Errors
    /// Fails on any device error, if they need more memory than allowed, and if points cannot be read or are
    /// damaged.
    pub(super) fn load(
        &mut self,
        device: &Arc<Device>,
        commands: &mut Commands,
        layout: &PipelineLayout,
        clouds: &[ChunkedCloud<'_>],
        chunks: &[(u32, u32)],
    ) -> Result<(), RasterError> {
        if chunks.len() > self.rows {
            let (needed_bytes, allowed_bytes) = (chunks.len() as u64 * ROW_BYTES, self.bytes);
            return Err(RasterError::PointBudget { needed_bytes, allowed_bytes, option: "--gpu-memory" });
        }
        self.residency.next_frame();
        let mut missing = chunks.to_vec();
        missing.retain(|(cloud, chunk)| self.residency.row(*cloud, *chunk).is_none());
        // Rows are only evicted once the budget is used up.
        let wanted = (self.residency.loaded() + missing.len()).min(self.rows);
        while self.residency.rows() < wanted {
            let rows =
                (self.page_rows as usize).min(self.residency.chunks().min(self.rows) - self.residency.rows());
            self.pages.push(page(device, layout, rows as u64)?);
            self.residency.grow(self.residency.rows() + rows);
        }
        let rows = self.residency.oldest(missing.len());
        rows.iter().for_each(|row| self.residency.forget(*row));
        let loads: Vec<((u32, u32), u32)> = missing.into_iter().zip(rows).collect();
        for loads in loads.chunks(STAGED_ROWS as usize) {
            self.upload(device, commands, clouds, loads)?;
            loads.iter().for_each(|((cloud, chunk), row)| self.residency.replace(*cloud, *chunk, *row));
        }
        Ok(())
    }

    /// Uploads some chunks into ascending rows.
    fn upload(
        &mut self,
        device: &Arc<Device>,
        commands: &mut Commands,
        clouds: &[ChunkedCloud<'_>],
        loads: &[((u32, u32), u32)],
    ) -> Result<(), RasterError> {
        let staging = match &mut self.staging {
            Some(staging) => staging,
            none => {
                let size = STAGED_ROWS.min(self.residency.chunks() as u64) * ROW_BYTES;
                let (usage, memory) = (Usage::TRANSFER_SRC, Memory::Upload);
                none.insert(Buffer::new(device, &BufferDesc { name: "upload", size, usage, memory })?)
            }
        };
        let rows =
            staging.bytes_mut()?[..loads.len() * ROW_BYTES as usize].par_chunks_mut(ROW_BYTES as usize);
        let read = rows.zip(loads).map_init(Vec::new, |buffer, (bytes, ((cloud, chunk), _))| {
            let points = clouds[*cloud as usize].read(*chunk as usize, buffer)?;
            let points: &[u8] = bytemuck::cast_slice(points);
            bytes[..points.len()].copy_from_slice(points);
            Ok::<_, FileError>(())
        });
        read.find_first(Result::is_err).unwrap_or(Ok(()))?;
        let mut recorder = commands.begin()?;
        for (i, (_, row)) in loads.iter().enumerate() {
            let (page, row) = (row / self.page_rows, row % self.page_rows);
            let to = (&*self.pages[page as usize].points, u64::from(row) * ROW_BYTES);
            recorder.copy((&*staging, i as u64 * ROW_BYTES), to, ROW_BYTES)?;
        }
        recorder.barrier(Scope::CopyWrite, Scope::ShaderRead);
        recorder.submit()?;
        Ok(())
    }

    /// Returns the pieces to draw for a job, in order, and the table for resolving its pixels. `chunks` are
    /// those that a camera may see, in order, all of them loaded.
    pub(super) fn pieces(
        &self,
        draws: &[Draw],
        clouds: &[ChunkedCloud<'_>],
        chunks: &[(u32, u32)],
    ) -> (Vec<PieceDraw>, Vec<Piece>) {
        let (mut pieces, mut table) = (Vec::new(), Vec::new());
        for (index, draw) in draws.iter().enumerate() {
            let cloud = draw.cloud as u32;
            let own = chunks.partition_point(|chunk| *chunk < (cloud, 0));
            let own = chunks[own..].iter().take_while(|chunk| chunk.0 == cloud);
            let rows = own.filter_map(|(_, chunk)| {
                let count = clouds[draw.cloud].count(*chunk as usize);
                Some((*chunk, self.residency.row_of(draw.cloud, *chunk as usize)?, count))
            });
            for slice in slices(rows, self.page_rows) {
                let first_number = draw.first_number.wrapping_add(slice.first_in_cloud);
                pieces.push(PieceDraw { draw: index, slice });
                table.push(Piece {
                    number_bias: first_number.wrapping_sub(slice.first),
                    instance: draw.instance,
                    page: slice.page,
                    pad: 0,
                });
            }
        }
        (pieces, table)
    }

    /// Returns the pages that the resolve shader must bind: all drawn ones if colors are requested, else only
    /// one.
    pub(super) fn used(table: &[Piece], maps: MapSet) -> Vec<u32> {
        let mut used: Vec<u32> = table.iter().map(|piece| piece.page).collect();
        used.sort_unstable();
        used.dedup();
        if !maps.intersects(MapSet::RGB_CLASS) {
            used.truncate(1);
        }
        used
    }
}

fn page(device: &Arc<Device>, layout: &PipelineLayout, rows: u64) -> Result<Page, GpuError> {
    let usage = Usage::VERTEX_BUFFER | Usage::STORAGE_BUFFER | Usage::TRANSFER_DST;
    let desc = BufferDesc { name: "page of points", size: rows * ROW_BYTES, usage, memory: Memory::Device };
    let points = Arc::new(Buffer::new(device, &desc)?);
    let set = DescriptorSet::new(layout, PAGE_SET, vec![Bind::Buffer(points.clone())])?;
    Ok(Page { points, set })
}

/// Joins a cloud's chunks in consecutive rows of a page. `rows` contains the chunk, row and number of points
/// of each.
fn slices(rows: impl Iterator<Item = (u32, u32, u32)>, page_rows: u32) -> Vec<Slice> {
    let mut slices: Vec<Slice> = Vec::new();
    for (chunk, row, count) in rows {
        let (page, first, first_in_cloud) =
            (row / page_rows, row % page_rows * CHUNK as u32, chunk.wrapping_mul(CHUNK as u32));
        match slices.last_mut() {
            Some(last)
                if (last.page, last.first + last.count) == (page, first)
                    && last.first_in_cloud + last.count == first_in_cloud =>
            {
                last.count += count;
            }
            _ => slices.push(Slice { page, first, count, first_in_cloud }),
        }
    }
    slices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn consecutive_chunks_in_consecutive_rows_are_one_slice() {
        let whole = CHUNK as u32;
        let slice = |page, first, count, first_in_cloud| Slice { page, first, count, first_in_cloud };
        let rows = [(0, 1, whole), (1, 2, whole), (2, 3, whole), (3, 4, whole), (5, 5, whole), (6, 7, 9)];
        let expected = [
            slice(0, whole, 2 * whole, 0),
            slice(1, 0, 2 * whole, 2 * whole),
            slice(1, 2 * whole, whole, 5 * whole),
            slice(2, whole, 9, 6 * whole),
        ];
        assert_eq!(slices(rows.into_iter(), 3), expected);
        assert!(slices([].into_iter(), 3).is_empty());
    }
}
