//! Points on the device: as many positions and colors as the memory budget allows.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use rayon::prelude::*;

use super::project::PAGE_SET;
use crate::cloud::Point;
use crate::error::FileError;
use crate::gpu::{
    Bind, Buffer, BufferDesc, Commands, DescriptorSet, Device, GpuError, Image, ImageDesc, Memory,
    PipelineLayout,
};
use crate::raster::RasterError;
use crate::raster::chunk::{CHUNK, ChunkedCloud};
use crate::raster::residency::Residency;

/// Size of a chunk's positions, bytes: a row of 16-byte texels.
pub(super) const ROW_BYTES: u64 = CHUNK as u64 * 16;
/// Size of a chunk's colors, bytes.
pub(super) const COLOR_ROW_BYTES: u64 = CHUNK as u64 * 4;
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
    /// Colors and classes of [`CHUNK`] points with consecutive numbers per row.
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

impl Store {
    /// Creates images for some clouds, without loading their points. Returns the residency of positions and
    /// of colors.
    ///
    /// # Errors
    /// Fails on any device error, or if the memory budget is too small.
    pub(super) fn new(
        device: &Arc<Device>,
        commands: &mut Commands,
        layout: &PipelineLayout,
        clouds: &[ChunkedCloud<'_>],
        limits: StoreLimits,
    ) -> Result<(Self, [Residency; 2]), GpuError> {
        let mut residencies = [Residency::new(clouds.iter()), Residency::new(clouds.iter())];
        let rows = rows_within(device, residencies[0].chunks() as u64, limits)?;
        residencies.iter_mut().zip(rows).for_each(|(residency, rows)| residency.grow(rows as usize));
        let colors = colors(device, commands, rows[1] as u32)?;
        let most = u64::from(device.max_image_side())
            .min(u64::from(IMAGE_ROWS))
            .min(device.max_allocation() / ROW_BYTES);
        let page_rows = limits.page_rows.map_or(most, |rows| most.min(u64::from(rows))).max(1) as u32;
        let mut store = Self { pages: Vec::new(), page_rows, colors };
        let mut left = rows[0] as u32;
        while left > 0 {
            let count = left.min(page_rows);
            left -= count;
            store.pages.push(page(device, commands, layout, count)?);
        }
        Ok((store, residencies))
    }

    /// Loads the colors of chunks into their rows.
    ///
    /// # Errors
    /// Fails on any device error, and if points cannot be read or are damaged.
    pub(super) fn load_colors(
        &self,
        device: &Arc<Device>,
        commands: &mut Commands,
        clouds: &[ChunkedCloud<'_>],
        loads: &[(u32, u32, u32)],
    ) -> Result<(), RasterError> {
        const AT_ONCE: usize = (STAGING_BYTES / COLOR_ROW_BYTES) as usize;
        let size = COLOR_ROW_BYTES * loads.len().min(AT_ONCE) as u64;
        let desc = BufferDesc { name: "upload", size, usage: Usage::TRANSFER_SRC, memory: Memory::Upload };
        let mut staging = if loads.is_empty() { return Ok(()) } else { Buffer::new(device, &desc)? };
        for loads in loads.chunks(AT_ONCE) {
            let bytes = &mut staging.bytes_mut()?[..loads.len() * COLOR_ROW_BYTES as usize];
            fill_rows(bytes, |row, words: &mut [u32], buffer| {
                let (cloud, chunk, _) = loads[row];
                let points = clouds[cloud as usize].read_in_order(chunk as usize, buffer)?;
                words.iter_mut().zip(points).for_each(|(word, point)| *word = point.rgb_class);
                Ok(())
            })?;
            let mut recorder = commands.begin()?;
            for (i, (_, _, row)) in loads.iter().enumerate() {
                let from = (&staging, i as u64 * COLOR_ROW_BYTES);
                let (layer, row) = (row / IMAGE_ROWS, row % IMAGE_ROWS);
                recorder.write_rows(from, &self.colors, layer, row..row + 1)?;
            }
            recorder.submit()?;
        }
        Ok(())
    }

    /// Returns the page of a row, and its row within the page.
    pub(super) fn place(&self, row: u32) -> (usize, u32) {
        ((row / self.page_rows) as usize, row % self.page_rows)
    }
}

/// Returns the number of chunks whose positions, and of those whose colors, fit into the budget. Positions
/// can be streamed within a frame, colors cannot: they take half of the budget, which is four times as many
/// as positions, or up to three quarters if all of them fit then.
fn rows_within(device: &Device, chunks: u64, limits: StoreLimits) -> Result<[u64; 2], GpuError> {
    let Some(bytes) = limits.bytes.filter(|b| *b < chunks * (ROW_BYTES + COLOR_ROW_BYTES)) else {
        return Ok([chunks; 2]);
    };
    let least = chunks.min(2 * u64::from(limits.streamed_rows));
    let positions_beside = |colors: u64| bytes.saturating_sub(colors * COLOR_ROW_BYTES) / ROW_BYTES;
    let fit = chunks * COLOR_ROW_BYTES <= bytes / 4 * 3 && positions_beside(chunks) >= least;
    let colors = if fit { chunks } else { chunks.min(bytes / 2 / COLOR_ROW_BYTES) };
    let positions = positions_beside(colors);
    if positions < least {
        let needed = (2 * least * ROW_BYTES).min(chunks * COLOR_ROW_BYTES + least * ROW_BYTES);
        let expected = format!("at least {} MiB for points", needed.div_ceil(1 << 20));
        return Err(device.unsupported(expected, format!("{} MiB allowed (--gpu-memory)", bytes >> 20)));
    }
    Ok([chunks.min(positions), colors])
}

fn page(
    device: &Arc<Device>,
    commands: &mut Commands,
    layout: &PipelineLayout,
    rows: u32,
) -> Result<Page, GpuError> {
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
    empty(commands, &image)?;
    let set = DescriptorSet::new(layout, PAGE_SET, vec![Bind::Image(image.clone())])?;
    Ok(Page { image, set })
}

/// Creates the array image of colors: row `i` is row `i % IMAGE_ROWS` of layer `i / IMAGE_ROWS`.
fn colors(device: &Arc<Device>, commands: &mut Commands, rows: u32) -> Result<Arc<Image>, GpuError> {
    let rows = rows.max(1);
    let image = Arc::new(Image::new(
        device,
        &ImageDesc {
            name: "colors",
            width: CHUNK as u32,
            height: rows.min(IMAGE_ROWS),
            layers: Some(rows.div_ceil(IMAGE_ROWS)),
            format: vk::Format::R32_UINT,
            usage: ImageUsageFlags::SAMPLED | ImageUsageFlags::TRANSFER_DST,
        },
    )?);
    empty(commands, &image)?;
    Ok(image)
}

/// Brings a new image into its read layout.
fn empty(commands: &mut Commands, image: &Image) -> Result<(), GpuError> {
    let mut recorder = commands.begin()?;
    recorder.forget(image);
    recorder.submit().map(drop)
}

/// Fills rows of [`CHUNK`] values in parallel. `fill` receives the number of the row, the row, and memory for
/// reading points.
///
/// # Errors
/// Returns the first error in the order of the rows.
pub(super) fn fill_rows<T: bytemuck::Pod + Send>(
    bytes: &mut [u8],
    fill: impl Fn(usize, &mut [T], &mut Vec<Point>) -> Result<(), FileError> + Sync,
) -> Result<(), FileError> {
    let rows = bytes.par_chunks_mut(CHUNK * size_of::<T>()).enumerate();
    let filled =
        rows.map_init(Vec::new, |buffer, (row, bytes)| fill(row, bytemuck::cast_slice_mut(bytes), buffer));
    filled.find_first(Result::is_err).unwrap_or(Ok(()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::DeviceDesc;

    #[test]
    fn budgets_are_divided_between_positions_and_colors() {
        let device = Device::new(&DeviceDesc::from_env()).unwrap();
        let rows = |chunks, bytes| {
            let limits = StoreLimits { bytes, page_rows: None, streamed_rows: 2 };
            rows_within(&device, chunks, limits)
        };
        assert_eq!(rows(1000, None).unwrap(), [1000; 2]);
        assert_eq!(rows(1000, Some(1000 * (ROW_BYTES + COLOR_ROW_BYTES))).unwrap(), [1000; 2]);
        // Half of 100 rows of positions are 200 rows of colors.
        assert_eq!(rows(1000, Some(100 * ROW_BYTES)).unwrap(), [50, 200]);
        assert_eq!(rows(120, Some(100 * ROW_BYTES)).unwrap(), [70, 120]);
        assert_eq!(rows(300, Some(100 * ROW_BYTES)).unwrap(), [25, 300]);
        assert_eq!(rows(301, Some(100 * ROW_BYTES)).unwrap(), [50, 200]);
        assert_eq!(rows(1000, Some(8 * ROW_BYTES)).unwrap(), [4, 16]);
        let message = rows(1000, Some(7 * ROW_BYTES)).unwrap_err().to_string();
        assert!(
            message.contains("at least 1 MiB for points") && message.contains("0 MiB allowed"),
            "{message}"
        );
    }
}
