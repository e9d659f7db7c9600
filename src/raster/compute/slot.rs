//! Resources of one frame in flight: tables for the shaders, and results.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use bytemuck::Pod;

use super::bands::ResolveTap;
use super::plan::BatchPlan;
use super::project::ProjectFrame;
use super::shared::Shared;
use super::spread;
use super::store::ROW_BYTES;
use super::tables::{Block, ProjectBand, ProjectDraw, ProjectItem, ResolveBand};
use crate::gpu::{
    Bind, Buffer, BufferDesc, Commands, DescriptorSet, Device, GpuError, Image, ImageDesc, Memory,
};
use crate::raster::chunk::CHUNK;
use crate::raster::{MapKind, MapSet};

/// Number of maps that the shaders write.
pub(super) const MAPS: usize = 4;
pub(super) const RGB_CLASS: usize = 0;
pub(super) const DEPTH: usize = 1;
pub(super) const INSTANCE: usize = 2;
pub(super) const POINT: usize = 3;

/// Required capacities of a slot, in entries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SlotCapacities {
    pub(super) draws: usize,
    pub(super) bands: usize,
    pub(super) items: usize,
    pub(super) taps: usize,
    pub(super) blocks: usize,
    /// Pixels of each map.
    pub(super) pixels: [usize; MAPS],
    /// Whether positions are streamed.
    pub(super) streams: bool,
}

impl SlotCapacities {
    fn each(&self) -> [usize; 9] {
        let [a, b, c, d] = self.pixels;
        [self.draws, self.bands, self.items, self.taps, self.blocks, a, b, c, d]
    }

    pub(super) fn covers(&self, other: &Self) -> bool {
        let enough = self.each().iter().zip(other.each()).all(|(have, need)| *have >= need);
        enough && (self.streams || !other.streams)
    }

    /// Returns capacities that cover both; tables grow to powers of two.
    pub(super) fn grown(&self, other: &Self) -> Self {
        let room = |have: usize, need: usize| if need > have { need.next_power_of_two() } else { have };
        Self {
            draws: room(self.draws, other.draws),
            bands: room(self.bands, other.bands),
            items: room(self.items, other.items),
            taps: room(self.taps, other.taps),
            blocks: room(self.blocks, other.blocks),
            pixels: [0, 1, 2, 3].map(|map| self.pixels[map].max(other.pixels[map])),
            streams: self.streams || other.streams,
        }
    }
}

/// Memory of a map: the buffer that the shaders write, and a host copy if that is separate.
pub(super) struct MapBuffer {
    pub(super) device: Arc<Buffer>,
    pub(super) host: Option<Arc<Buffer>>,
}

impl MapBuffer {
    /// Returns the buffer that the host reads.
    pub(super) fn readable(&self) -> &Arc<Buffer> {
        self.host.as_ref().unwrap_or(&self.device)
    }
}

/// Buffers and descriptor sets of a slot.
pub(super) struct Slot {
    pub(super) needs: SlotCapacities,
    /// Generation of the shared buffers that its descriptor sets bind.
    pub(super) generation: u64,
    frame: Arc<Buffer>,
    draws: Arc<Buffer>,
    project_bands: Arc<Buffer>,
    items: Arc<Buffer>,
    resolve_bands: Arc<Buffer>,
    taps: Arc<Buffer>,
    pub(super) block_rows: Arc<Buffer>,
    pub(super) blocks: Arc<Image>,
    /// Staging buffer for streamed positions.
    pub(super) staging: Option<Arc<Buffer>>,
    pub(super) maps: [MapBuffer; MAPS],
    pub(super) project: DescriptorSet,
    /// One per layer; empty without window buffers.
    pub(super) spread: Vec<[DescriptorSet; spread::SETS]>,
    /// One per layer.
    pub(super) full: Vec<DescriptorSet>,
    /// One per layer.
    pub(super) reduced: Vec<DescriptorSet>,
}

impl Slot {
    /// Creates a slot. With `copies`, results are written to device memory and copied to the host, instead of
    /// written to host memory directly.
    pub(super) fn new(
        device: &Arc<Device>,
        commands: &mut Commands,
        shared: &Shared,
        needs: SlotCapacities,
        copies: bool,
    ) -> Result<Self, GpuError> {
        let frame = upload(device, "frame", size_of::<ProjectFrame>(), Usage::UNIFORM_BUFFER)?;
        let draws = table::<ProjectDraw>(device, "draws", needs.draws)?;
        let project_bands = table::<ProjectBand>(device, "bands to draw", needs.bands)?;
        let items = table::<ProjectItem>(device, "chunks to draw", needs.items)?;
        let resolve_bands = table::<ResolveBand>(device, "bands to resolve", needs.bands)?;
        let taps = table::<ResolveTap>(device, "taps", needs.taps)?;
        let block_count = needs.blocks.max(1).next_multiple_of(CHUNK);
        let block_rows = upload(device, "blocks", block_count * size_of::<Block>(), Usage::TRANSFER_SRC)?;
        let blocks = blocks_image(device, commands, block_count)?;
        let staging = needs.streams.then(|| {
            let bytes = ROW_BYTES as usize * shared.streamed_rows as usize;
            upload(device, "streamed points", bytes, Usage::TRANSFER_SRC)
        });
        let map = |map: usize| map_buffer(device, needs.pixels[map], copies);
        let maps = [map(0)?, map(1)?, map(2)?, map(3)?];
        let key =
            |layer: usize| Bind::Buffer(shared.layers[layer.min(shared.layers.len() - 1)].buffer.clone());
        let buffer = |b: &Arc<Buffer>| Bind::Buffer(b.clone());
        let binds = vec![
            buffer(&frame),
            buffer(&draws),
            buffer(&project_bands),
            buffer(&items),
            key(0),
            key(1),
            key(2),
        ];
        let project = DescriptorSet::new(shared.project.layout(), 0, binds)?;
        let spread = spread_sets(shared, &project_bands)?;
        let resolve_binds = |layer: usize| {
            let mut binds = vec![
                buffer(&resolve_bands),
                Bind::Image(shared.layers[layer].image.clone()),
                Bind::Image(blocks.clone()),
                Bind::Image(shared.store.colors.clone()),
            ];
            binds.extend(maps.iter().map(|map| buffer(&map.device)));
            binds
        };
        let (mut full, mut reduced) = (Vec::new(), Vec::new());
        for layer in 0..shared.layers.len() {
            let mut binds = resolve_binds(layer);
            full.push(DescriptorSet::new(shared.full.layout(), 0, binds.clone())?);
            binds.push(buffer(&taps));
            reduced.push(DescriptorSet::new(shared.reduced.layout(), 0, binds)?);
        }
        Ok(Self {
            needs,
            generation: shared.generation,
            frame,
            draws,
            project_bands,
            items,
            resolve_bands,
            taps,
            block_rows,
            blocks,
            staging: staging.transpose()?,
            maps,
            project,
            spread,
            full,
            reduced,
        })
    }

    /// Returns which of the slot's maps these maps are in.
    pub(super) fn wanted(maps: MapSet) -> [bool; MAPS] {
        let [depth, instance, point] =
            [MapKind::Depth, MapKind::Instance, MapKind::Point].map(|kind| maps.contains(kind));
        [maps.intersects(MapSet::RGB_CLASS), depth, instance, point]
    }

    /// Writes the tables that do not depend on the rows of chunks.
    pub(super) fn write(
        &self,
        frame: &ProjectFrame,
        plan: &BatchPlan,
        blocks: &[Block],
    ) -> Result<(), GpuError> {
        write(&self.frame, std::slice::from_ref(frame))?;
        write(&self.draws, &plan.draws)?;
        write(&self.project_bands, &plan.project_bands)?;
        write(&self.resolve_bands, &plan.resolve_bands)?;
        write(&self.taps, &plan.taps)?;
        write(&self.block_rows, blocks)
    }

    /// Writes the list of chunks to draw.
    pub(super) fn write_items(&self, items: &[ProjectItem]) -> Result<(), GpuError> {
        write(&self.items, items)
    }
}

/// Creates the sets of each layer; empty without window buffers.
fn spread_sets(shared: &Shared, bands: &Arc<Buffer>) -> Result<Vec<[DescriptorSet; spread::SETS]>, GpuError> {
    let Some([a, b]) = &shared.windows else { return Ok(Vec::new()) };
    let sets = |keys: &Arc<Buffer>| {
        let set = |from: &Arc<Buffer>, to: &Arc<Buffer>| {
            let binds = [bands, from, to, keys].map(|buffer| Bind::Buffer(buffer.clone()));
            DescriptorSet::new(shared.spread.layout(), 0, binds.into())
        };
        Ok([set(keys, a)?, set(a, b)?, set(b, a)?])
    };
    shared.layers.iter().map(|layer| sets(&layer.buffer)).collect()
}

fn write<T: Pod>(buffer: &Buffer, values: &[T]) -> Result<(), GpuError> {
    let bytes: &[u8] = bytemuck::cast_slice(values);
    buffer.map()?[..bytes.len()].copy_from_slice(bytes);
    Ok(())
}

fn upload(device: &Arc<Device>, name: &str, size: usize, usage: Usage) -> Result<Arc<Buffer>, GpuError> {
    let desc = BufferDesc { name, size: size.max(16) as u64, usage, memory: Memory::Upload };
    Ok(Arc::new(Buffer::new(device, &desc)?))
}

fn table<T>(device: &Arc<Device>, name: &str, entries: usize) -> Result<Arc<Buffer>, GpuError> {
    upload(device, name, entries.max(1) * size_of::<T>(), Usage::STORAGE_BUFFER)
}

fn blocks_image(device: &Arc<Device>, commands: &mut Commands, count: usize) -> Result<Arc<Image>, GpuError> {
    let image = Arc::new(Image::new(
        device,
        &ImageDesc {
            name: "blocks",
            width: CHUNK as u32,
            height: (count / CHUNK) as u32,
            layers: None,
            format: vk::Format::R32G32B32A32_UINT,
            usage: ImageUsageFlags::SAMPLED | ImageUsageFlags::TRANSFER_DST,
        },
    )?);
    let mut recorder = commands.begin()?;
    recorder.forget(&image);
    recorder.submit()?;
    Ok(image)
}

fn map_buffer(device: &Arc<Device>, pixels: usize, copies: bool) -> Result<MapBuffer, GpuError> {
    let size = (pixels.max(4).next_multiple_of(4) * 4) as u64;
    let usage = Usage::STORAGE_BUFFER | Usage::TRANSFER_SRC | Usage::TRANSFER_DST;
    let buffer = |name, memory| Buffer::new(device, &BufferDesc { name, size, usage, memory }).map(Arc::new);
    if !copies {
        return Ok(MapBuffer { device: buffer("map", Memory::Readback)?, host: None });
    }
    let host = Some(buffer("map for the host", Memory::Readback)?);
    Ok(MapBuffer { device: buffer("map", Memory::Device)?, host })
}
