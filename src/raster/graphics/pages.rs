//! Resident clouds of the graphics-pipeline rasterizer: all points of a scene, concatenated in a few large
//! buffers.
//!
//! A page is a buffer as large as a shader can bind. A cloud that crosses a page boundary has a slice in each
//! page. A piece is a slice drawn with the pose of one instance. Pieces are drawn in the order of their
//! points, so the smallest number still wins ties.

use std::sync::Arc;

use ash::vk::BufferUsageFlags as Usage;
use bytemuck::{Pod, Zeroable};

use crate::cloud::Point;
use crate::gpu::{
    Bind, Buffer, BufferDesc, Commands, DescriptorSet, Device, GpuError, Memory, PipelineLayout, Scope,
    assert_layout, shaders,
};
use crate::raster::{Draw, MapSet};

/// Descriptor set number of a page.
const PAGE_SET: u32 = 1;
const POINT_BYTES: u64 = size_of::<Point>() as u64;
/// Maximum size of the upload's staging buffer, bytes.
const STAGING_BYTES: u64 = 16 << 20;
/// Maximum size of a page, bytes.
const MAX_PAGE_BYTES: u64 = 1 << 30;

/// Range of a cloud's points within one page.
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

/// All clouds on the device.
pub(super) struct Pages {
    pub(super) pages: Vec<Page>,
    /// Slices of each cloud in order.
    slices: Vec<Vec<Slice>>,
}

impl Pages {
    /// Uploads all clouds. Pages have at most `page_points` points, or fewer if the device's limits require
    /// it.
    pub(super) fn upload(
        device: &Arc<Device>,
        commands: &mut Commands,
        resolve: &PipelineLayout,
        clouds: &[&[Point]],
        page_points: Option<u32>,
    ) -> Result<Self, GpuError> {
        let largest = device.max_storage_buffer().min(MAX_PAGE_BYTES) / POINT_BYTES;
        let page_points = page_points.map_or(largest, |p| largest.min(u64::from(p))).max(1);
        let lengths: Vec<u64> = clouds.iter().map(|c| c.len() as u64).collect();
        let slices = plan(&lengths, page_points);
        let mut rest = lengths.iter().sum::<u64>();
        let mut source = Concatenated { clouds, at: 0 };
        let mut staging = None;
        let mut pages = Vec::new();
        while rest > 0 {
            let points = rest.min(page_points);
            rest -= points;
            let staging = match &mut staging {
                Some(staging) => staging,
                none => none.insert(Buffer::new(device, &staging_desc(points * POINT_BYTES))?),
            };
            let size = points * POINT_BYTES;
            let usage = Usage::VERTEX_BUFFER | Usage::STORAGE_BUFFER | Usage::TRANSFER_DST;
            let desc = BufferDesc { name: "page of points", size, usage, memory: Memory::Device };
            let buffer = Arc::new(Buffer::new(device, &desc)?);
            fill(&buffer, &mut source, staging, commands)?;
            let set = DescriptorSet::new(resolve, PAGE_SET, vec![Bind::Buffer(buffer.clone())])?;
            pages.push(Page { points: buffer, set });
        }
        Ok(Self { pages, slices })
    }

    /// Returns the pieces to draw for a job, in order, and the table for resolving its pixels.
    pub(super) fn pieces(&self, draws: &[Draw]) -> (Vec<PieceDraw>, Vec<Piece>) {
        let (mut pieces, mut table) = (Vec::new(), Vec::new());
        for (index, draw) in draws.iter().enumerate() {
            for slice in &self.slices[draw.cloud] {
                let first_number = draw.first_number.wrapping_add(slice.first_in_cloud);
                pieces.push(PieceDraw { draw: index, slice: *slice });
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

fn staging_desc(largest: u64) -> BufferDesc<'static> {
    let size = largest.min(STAGING_BYTES);
    BufferDesc { name: "upload", size, usage: Usage::TRANSFER_SRC, memory: Memory::Upload }
}

/// Fills a page from the next points of the source, in bounded steps.
fn fill(
    page: &Buffer,
    source: &mut Concatenated<'_, '_>,
    staging: &mut Buffer,
    commands: &mut Commands,
) -> Result<(), GpuError> {
    let mut at = 0;
    while at < page.size() {
        let size = staging.size().min(page.size() - at);
        source.read(&mut staging.bytes_mut()?[..size as usize]);
        let mut recorder = commands.begin()?;
        recorder.copy((staging, 0), (page, at), size)?;
        recorder.barrier(Scope::CopyWrite, Scope::ShaderRead);
        recorder.submit()?;
        at += size;
    }
    Ok(())
}

/// Returns the slices of clouds with these lengths, concatenated in pages of `page_points` points.
fn plan(lengths: &[u64], page_points: u64) -> Vec<Vec<Slice>> {
    let mut at = 0;
    let slices = |&length: &u64| {
        let (mut slices, mut done) = (Vec::new(), 0);
        while done < length {
            let (page, first) = (at / page_points, at % page_points);
            let count = (length - done).min(page_points - first);
            let [page, first, count, first_in_cloud] = [page, first, count, done].map(|n| n as u32);
            slices.push(Slice { page, first, count, first_in_cloud });
            done += u64::from(count);
            at += u64::from(count);
        }
        slices
    };
    lengths.iter().map(slices).collect()
}

/// Reads clouds as one byte stream.
struct Concatenated<'c, 'a> {
    clouds: &'c [&'a [Point]],
    /// Number of bytes read from the first cloud.
    at: usize,
}

impl Concatenated<'_, '_> {
    fn read(&mut self, mut out: &mut [u8]) {
        while let (Some((cloud, rest)), false) = (self.clouds.split_first(), out.is_empty()) {
            let bytes = &bytemuck::cast_slice::<Point, u8>(cloud)[self.at..];
            let count = bytes.len().min(out.len());
            let (now, later) = out.split_at_mut(count);
            now.copy_from_slice(&bytes[..count]);
            out = later;
            self.at += count;
            if count == bytes.len() {
                (self.clouds, self.at) = (rest, 0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_are_split_at_page_ends() {
        let slice = |page, first, count, first_in_cloud| Slice { page, first, count, first_in_cloud };
        let expected = vec![
            vec![slice(0, 0, 3, 0)],
            vec![],
            vec![slice(0, 3, 1, 0), slice(1, 0, 4, 1), slice(2, 0, 2, 5)],
            vec![slice(2, 2, 2, 0)],
        ];
        assert_eq!(plan(&[3, 0, 7, 2], 4), expected);
    }

    #[test]
    fn concatenated_clouds_read_as_one_stream() {
        let cloud = |n: u32| -> Vec<Point> {
            (0..n).map(|i| Point { rgb_class: n * 100 + i, ..Point::default() }).collect()
        };
        let clouds = [cloud(3), cloud(0), cloud(5)];
        let slices: Vec<&[Point]> = clouds.iter().map(Vec::as_slice).collect();
        let mut source = Concatenated { clouds: &slices, at: 0 };
        let mut points = [Point::default(); 8];
        for part in points.chunks_mut(3) {
            source.read(bytemuck::cast_slice_mut(part));
        }
        assert_eq!(points.map(|p| p.rgb_class), [300, 301, 302, 500, 501, 502, 503, 504]);
    }
}
