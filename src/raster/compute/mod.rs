//! The compute rasterizer: visibility buffers with 64-bit atomics instead of a depth test.
//!
//! # How it works
//! Points are stored in images, one chunk of 4096 neighboring points per row (`chunk`, `store`). A frame is a
//! list of instances in one numbering (`plan`). Its views are row strips ("bands") of one visibility buffer
//! per cloud (`bands`, `layers`). Only chunks that may be visible in a view are drawn (`cull`), in one
//! dispatch per page and kind for all views. Each point writes its pixel with an atomic minimum of `depth <<
//! 32 | number` (`project`). Radii never increase with depth, so a nearer point in the same pixel covers
//! everything that a farther one covers, and one key per pixel suffices. With radii of at most 2 the resolve
//! shaders gather the neighborhood of each pixel that the result reads, and write the maps (`resolve`). With
//! larger radii (`coverage`) either the points write all pixels of their squares, or several passes spread
//! the keys (`passes`, `spread`). All passes of a frame are one submit (`record`) with buffers of its own
//! (`slot`), so the next frame can be begun meanwhile. Only streaming, and views that do not fit into one
//! batch ("part"), take several submits.
//!
//! Chunks are loaded when a camera may see them. If the memory budget is used up, the least recently drawn
//! ones are evicted (`residency`): positions even within a frame, while the colors of all that a frame may
//! show stay.
//!
//! # What was measured
//! On lavapipe, 4 million points, in ms: workgroups of eight neighboring points instead of 64 took project
//! from 42 to 30, near chunks first from 53 to 45, keys in tiles of 32 columns instead of image rows from 49
//! to 44, bounds of 1024 instead of 4096 points from 45 to 41. Without gain: reading the key before the
//! atomic; splatting squares into the pixels that the reduction reads (110 instead of 54); maps as storage
//! images instead of buffers (125 instead of 100); skipping tiles that no chunk covers (none was empty);
//! prefetching the next row of keys (62 instead of 53). Occlusion culling would need a pass over all keys.

mod bands;
mod coverage;
mod passes;
mod phases;
mod plan;
mod project;
mod record;
mod resolve;
mod results;
mod shared;
mod slot;
mod spread;
mod store;
mod tables;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use self::bands::{PartLimits, Partition, RowStrip};
use self::coverage::Coverage;
use self::phases::Phases;
use self::plan::{BandResult, BatchPlan, Numbering, PlannedItem, Work};
use self::project::{ProjectFrame, ProjectStage, items_of};
use self::record::{PlacedItem, Resolve, runs_of};
use self::resolve::ResolveStage;
use self::results::{OwnedMaps, empty, read_maps, read_parts};
use self::shared::{KEY_IMAGE_ROW_BYTES, KEY_STEP_BYTES, KeyCapacity, Shared};
use self::slot::{Slot, SlotCapacities};
use self::spread::SpreadStage;
use self::store::{COLOR_ROW_BYTES, ROW_BYTES, STREAMED_ROWS, Store, StoreLimits};
use super::chunk::ChunkedCloud;
use super::frame::frame_by_views;
use super::layers::Layers;
use super::residency::Residency;
use super::sight::{SeenInstance, seen_chunks, seen_instances};
use super::{
    CloudSet, DEFAULT_MEMORY_BYTES, FRAMES_IN_FLIGHT, FrameJob, FrameMaps, MapSet, Occlusion, RasterError,
    Rasterizer, RasterizerInfo, SplatJob, SplatMaps, StageTimes,
};
use crate::geometry::ImageSize;
use crate::gpu::{Commands, Device, GpuError, PendingSubmit};

/// Partitioning of a [`ComputeRasterizer`]'s work; the default uses the device's limits. Results never depend
/// on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ComputeRasterizerDesc {
    /// Memory budget for points on the device, bytes (20 per point); beyond it points are streamed. `None`
    /// for no limit, and for [`DEFAULT_MEMORY_BYTES`] on a device that is the host's processor.
    pub memory_bytes: Option<u64>,
    /// Maximum number of 4096-point chunks per image.
    pub page_rows: Option<u32>,
    /// Maximum number of key rows per batch.
    pub key_rows: Option<u32>,
    /// Maximum number of 4096-point chunks streamed at once; the budget must hold twice as many.
    pub streamed_rows: Option<u32>,
    /// Use device-only memory and copies, as on a GPU, even if host and device share memory.
    pub copies: bool,
}

/// Rasterizer with clouds on a Vulkan device.
pub struct ComputeRasterizer<'a> {
    device: Arc<Device>,
    commands: Commands,
    clouds: Vec<ChunkedCloud<'a>>,
    /// Of positions.
    residency: Residency,
    /// Of colors.
    colors: Residency,
    shared: Arc<Shared>,
    /// Frames in flight, used in rotation; the last slot is reserved for synchronous work.
    slots: Vec<PendingSubmit<Shared, Slot>>,
    turn: usize,
    in_flight: VecDeque<FrameState>,
    limits: PartLimits,
    copies: bool,
    threads: usize,
    stages: StageTimes,
}

/// State of a begun frame.
enum FrameState {
    /// In flight.
    InFlight { slot: usize, results: Vec<BandResult>, sizes: Vec<ImageSize>, wanted: MapSet },
    /// Rendered synchronously.
    Done(FrameMaps<'static>),
}

/// Slot for synchronous work.
const SYNC_SLOT: usize = FRAMES_IN_FLIGHT;

impl<'a> ComputeRasterizer<'a> {
    /// Returns whether the device supports 64-bit integers and atomics in compute shaders.
    pub fn supported(device: &Device) -> bool {
        device.atomics_64()
    }

    /// Creates a rasterizer of clouds, whose points are loaded when they may be seen.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the device lacks a required feature.
    pub fn new(device: Arc<Device>, clouds: &CloudSet<'a>) -> Result<Self, GpuError> {
        Self::with_desc(device, clouds, ComputeRasterizerDesc::default())
    }

    /// Creates a rasterizer with other limits.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the device lacks a required feature.
    pub fn with_desc(
        device: Arc<Device>,
        clouds: &CloudSet<'a>,
        desc: ComputeRasterizerDesc,
    ) -> Result<Self, GpuError> {
        if !Self::supported(&device) {
            let expected =
                "64-bit atomics on buffers for the compute rasterizer (graphics and cpu need none)";
            return Err(device.unsupported(expected, "none (VK_KHR_shader_atomic_int64)"));
        }
        let mut stages = StageTimes::default();
        let start = Instant::now();
        let project = Arc::new(ProjectStage::new(&device)?);
        let (full, reduced) = (ResolveStage::full(&device)?, ResolveStage::reduced(&device)?);
        let mut commands = Commands::new(&device)?;
        stages.add("set-up", start.elapsed());
        let start = Instant::now();
        let clouds: Vec<ChunkedCloud<'a>> = clouds.iter().map(|cloud| ChunkedCloud::new(*cloud)).collect();
        stages.add("sort", start.elapsed());
        let start = Instant::now();
        let streamed_rows = desc.streamed_rows.unwrap_or(STREAMED_ROWS).max(1);
        let bytes = desc.memory_bytes.or(device.is_cpu().then_some(DEFAULT_MEMORY_BYTES));
        let limits = StoreLimits { bytes, page_rows: desc.page_rows, streamed_rows };
        let (store, [residency, colors]) =
            Store::new(&device, &mut commands, project.layout(), &clouds, limits)?;
        stages.add("upload", start.elapsed());
        let copies = desc.copies || !device.shares_memory();
        let bare = Shared {
            project,
            spread: Arc::new(SpreadStage::new(&device)?),
            full: Arc::new(full),
            reduced: Arc::new(reduced),
            store: Arc::new(store),
            layers: Vec::new(),
            windows: None,
            room: KeyCapacity::default(),
            generation: 0,
            streamed_rows,
        };
        let room = KeyCapacity { layers: 1, ..KeyCapacity::default() };
        let shared = Arc::new(bare.with_keys(&device, &mut commands, room, desc.copies)?);
        let slot = |commands: &mut Commands| -> Result<_, GpuError> {
            PendingSubmit::new(
                &device,
                Slot::new(&device, commands, &shared, SlotCapacities::default(), copies)?,
            )
        };
        let slots = (0..=SYNC_SLOT).map(|_| slot(&mut commands)).collect::<Result<Vec<_>, _>>()?;
        let limits = part_limits(&device, desc);
        let threads =
            if device.is_cpu() { std::thread::available_parallelism().map_or(1, usize::from) } else { 1 };
        device.check_validation()?;
        Ok(Self {
            device,
            commands,
            clouds,
            residency,
            colors,
            shared,
            slots,
            turn: 0,
            in_flight: VecDeque::new(),
            limits,
            copies,
            threads,
            stages,
        })
    }

    /// Submits a job that fits into one batch, or renders any other job synchronously.
    fn begin_job(&mut self, job: &FrameJob<'_>, slot: usize) -> Result<FrameState, RasterError> {
        let sizes: Vec<ImageSize> = job.views.iter().map(|view| job.size_of(view)).collect();
        let layers = Layers::of(job);
        if layers.count == 0 || sizes.is_empty() {
            return Ok(FrameState::Done(sizes.iter().map(|size| empty(*size)).collect()));
        }
        let Some(cut) = Partition::new(job, self.limits)? else {
            // The shaders cannot upscale: render at full size, then resample on the host.
            return frame_by_views(job, &mut |job| self.splat(job)).map(FrameState::Done);
        };
        let start = Instant::now();
        let seen = seen_instances(job, &layers, &self.clouds)?;
        self.load_colors(job, &seen)?;
        let numbering = Numbering::new(&seen, &self.clouds, &self.colors)?;
        self.stages.add("plan", start.elapsed());
        let work = Work { job, layers, cut: &cut, numbering: &numbering };
        if let [part] = cut.parts.as_slice() {
            let results = self.draw_part(&work, part, slot)?;
            return Ok(FrameState::InFlight { slot, results, sizes, wanted: job.maps });
        }
        let mut maps: Vec<OwnedMaps> = sizes.iter().map(|size| OwnedMaps::new(*size, job.maps)).collect();
        for part in &cut.parts {
            let results = self.draw_part(&work, part, SYNC_SLOT)?;
            self.wait(SYNC_SLOT)?;
            read_parts(self.slots[SYNC_SLOT].own(), &results, job.maps, &mut maps)?;
        }
        Ok(FrameState::Done(maps.into_iter().map(OwnedMaps::done).collect()))
    }

    /// Loads the colors of the chunks that a camera may see.
    fn load_colors(&mut self, job: &FrameJob<'_>, seen: &[SeenInstance]) -> Result<(), RasterError> {
        if self.colors.is_complete() || !job.maps.intersects(MapSet::RGB_CLASS) {
            return Ok(());
        }
        self.colors.next_frame();
        let mut needed = seen_chunks(job, seen, &self.clouds);
        // The points of a reordered chunk have numbers from any chunk.
        let reordered = |cloud: u32| self.clouds[cloud as usize].order().is_some();
        let whole =
            |cloud: u32| (0..self.clouds[cloud as usize].chunks() as u32).map(move |chunk| (cloud, chunk));
        let all: BTreeSet<u32> =
            needed.iter().map(|(cloud, _)| *cloud).filter(|cloud| reordered(*cloud)).collect();
        needed.retain(|(cloud, _)| !reordered(*cloud));
        needed.extend(all.into_iter().flat_map(whole));
        if needed.len() > self.colors.rows() {
            let [needed, allowed] =
                [needed.len(), self.colors.rows()].map(|rows| 2 * rows as u64 * COLOR_ROW_BYTES);
            let (needed_bytes, allowed_bytes) = (needed, allowed);
            return Err(RasterError::PointBudget { needed_bytes, allowed_bytes, option: "--gpu-memory" });
        }
        needed.retain(|(cloud, chunk)| self.colors.row(*cloud, *chunk).is_none());
        let rows = self.colors.oldest(needed.len());
        rows.iter().for_each(|row| self.colors.forget(*row));
        let loads: Vec<(u32, u32, u32)> =
            needed.iter().zip(rows).map(|((cloud, chunk), row)| (*cloud, *chunk, row)).collect();
        self.shared.store.load_colors(&self.device, &mut self.commands, &self.clouds, &loads)?;
        loads.iter().for_each(|(cloud, chunk, row)| self.colors.replace(*cloud, *chunk, *row));
        Ok(())
    }

    /// Plans and submits a batch: first the resident chunks, then the streamed ones, then the resolve.
    fn draw_part(
        &mut self,
        work: &Work<'_>,
        part: &[RowStrip],
        slot: usize,
    ) -> Result<Vec<BandResult>, RasterError> {
        // After an error the previous batch may still be in flight.
        self.wait(slot)?;
        let start = Instant::now();
        let plan = BatchPlan::new(work.job, work.cut, part, work.numbering, &self.clouds);
        self.residency.next_frame();
        let covering = Coverage::choose(work.job.schedule, &plan.items, work.cut.key_pixels(plan.key_rows));
        let (mut placed, mut missing) = (Vec::with_capacity(plan.items.len()), Vec::new());
        for item in &plan.items {
            match self.residency.row(item.cloud, item.chunk) {
                Some(row) => placed.extend(self.place(item, row, covering)),
                None => missing.push(*item),
            }
        }
        let (items, runs) = runs_of(&placed, self.threads);
        let most =
            items.len() + missing.iter().map(|item| self.place(item, 0, covering).count()).sum::<usize>();
        self.prepare(work, &plan, slot, (most, !missing.is_empty(), covering))?;
        let frame = ProjectFrame::new(work.job.schedule, plan.key_rows, work.cut.pad);
        let own = self.slots[slot].own();
        own.write(&frame, &plan, &work.numbering.blocks)?;
        own.write_items(&items)?;
        self.stages.add("plan", start.elapsed());
        let (bands, pixels, key_rows) = (plan.resolve_bands.as_slice(), plan.pixels, plan.key_rows);
        let device = self.device.clone();
        let resolve = Resolve { work, bands, pixels, key_rows };
        let phases = Phases { device: &device, resolve, covering, bands: &plan.project_bands };
        let flight = &mut self.slots[slot];
        if missing.is_empty() {
            phases.start(flight, &self.shared, (true, true), &runs)?;
        } else {
            phases.start(flight, &self.shared, (true, false), &runs)?;
            self.stream(&phases, &missing, slot)?;
            phases.start(&mut self.slots[slot], &self.shared, (false, true), &[])?;
        }
        Ok(plan.results)
    }

    /// Streams and projects chunks that are not resident, a bounded number of rows at a time.
    fn stream(
        &mut self,
        phases: &Phases<'_>,
        missing: &[PlannedItem],
        slot: usize,
    ) -> Result<(), RasterError> {
        let mut chunks: Vec<(u32, u32)> = missing.iter().map(|item| (item.cloud, item.chunk)).collect();
        chunks.sort_unstable();
        chunks.dedup();
        for batch in chunks.chunks(self.shared.streamed_rows as usize) {
            self.wait(slot)?;
            let start = Instant::now();
            let rows = self.residency.oldest(batch.len());
            // These rows count as empty until their upload is submitted.
            rows.iter().for_each(|row| self.residency.forget(*row));
            let row_of: BTreeMap<(u32, u32), u32> = batch.iter().copied().zip(rows.iter().copied()).collect();
            let mut placed = Vec::new();
            for item in missing {
                let row = row_of.get(&(item.cloud, item.chunk));
                placed.extend(row.into_iter().flat_map(|row| self.place(item, *row, phases.covering)));
            }
            let (items, runs) = runs_of(&placed, self.threads);
            let own = self.slots[slot].own();
            own.write_items(&items)?;
            if let Some(staging) = &own.staging {
                let bytes = &mut staging.map()?[..batch.len() * ROW_BYTES as usize];
                store::fill_rows(bytes, |row, words: &mut [[u32; 4]], buffer| {
                    let (cloud, chunk) = batch[row];
                    self.clouds[cloud as usize].write_row(chunk as usize, words, buffer)
                })?;
            }
            self.stages.add("stream from host", start.elapsed());
            phases.stream(&mut self.slots[slot], &self.shared, &rows, &runs)?;
            row_of.iter().for_each(|(&(cloud, chunk), row)| self.residency.replace(cloud, chunk, *row));
        }
        self.wait(slot)
    }

    fn place(
        &self,
        item: &PlannedItem,
        row: u32,
        covering: Coverage,
    ) -> impl Iterator<Item = PlacedItem> + use<> {
        let (page, row) = self.shared.store.place(row);
        let crop = item.crop;
        items_of(item.draw, row, item.points, covering).map(move |item| PlacedItem { page, crop, item })
    }

    /// Creates larger buffers if the current ones are too small.
    fn prepare(
        &mut self,
        work: &Work<'_>,
        plan: &BatchPlan,
        slot: usize,
        (items, streams, covering): (usize, bool, Coverage),
    ) -> Result<(), GpuError> {
        let room = self.shared.room.grown(KeyCapacity {
            layers: work.layers.count,
            bytes: work.cut.key_bytes(plan.key_rows),
            windows: covering == Coverage::Spread,
        });
        if room != self.shared.room {
            // Frames in flight own references to the old buffers.
            let copied = self.shared.layers[0].copied;
            let shared = self.shared.with_keys(&self.device, &mut self.commands, room, copied)?;
            self.shared = Arc::new(shared);
        }
        let wanted = Slot::wanted(work.job.maps);
        let needs = SlotCapacities {
            draws: plan.draws.len(),
            bands: plan.project_bands.len(),
            items,
            taps: plan.taps.len(),
            blocks: work.numbering.blocks.len(),
            pixels: wanted.map(|wanted| if wanted { plan.pixels } else { 0 }),
            streams,
        };
        let own = self.slots[slot].own();
        if own.generation != self.shared.generation || !own.needs.covers(&needs) {
            let needs = own.needs.grown(&needs);
            let own = Slot::new(&self.device, &mut self.commands, &self.shared, needs, self.copies)?;
            *self.slots[slot].own_mut()? = own;
        }
        Ok(())
    }

    fn wait(&mut self, slot: usize) -> Result<(), RasterError> {
        for (stage, time) in self.slots[slot].wait()? {
            self.stages.add(stage, time);
        }
        Ok(())
    }

    /// Waits for a begun frame and returns its maps.
    fn maps_of(&mut self, state: FrameState) -> Result<FrameMaps<'_>, RasterError> {
        match state {
            FrameState::Done(maps) => Ok(maps),
            FrameState::InFlight { slot, results, sizes, wanted } => {
                self.wait(slot)?;
                read_maps(self.slots[slot].own(), &results, &sizes, wanted)
            }
        }
    }
}

fn part_limits(device: &Device, desc: ComputeRasterizerDesc) -> PartLimits {
    let key_rows = desc.key_rows.unwrap_or(u32::MAX);
    let bytes = device.max_storage_buffer();
    let image_bytes = u64::from(device.max_image_side()) * KEY_IMAGE_ROW_BYTES;
    let key_bytes = bytes.min(image_bytes) / KEY_STEP_BYTES * KEY_STEP_BYTES;
    PartLimits { key_bytes, key_rows, pixels: bytes / 8 * 2 }
}

impl Rasterizer for ComputeRasterizer<'_> {
    fn info(&self) -> RasterizerInfo {
        RasterizerInfo::on("compute", &self.device)
    }

    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
        if self.in_flight.len() == FRAMES_IN_FLIGHT {
            return Err(RasterError::TooManyFrames { max: FRAMES_IN_FLIGHT });
        }
        let slot = self.turn;
        let state = self.begin_job(job, slot)?;
        self.turn = (slot + 1) % FRAMES_IN_FLIGHT;
        self.in_flight.push_back(state);
        Ok(())
    }

    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
        let state = self.in_flight.pop_front().ok_or(RasterError::NoFrame)?;
        self.maps_of(state)
    }

    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
        let packed = if job.maps.intersects(MapSet::RGB_CLASS) { MapSet::RGB_CLASS } else { MapSet::NONE };
        let frame = FrameJob {
            views: std::slice::from_ref(job.view),
            schedule: job.schedule,
            color: job.instances,
            geometry: job.instances,
            occlusion: Occlusion::Scene,
            crop: job.crop,
            maps: job.maps | packed,
            out_size: None,
        };
        let state = self.begin_job(&frame, SYNC_SLOT)?;
        let (width, height) = (job.view.camera.width, job.view.camera.height);
        let mut maps = SplatMaps { width, height, ..SplatMaps::default() };
        for view in self.maps_of(state)? {
            maps.point = view.point.into_owned();
            maps.depth_m = view.depth_m.into_owned();
            maps.rgb_class = view.rgb_class.into_owned();
            maps.instance = view.instance.into_owned();
        }
        Ok(maps)
    }

    fn stages(&mut self) -> &mut StageTimes {
        &mut self.stages
    }
}
