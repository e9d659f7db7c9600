//! The rasterizer on Vulkan's graphics pipeline: splat, resolve, read back.

mod pages;
mod resolve;
mod splat;

use std::sync::Arc;
use std::time::Instant;

use self::pages::{Pages, Piece, PieceDraw};
use self::resolve::{MAX_PIXEL_BYTES, PlaneOffsets, ResolveStage, ResolveTarget};
use self::splat::{SplatStage, SplatTarget, check_point_size};
use super::chunk::ChunkedCloud;
use super::draw::draw_from_instance;
use super::frame::frame_by_views;
use super::frames::CompletedFrames;
use super::layers::Layers;
use super::sight::{SeenInstance, seen_chunks, seen_instances};
use super::tiles::{Tile, TileLimits, grown, tiles};
use super::{
    CloudSet, Draw, FrameJob, FrameMaps, MapKind, MapSet, Occlusion, RasterError, Rasterizer, RasterizerInfo,
    SplatJob, SplatMaps, SplatSchedule, StageTimes,
};
use crate::gpu::{Commands, Device, GpuError};

/// Partitioning of a [`GraphicsRasterizer`]'s work; the default uses the device's limits. Results never
/// depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GraphicsRasterizerDesc {
    /// Maximum number of points per buffer; at least 4096.
    pub page_points: Option<u32>,
    /// Memory budget for points on the device, bytes (16 per point). `None` for no limit, and for
    /// [`DEFAULT_MEMORY_BYTES`](super::DEFAULT_MEMORY_BYTES) on a device that is the host's processor.
    pub memory_bytes: Option<u64>,
    /// Maximum side length of a tile, pixels.
    pub tile_side: Option<u32>,
}

/// Rasterizer with clouds on a Vulkan device.
pub struct GraphicsRasterizer<'a> {
    clouds: Vec<ChunkedCloud<'a>>,
    device: Arc<Device>,
    commands: Commands,
    splat: SplatStage,
    resolve: ResolveStage,
    pages: Pages,
    limits: TileLimits,
    targets: Option<Targets>,
    stages: StageTimes,
    done: CompletedFrames,
}

/// Resources that depend on the image size and the number of pieces.
struct Targets {
    splat: SplatTarget,
    resolve: ResolveTarget,
}

/// Initial capacity of the piece table.
const MIN_PIECES: u64 = 256;
/// Maximum area of a tile, pixels: fits the smallest storage buffers among drivers.
const MAX_TILE_AREA: u64 = 1 << 23;

impl<'a> GraphicsRasterizer<'a> {
    /// Creates a rasterizer of clouds, whose points are loaded when they may be seen.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the device lacks a required feature.
    pub fn new(device: Arc<Device>, clouds: &CloudSet<'a>) -> Result<Self, GpuError> {
        Self::with_desc(device, clouds, GraphicsRasterizerDesc::default())
    }

    /// Creates a rasterizer with other limits.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the device lacks a required feature.
    pub fn with_desc(
        device: Arc<Device>,
        clouds: &CloudSet<'a>,
        desc: GraphicsRasterizerDesc,
    ) -> Result<Self, GpuError> {
        let start = Instant::now();
        let (splat, resolve) = (SplatStage::new(&device)?, ResolveStage::new(&device)?);
        let limits = tile_limits(&device, desc.tile_side);
        let commands = Commands::new(&device)?;
        let mut stages = StageTimes::default();
        stages.add("set-up", start.elapsed());
        let start = Instant::now();
        // The order of points decides ties.
        let clouds: Vec<ChunkedCloud> = clouds.iter().map(|cloud| ChunkedCloud::in_order(*cloud)).collect();
        let pages = Pages::new(&device, &clouds, desc.page_points, desc.memory_bytes);
        stages.add("sort", start.elapsed());
        device.check_validation()?;
        Ok(Self {
            clouds,
            device,
            commands,
            splat,
            resolve,
            pages,
            limits,
            targets: None,
            stages,
            done: CompletedFrames::default(),
        })
    }

    /// Creates larger images and buffers if the current ones are too small.
    fn prepare(&mut self, size: [u32; 2], pieces: u64) -> Result<&mut Targets, GpuError> {
        let (mut current, mut capacity) = ([0; 2], MIN_PIECES);
        if let Some(targets) = &self.targets {
            current = [targets.splat.depth.width(), targets.splat.depth.height()];
            capacity = targets.resolve.piece_capacity();
        }
        let wanted = grown(current, size, self.limits);
        let enough = size[0] <= current[0] && size[1] <= current[1] && pieces <= capacity;
        if !enough {
            self.targets = None; // free before allocating
            let capacity = capacity.max(pieces.next_power_of_two());
            let splat = self.splat.target(&self.device, wanted)?;
            let resolve = self.resolve.target(&self.device, &splat, capacity)?;
            return Ok(self.targets.insert(Targets { splat, resolve }));
        }
        let lost = || self.device.unsupported("images to draw into", "none");
        self.targets.as_mut().ok_or_else(lost)
    }

    fn splat_tile(&mut self, tile: &Tile, work: &Work<'_>, maps: &mut SplatMaps) -> Result<(), GpuError> {
        self.prepare(work.tile_size, work.table.len() as u64)?;
        let Some(targets) = &mut self.targets else { return Ok(()) };
        let mut recorder = self.commands.begin()?;
        let drawn = (&self.pages, work.draws, work.pieces);
        self.splat.record(&mut recorder, &targets.splat, tile, work.schedule, drawn)?;
        recorder.stamp("splat");
        let looked_up = (&self.pages, work.table);
        self.resolve.record(&mut recorder, &targets.resolve, tile, looked_up, work.maps)?;
        for (stage, time) in recorder.submit()? {
            self.stages.add(stage, time);
        }
        let start = Instant::now();
        let bytes = targets.resolve.readback.bytes_mut()?;
        read_planes(bytes, tile, work.maps, maps);
        self.stages.add("readback", start.elapsed());
        Ok(())
    }
}

/// Inputs shared by all tiles of a job.
struct Work<'a> {
    draws: &'a [Draw],
    pieces: &'a [PieceDraw],
    table: &'a [Piece],
    schedule: &'a SplatSchedule,
    maps: MapSet,
    /// Size of the largest tile.
    tile_size: [u32; 2],
}

impl Rasterizer for GraphicsRasterizer<'_> {
    fn info(&self) -> RasterizerInfo {
        RasterizerInfo::on("graphics", &self.device)
    }

    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
        self.done.check()?;
        let frame = frame_by_views(job, &mut |job| self.splat(job))?;
        self.done.push(frame);
        Ok(())
    }

    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
        self.done.pop()
    }

    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
        let start = Instant::now();
        let frame = FrameJob {
            views: std::slice::from_ref(job.view),
            schedule: job.schedule,
            color: job.instances,
            geometry: job.instances,
            occlusion: Occlusion::Scene,
            crop: job.crop,
            maps: job.maps | MapSet::of(&[MapKind::Depth]),
            out_size: None,
        };
        let seen = seen_instances(&frame, &Layers::of(&frame), &self.clouds)?;
        let draw =
            |seen: &SeenInstance| draw_from_instance(job, &seen.layered.instance, seen.geometry_points);
        let draws: Vec<Draw> = seen.iter().map(draw).collect();
        check_point_size(&self.device, job.schedule)?;
        let (width, height) = (job.view.camera.width, job.view.camera.height);
        let mut maps = empty_maps(width, height, job.maps);
        let chunks = seen_chunks(&frame, &seen, &self.clouds);
        self.pages.load(&self.device, &mut self.commands, self.resolve.layout(), &self.clouds, &chunks)?;
        let (pieces, table) = self.pages.pieces(&draws, &self.clouds, &chunks);
        self.stages.add("plan", start.elapsed());
        if pieces.is_empty() || !job.maps.intersects(MapSet::SPLATTED) {
            return Ok(maps);
        }
        let tiles = tiles(width, height, self.limits);
        let work = Work {
            draws: &draws,
            pieces: &pieces,
            table: &table,
            schedule: job.schedule,
            maps: job.maps,
            tile_size: tiles.first().map_or([0; 2], |tile| tile.size),
        };
        for tile in &tiles {
            self.splat_tile(tile, &work, &mut maps)?;
        }
        Ok(maps)
    }

    fn stages(&mut self) -> &mut StageTimes {
        &mut self.stages
    }
}

fn tile_limits(device: &Device, side: Option<u32>) -> TileLimits {
    let limits = device.limits();
    let [viewport_width, viewport_height] = limits.max_viewport_dimensions;
    let largest = [
        limits.max_image_dimension2_d,
        limits.max_framebuffer_width,
        limits.max_framebuffer_height,
        // The viewport is padded by the point radius on each side.
        viewport_width - 2 * SplatSchedule::MAX_RADIUS,
        viewport_height - 2 * SplatSchedule::MAX_RADIUS,
    ];
    let largest = largest.into_iter().chain(side).min().unwrap_or(1).max(1);
    let area = (device.max_storage_buffer() / MAX_PIXEL_BYTES).min(MAX_TILE_AREA) as u32;
    TileLimits { side: largest, area }
}

fn empty_maps(width: u32, height: u32, wanted: MapSet) -> SplatMaps {
    let pixels = width as usize * height as usize;
    let zeros = |maps: MapSet| vec![0; if wanted.intersects(maps) { pixels } else { 0 }];
    SplatMaps {
        width,
        height,
        point: zeros(MapSet::of(&[MapKind::Point])),
        depth_m: vec![f32::INFINITY; if wanted.contains(MapKind::Depth) { pixels } else { 0 }],
        rgb_class: zeros(MapSet::RGB_CLASS),
        instance: zeros(MapSet::of(&[MapKind::Instance])),
    }
}

/// Copies the requested planes of a tile to their position in the maps.
fn read_planes(bytes: &[u8], tile: &Tile, wanted: MapSet, maps: &mut SplatMaps) {
    let (pixels, width) = (tile.area(), maps.width);
    let offsets = PlaneOffsets::new(wanted, pixels);
    let read = |at: Option<usize>, map: &mut [u32]| {
        if let Some(at) = at {
            // Byte arrays have no alignment requirement.
            let part: &[[u8; 4]] = bytemuck::cast_slice(&bytes[4 * at..4 * (at + pixels)]);
            tile.copy_into(part, bytemuck::cast_slice_mut(map), width);
        }
    };
    read(offsets.point, &mut maps.point);
    read(offsets.depth, bytemuck::cast_slice_mut(&mut maps.depth_m));
    read(offsets.rgb_class, &mut maps.rgb_class);
    read(offsets.instance, &mut maps.instance);
}
