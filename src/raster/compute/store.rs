//! Points on the device: colors all there, positions as far as the memory allows.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use rayon::prelude::*;

use super::chunk::{CHUNK, ChunkedCloud};
use super::project::PAGE_SET;
use crate::gpu::{
    Bind, Buffer, BufferDesc, Commands, DescriptorSet, Device, GpuError, Image, ImageDesc, Memory,
    PipelineLayout,
};

/// Bytes of a chunk's positions: a row of texels of 16 bytes.
pub(super) const ROW_BYTES: u64 = CHUNK as u64 * 16;
/// Bytes of a chunk's colors.
const COLOR_ROW_BYTES: u64 = CHUNK as u64 * 4;
/// Rows of an image, as the resolve shaders count on it.
const IMAGE_ROWS: u32 = 16_384;
/// Uploads go through host memory of at most this size, bytes.
const STAGING_BYTES: u64 = 32 << 20;
/// Rows that are streamed at once.
pub(super) const STREAMED_ROWS: u32 = 512;

/// An image of positions, one chunk a row, and the descriptor set with which it is drawn.
pub(super) struct Page {
    pub(super) image: Arc<Image>,
    pub(super) set: DescriptorSet,
}

/// Images of points.
pub(super) struct Store {
    pub(super) pages: Vec<Page>,
    /// Of every page but the last.
    pub(super) page_rows: u32,
    /// Colors and classes in the order of the clouds, one block of [`CHUNK`] a row.
    pub(super) colors: Arc<Image>,
}

/// How much the device is to hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct StoreLimits {
    /// Bytes for points in all; `None` for as many as there are.
    pub(super) bytes: Option<u64>,
    /// Rows of a page; `None` for as many as an image has.
    pub(super) page_rows: Option<u32>,
    /// Positions have room for at least twice so many rows.
    pub(super) streamed_rows: u32,
}

/// Where chunks are.
pub(super) struct Residency {
    /// First chunk of each cloud.
    firsts: Vec<u32>,
    /// Row of each chunk, of those that have one.
    row_of: Vec<Option<u32>>,
    /// Chunk in each row.
    chunk_in: Vec<Option<u32>>,
    /// Frame that last drew each row.
    used: Vec<u64>,
    frame: u64,
}

impl Store {
    /// Makes images and uploads colors, and positions if there is room for all.
    ///
    /// # Errors
    /// The device's; a limit that is too small for these clouds.
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

    /// Page of a row, and its row there.
    pub(super) fn place(&self, row: u32) -> (usize, u32) {
        ((row / self.page_rows) as usize, row % self.page_rows)
    }
}

/// How many chunks' positions the device is to hold.
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

/// An array of images: block `i` is row `i % IMAGE_ROWS` of layer `i / IMAGE_ROWS`.
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

/// Fills the first rows of a layer, a bounded number at a time, and leaves the image to be read.
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

/// Rows of [`CHUNK`] values each, filled in parallel.
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

    /// Where each cloud's colors begin.
    pub(super) fn color_firsts(&self) -> Vec<u32> {
        self.firsts.iter().map(|first| first.wrapping_mul(CHUNK as u32)).collect()
    }

    /// Begins a frame.
    pub(super) fn next_frame(&mut self) {
        self.frame += 1;
    }

    /// The row of a chunk, which is drawn now.
    pub(super) fn row(&mut self, cloud: u32, chunk: u32) -> Option<u32> {
        let row = self.row_of[(self.firsts[cloud as usize] + chunk) as usize]?;
        self.used[row as usize] = self.frame;
        Some(row)
    }

    /// Gives so many rows away, those that were drawn longest ago, in the order of the rows. At most all there are.
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

    /// Says that a row holds nothing.
    pub(super) fn forget(&mut self, row: u32) {
        if let Some(old) = self.chunk_in[row as usize].take() {
            self.row_of[old as usize] = None;
        }
    }

    /// Puts a chunk into a row.
    pub(super) fn replace(&mut self, cloud: u32, chunk: u32, row: u32) {
        self.put(self.firsts[cloud as usize] + chunk, row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Point;

    #[test]
    fn the_rows_used_longest_ago_go_first() {
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
