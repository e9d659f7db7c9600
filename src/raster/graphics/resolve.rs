//! Visibility buffer to maps: a compute shader resolves the winner of each pixel (`glsl/resolve.comp`).
//!
//! # How it works
//! A pixel contains a point within a page and a piece; the table of pieces maps them to the job's numbering.
//! Only one page can be bound at a time, so each drawn page has a dispatch; the first one also writes the
//! planes that need no page. All planes are concatenated in one buffer.

use std::sync::Arc;

use ash::vk::BufferUsageFlags as Usage;
use bytemuck::{Pod, Zeroable};

use super::pages::{Pages, Piece};
use super::splat::SplatTarget;
use crate::gpu::{
    Bind, Buffer, BufferDesc, ComputePipeline, DescriptorSet, Device, GpuError, Memory, PipelineLayout,
    Recorder, Scope, assert_layout, shaders,
};
use crate::raster::tiles::Tile;
use crate::raster::{MapKind, MapSet};

/// Offset of a plane that is not requested.
const NOT_WANTED: u32 = u32::MAX;
/// Bytes per pixel if all planes are requested.
pub(super) const MAX_PIXEL_BYTES: u64 = 16;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct ResolvePush {
    width: u32,
    page: u32,
    first: u32,
    point_at: u32,
    depth_at: u32,
    rgb_class_at: u32,
    instance_at: u32,
}
assert_layout!(ResolvePush, shaders::resolve_comp::resolve_push, [
    width: WIDTH,
    page: PAGE,
    first: FIRST,
    point_at: POINT_AT,
    depth_at: DEPTH_AT,
    rgb_class_at: RGB_CLASS_AT,
    instance_at: INSTANCE_AT,
]);

/// Offset of each requested plane in the buffer of planes, pixels, and the total size, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PlaneOffsets {
    pub(super) point: Option<usize>,
    pub(super) depth: Option<usize>,
    pub(super) rgb_class: Option<usize>,
    pub(super) instance: Option<usize>,
    pub(super) total: usize,
}

impl PlaneOffsets {
    pub(super) fn new(maps: MapSet, pixels: usize) -> Self {
        let mut total = 0;
        let mut next = |wanted: bool| {
            let at = wanted.then_some(total);
            total += if wanted { pixels } else { 0 };
            at
        };
        let (point, depth) = (next(maps.contains(MapKind::Point)), next(maps.contains(MapKind::Depth)));
        let rgb_class = next(maps.intersects(MapSet::RGB_CLASS));
        let instance = next(maps.contains(MapKind::Instance));
        Self { point, depth, rgb_class, instance, total }
    }
}

/// Resources independent of image sizes.
pub(super) struct ResolveStage {
    pipeline: ComputePipeline,
}

/// Buffers for images of one size.
pub(super) struct ResolveTarget {
    set: DescriptorSet,
    pieces: Arc<Buffer>,
    planes: Arc<Buffer>,
    /// Planes for the host, laid out by [`PlaneOffsets`].
    pub(super) readback: Buffer,
}

impl ResolveTarget {
    /// Returns the number of pieces that its table can hold.
    pub(super) fn piece_capacity(&self) -> u64 {
        self.pieces.size() / size_of::<Piece>() as u64
    }
}

impl ResolveStage {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        Ok(Self { pipeline: ComputePipeline::new(device, &shaders::resolve_comp::SHADER)? })
    }

    /// Returns the layout for the descriptor sets of pages.
    pub(super) fn layout(&self) -> &PipelineLayout {
        self.pipeline.layout()
    }

    /// Creates buffers for tiles in these images and for up to `pieces` pieces.
    pub(super) fn target(
        &self,
        device: &Arc<Device>,
        splat: &SplatTarget,
        pieces: u64,
    ) -> Result<ResolveTarget, GpuError> {
        let pixels = u64::from(splat.depth.width()) * u64::from(splat.depth.height());
        let buffer =
            |name, size, usage, memory| Buffer::new(device, &BufferDesc { name, size, usage, memory });
        let size = pieces.max(1) * size_of::<Piece>() as u64;
        let usage = Usage::STORAGE_BUFFER | Usage::TRANSFER_DST;
        let pieces = Arc::new(buffer("pieces", size, usage, Memory::Device)?);
        let (size, usage) = (pixels * MAX_PIXEL_BYTES, Usage::STORAGE_BUFFER | Usage::TRANSFER_SRC);
        let planes = Arc::new(buffer("planes", size, usage, Memory::Device)?);
        let readback = buffer("planes for the host", size, Usage::TRANSFER_DST, Memory::Readback)?;
        let binds = vec![
            Bind::Image(splat.visibility.clone()),
            Bind::Image(splat.depth.clone()),
            Bind::Buffer(pieces.clone()),
            Bind::Buffer(planes.clone()),
        ];
        let set = DescriptorSet::new(self.layout(), 0, binds)?;
        Ok(ResolveTarget { set, pieces, planes, readback })
    }

    /// Records the resolve of one tile with at least one drawn piece, and the copy of the planes to the host.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        target: &'a ResolveTarget,
        tile: &Tile,
        (pages, table): (&'a Pages, &[Piece]),
        maps: MapSet,
    ) -> Result<(), GpuError> {
        let offsets = PlaneOffsets::new(maps, tile.area());
        let at = |offset: Option<usize>| offset.map_or(NOT_WANTED, |o| o as u32);
        recorder.update(&target.pieces, 0, bytemuck::cast_slice(table))?;
        recorder.barrier(Scope::CopyWrite, Scope::ShaderRead);
        for (i, page) in Pages::used(table, maps).into_iter().enumerate() {
            if i > 0 {
                recorder.barrier(Scope::Compute, Scope::Compute);
            }
            let push = ResolvePush {
                width: tile.size[0],
                page,
                first: u32::from(i == 0),
                point_at: at(offsets.point),
                depth_at: at(offsets.depth),
                rgb_class_at: at(offsets.rgb_class),
                instance_at: at(offsets.instance),
            };
            let sets = [&target.set, &pages.pages[page as usize].set];
            recorder.dispatch(&self.pipeline, &sets, bytemuck::bytes_of(&push), tile.size)?;
        }
        recorder.stamp("resolve");
        recorder.barrier(Scope::Compute, Scope::CopyRead);
        recorder.copy((&target.planes, 0), (&target.readback, 0), 4 * offsets.total as u64)?;
        recorder.barrier(Scope::CopyWrite, Scope::Host);
        recorder.stamp("readback");
        Ok(())
    }
}
