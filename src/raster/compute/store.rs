//! Points on the device: all colors, and as many positions as the memory budget allows.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use rayon::prelude::*;

use super::project::PAGE_SET;
use crate::gpu::{
    Bind, Buffer, BufferDesc, Commands, DescriptorSet, Device, GpuError, Image, ImageDesc, Memory,
    PipelineLayout,
};
use crate::raster::chunk::{CHUNK, ChunkedCloud};

/// Size of a chunk's positions, bytes: a row of 16-byte texels.
pub(super) const ROW_BYTES: u64 = CHUNK as u64 * 16;
/// Size of a chunk's colors, bytes.
const COLOR_ROW_BYTES: u64 = CHUNK as u64 * 4;
/// Maximum number of rows per image; the resolve shaders assume this value for colors.
const IMAGE_ROWS: u32 = 16_384;
/// Maximum size of an upload's staging buffer, bytes.
const STAGING_BYTES: u64 = 32 << 20;
/// Number of rows streamed at once.
pub(super) const STREAMED_ROWS: u32 = 512;

/// An image of positions with one chunk per row (a chunk buffer), and the descriptor set that binds it.
pub(super) struct Page {
    pub(super) image: Arc<Image>,
    pub(super) set: DescriptorSet,
}

/// Images of points.
pub(super) struct Store {
    pub(super) pages: Vec<Page>,
    /// Row count of every page but the last.
    pub(super) page_rows: u32,
    /// Colors and classes in the order of the clouds, one block of [`CHUNK`] per row.
    pub(super) colors: Arc<Image>,
}

/// Memory limits of the device's points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct StoreLimits {
    /// Memory budget for all points, bytes; `None` for no limit.
    pub(super) bytes: Option<u64>,
    /// Maximum number of rows per page; `None` for the device's maximum.
    pub(super) page_rows: Option<u32>,
    /// Number of rows streamed at once; the position images hold at least twice as many.
    pub(super) streamed_rows: u32,
}

/// Residency of chunks on the device.
pub(super) struct Residency {
    /// Index of each cloud's first chunk.
    firsts: Vec<u32>,
    /// Row of each chunk; `None` if not resident.
    row_of: Vec<Option<u32>>,
    /// Chunk in each row; `None` if empty.
    chunk_in: Vec<Option<u32>>,
    /// Frame that last drew each row.
    used: Vec<u64>,
    frame: u64,
}

impl Store {
    /// Creates images and uploads colors, and all positions if they fit.
    ///
    /// # Errors
    /// Fails on any device error, or if the memory budget is too small for these clouds.
    pub(super) fn new(
        device: &Arc<Device>,
        commands: &mut Commands,
        layout: &PipelineLayout,
        clouds: &[ChunkedCloud<'_>],
        limits: StoreLimits,
    ) -> Result<(Self, Residency), GpuError> {
        let chunks: Vec<(u32, u32)> = clouds
            .iter()
            .enumerate()
            .flat_map(|(cloud, c)| (0..c.chunks()).map(move |chunk| (cloud as u32, chunk as u32)))
            .collect();
        let rows = rows_within(device, chunks.len() as u64, limits)?;
        let colors = colors(device, commands, clouds, &chunks)?;
        let most = u64::from(device.max_image_side())
            .min(u64::from(IMAGE_ROWS))
            .min(device.max_allocation() / ROW_BYTES);
        let page_rows = limits.page_rows.map_or(most, |rows| most.min(u64::from(rows))).max(1) as u32;
        let mut store = Self { pages: Vec::new(), page_rows, colors };
        let mut left = rows as u32;
        while left > 0 {
            let count = left.min(page_rows);
            left -= count;
            store.pages.push(page(device, layout, count)?);
        }
        let mut residency = Residency::new(clouds, rows as usize);
        let all = rows >= chunks.len() as u64;
        for (index, page) in store.pages.iter().enumerate() {
            let first = index * page_rows as usize;
            let here = if all { &chunks[first..chunks.len().min(first + page_rows as usize)] } else { &[] };
            let fill = |row: usize, words: &mut [[u32; 4]]| {
                let (cloud, chunk) = here[row];
                clouds[cloud as usize].write_row(chunk as usize, words);
            };
            upload(device, commands, (&page.image, 0), here.len(), fill)?;
        }
        if all {
            residency.all_in_order();
        }
        Ok((store, residency))
    }

    /// Returns the page of a row, and its row within the page.
    pub(super) fn place(&self, row: u32) -> (usize, u32) {
        ((row / self.page_rows) as usize, row % self.page_rows)
    }
}

/// Returns the number of chunks whose positions fit on the device.
fn rows_within(device: &Device, chunks: u64, limits: StoreLimits) -> Result<u64, GpuError> {
    let Some(bytes) = limits.bytes.filter(|b| *b < chunks * (ROW_BYTES + COLOR_ROW_BYTES)) else {
        return Ok(chunks);
    };
    let colors = chunks * COLOR_ROW_BYTES;
    let needed = colors + chunks.min(2 * u64::from(limits.streamed_rows)) * ROW_BYTES;
    if bytes < needed {
        let mib = |bytes: u64| bytes.div_ceil(1 << 20);
        let expected = format!(
            "at least {} MiB for points (colors stay on the device, positions are streamed)",
            mib(needed)
        );
        return Err(device.unsupported(expected, format!("{} MiB allowed", bytes >> 20)));
    }
    Ok((bytes - colors) / ROW_BYTES)
}

fn page(device: &Arc<Device>, layout: &PipelineLayout, rows: u32) -> Result<Page, GpuError> {
    let image = Arc::new(Image::new(
        device,
        &ImageDesc {
            name: "page of points",
            width: CHUNK as u32,
            height: rows,
            layers: None,
            format: vk::Format::R32G32B32A32_UINT,
            usage: ImageUsageFlags::SAMPLED | ImageUsageFlags::TRANSFER_DST,
        },
    )?);
    let set = DescriptorSet::new(layout, PAGE_SET, vec![Bind::Image(image.clone())])?;
    Ok(Page { image, set })
}

/// Creates the array image of colors: block `i` is row `i % IMAGE_ROWS` of layer `i / IMAGE_ROWS`.
fn colors(
    device: &Arc<Device>,
    commands: &mut Commands,
    clouds: &[ChunkedCloud<'_>],
    blocks: &[(u32, u32)],
) -> Result<Arc<Image>, GpuError> {
    let rows = (blocks.len() as u32).max(1);
    let layers = rows.div_ceil(IMAGE_ROWS);
    let image = Arc::new(Image::new(
        device,
        &ImageDesc {
            name: "colors",
            width: CHUNK as u32,
            height: rows.min(IMAGE_ROWS),
            layers: Some(layers),
            format: vk::Format::R32_UINT,
            usage: ImageUsageFlags::SAMPLED | ImageUsageFlags::TRANSFER_DST,
        },
    )?);
    for layer in 0..layers {
        let first = (layer * IMAGE_ROWS) as usize;
        let here = &blocks[first.min(blocks.len())..blocks.len().min(first + IMAGE_ROWS as usize)];
        let fill = |row: usize, words: &mut [u32]| {
            let (cloud, block) = (here[row].0 as usize, here[row].1 as usize);
            let colors = clouds[cloud].colors(block * CHUNK..(block + 1) * CHUNK);
            words.iter_mut().zip(colors).for_each(|(word, color)| *word = color);
        };
        upload(device, commands, (&image, layer), here.len(), fill)?;
    }
    Ok(image)
}

/// Uploads the first rows of a layer in bounded steps, and leaves the image in its read layout.
fn upload<T: bytemuck::Pod + Send>(
    device: &Arc<Device>,
    commands: &mut Commands,
    (image, layer): (&Image, u32),
    rows: usize,
    fill: impl Fn(usize, &mut [T]) + Sync,
) -> Result<(), GpuError> {
    if layer == 0 {
        let mut recorder = commands.begin()?;
        recorder.forget(image);
        recorder.submit()?;
    }
    if rows == 0 {
        return Ok(());
    }
    let row_bytes = CHUNK * size_of::<T>();
    let at_once = rows.min((STAGING_BYTES as usize / row_bytes).max(1));
    let (size, usage) = ((at_once * row_bytes) as u64, Usage::TRANSFER_SRC);
    let mut staging =
        Buffer::new(device, &BufferDesc { name: "upload", size, usage, memory: Memory::Upload })?;
    for first in (0..rows).step_by(at_once) {
        let count = at_once.min(rows - first);
        let bytes = &mut staging.bytes_mut()?[..count * row_bytes];
        fill_rows(bytes, |row, words| fill(first + row, words));
        let mut recorder = commands.begin()?;
        recorder.write_rows((&staging, 0), image, layer, first as u32..(first + count) as u32)?;
        recorder.submit()?;
    }
    Ok(())
}

/// Fills rows of [`CHUNK`] values in parallel.
pub(super) fn fill_rows<T: bytemuck::Pod + Send>(bytes: &mut [u8], fill: impl Fn(usize, &mut [T]) + Sync) {
    let rows = bytes.par_chunks_mut(CHUNK * size_of::<T>()).enumerate();
    rows.for_each(|(row, bytes)| fill(row, bytemuck::cast_slice_mut(bytes)));
}

impl Residency {
    fn new(clouds: &[ChunkedCloud<'_>], rows: usize) -> Self {
        let mut chunks = 0;
        let mut first = |cloud: &ChunkedCloud<'_>| {
            let first = chunks as u32;
            chunks += cloud.chunks();
            first
        };
        let firsts = clouds.iter().map(&mut first).collect();
        let (row_of, chunk_in, used) = (vec![None; chunks], vec![None; rows], vec![0; rows]);
        Self { firsts, row_of, chunk_in, used, frame: 0 }
    }

    fn all_in_order(&mut self) {
        (0..self.row_of.len()).for_each(|chunk| self.put(chunk as u32, chunk as u32));
    }

    fn put(&mut self, chunk: u32, row: u32) {
        if let Some(old) = self.chunk_in[row as usize].replace(chunk) {
            self.row_of[old as usize] = None;
        }
        self.row_of[chunk as usize] = Some(row);
        self.used[row as usize] = self.frame;
    }

    /// Returns the index of each cloud's first color.
    pub(super) fn color_firsts(&self) -> Vec<u32> {
        self.firsts.iter().map(|first| first.wrapping_mul(CHUNK as u32)).collect()
    }

    /// Begins a frame.
    pub(super) fn next_frame(&mut self) {
        self.frame += 1;
    }

    /// Returns the row of a chunk and marks it as drawn in this frame; `None` if not resident.
    pub(super) fn row(&mut self, cloud: u32, chunk: u32) -> Option<u32> {
        let row = self.row_of[(self.firsts[cloud as usize] + chunk) as usize]?;
        self.used[row as usize] = self.frame;
        Some(row)
    }

    /// Returns the `count` least recently drawn rows (at most all rows) in ascending order, for eviction.
    pub(super) fn oldest(&self, count: usize) -> Vec<u32> {
        let mut rows: Vec<u32> = (0..self.used.len() as u32).collect();
        let count = count.min(rows.len());
        if count < rows.len() {
            rows.select_nth_unstable_by_key(count, |row| (self.used[*row as usize], *row));
            rows.truncate(count);
        }
        rows.sort_unstable();
        rows
    }

    /// Marks a row as empty.
    pub(super) fn forget(&mut self, row: u32) {
        if let Some(old) = self.chunk_in[row as usize].take() {
            self.row_of[old as usize] = None;
        }
    }

    /// Assigns a chunk to a row and evicts the previous chunk.
    pub(super) fn replace(&mut self, cloud: u32, chunk: u32, row: u32) {
        self.put(self.firsts[cloud as usize] + chunk, row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Point;

    #[test]
    fn least_recently_drawn_rows_are_evicted_first() {
        let points = vec![Point::default(); 5 * CHUNK];
        let clouds = [ChunkedCloud::new(&points[..2 * CHUNK]), ChunkedCloud::new(&points[2 * CHUNK..])];
        let mut residency = Residency::new(&clouds, 3);
        assert_eq!(residency.color_firsts(), [0, 2 * CHUNK as u32]);
        assert_eq!(residency.row(1, 0), None);
        residency.next_frame();
        residency.replace(0, 0, 0);
        residency.replace(1, 0, 1);
        residency.replace(1, 2, 2);
        residency.next_frame();
        assert_eq!((residency.row(1, 0), residency.row(1, 2), residency.row(0, 1)), (Some(1), Some(2), None));
        assert_eq!(residency.oldest(1), [0]);
        assert_eq!(residency.oldest(9), [0, 1, 2]);
        residency.replace(0, 1, 0);
        assert_eq!((residency.row(0, 0), residency.row(0, 1)), (None, Some(0)));
        residency.forget(0);
        assert_eq!((residency.row(0, 1), residency.row(1, 0)), (None, Some(1)));
    }
}
