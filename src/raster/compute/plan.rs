//! Shader tables of a batch.

use rayon::prelude::*;

use super::bands::{PAD, Partition, ResolveTap, RowStrip, row_pixels};
use super::tables::{Block, ProjectBand, ProjectDraw, ResolveBand};
use crate::raster::chunk::{CHUNK, ChunkedCloud};
use crate::raster::cull::{joined, seen_blocks};
use crate::raster::draw::draw_from_instance;
use crate::raster::layers::{LayerInstance, Layers};
use crate::raster::residency::Residency;
use crate::raster::sight::SeenInstance;
use crate::raster::{FrameJob, MapSet, RasterError, SplatJob};

/// An instance whose points are numbered from `first` on.
pub(super) struct Numbered {
    layered: LayerInstance,
    first: u32,
}

/// Joint numbering of both clouds of a frame. Each instance starts at a multiple of [`CHUNK`], so that a
/// block belongs to one instance.
pub(super) struct Numbering {
    pub(super) instances: Vec<Numbered>,
    pub(super) blocks: Vec<Block>,
}

impl Numbering {
    /// Numbers the instances that cameras may see; `colors` has the rows of their colors.
    ///
    /// # Errors
    /// Fails for too many points.
    pub(super) fn new(
        seen: &[SeenInstance],
        clouds: &[ChunkedCloud<'_>],
        colors: &Residency,
    ) -> Result<Self, RasterError> {
        let mut numbering = Self { instances: Vec::with_capacity(seen.len()), blocks: Vec::new() };
        for SeenInstance { layered, geometry_points } in seen {
            let id = layered.instance.cloud;
            let chunks = clouds[id].chunks();
            let first = (numbering.blocks.len() * CHUNK) as u64;
            let end = first + (chunks * CHUNK) as u64;
            if end > 1 << 32 {
                return Err(RasterError::TooManyPoints { found: end, max: u64::from(u32::MAX) - 1 });
            }
            let first = first as u32;
            let point = geometry_points.wrapping_add(1).wrapping_sub(first);
            numbering.blocks.extend((0..chunks).map(|chunk| {
                // No point of a chunk without a row is drawn.
                let number = first + (chunk * CHUNK) as u32;
                let color =
                    colors.row_of(id, chunk).unwrap_or(0).wrapping_mul(CHUNK as u32).wrapping_sub(number);
                [color, point, layered.instance.number, 0]
            }));
            numbering.instances.push(Numbered { layered: *layered, first });
        }
        Ok(numbering)
    }
}

/// Inputs shared by all batches of a frame.
pub(super) struct Work<'j> {
    pub(super) job: &'j FrameJob<'j>,
    pub(super) layers: Layers,
    pub(super) cut: &'j Partition,
    pub(super) numbering: &'j Numbering,
}

/// Range of a chunk's points to project, before its row is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlannedItem {
    pub(super) draw: u32,
    pub(super) cloud: u32,
    pub(super) chunk: u32,
    /// First and end point within the chunk.
    pub(super) points: [u32; 2],
    pub(super) crop: bool,
    pub(super) nearest_m: f32,
}

/// Location of a row strip's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BandResult {
    pub(super) band: RowStrip,
    /// Offset in the results, pixels.
    pub(super) pixel: usize,
    /// Row stride, pixels.
    pub(super) row_pixels: usize,
}

/// Tables of a batch.
#[derive(Default)]
pub(super) struct BatchPlan {
    pub(super) project_bands: Vec<ProjectBand>,
    pub(super) resolve_bands: Vec<ResolveBand>,
    pub(super) taps: Vec<ResolveTap>,
    pub(super) draws: Vec<ProjectDraw>,
    /// Sorted by depth, nearest first.
    pub(super) items: Vec<PlannedItem>,
    pub(super) results: Vec<BandResult>,
    /// Total number of key rows.
    pub(super) key_rows: u32,
    /// Total size of the results, pixels.
    pub(super) pixels: usize,
}

/// Jobs per thread for the tests of bounds.
const JOBS_PER_THREAD: usize = 4;

impl BatchPlan {
    pub(super) fn new(
        job: &FrameJob<'_>,
        cut: &Partition,
        part: &[RowStrip],
        numbering: &Numbering,
        clouds: &[ChunkedCloud<'_>],
    ) -> Self {
        let mut plan = Self::default();
        for band in part {
            plan.push_band(job, cut, band);
        }
        let pairs: Vec<(usize, &Numbered)> =
            (0..part.len()).flat_map(|band| numbering.instances.iter().map(move |n| (band, n))).collect();
        let seen = |&(band, numbered): &(usize, &Numbered)| {
            let view = &job.views[part[band].view];
            let (schedule, crop, maps) = (job.schedule, job.crop, MapSet::NONE);
            let instance = &numbered.layered.instance;
            let view_job = SplatJob { view, schedule, instances: &[], crop, maps };
            let draw = draw_from_instance(&view_job, instance, numbered.first);
            let shown = (view.camera.width, part[band].source);
            let (pad, z_far_m) = (cut.pad, schedule.z_far_m());
            let chunks = joined(&seen_blocks(&clouds[instance.cloud], &draw, shown, pad, z_far_m));
            (ProjectDraw::new(&draw, band as u32, numbered.layered.layers), instance.cloud as u32, chunks)
        };
        // Clouds differ in size: several jobs per thread, but not hundreds for small actors.
        let each = pairs.len().div_ceil(JOBS_PER_THREAD * rayon::current_num_threads());
        let seen: Vec<_> = pairs.par_iter().with_min_len(each).map(seen).collect();
        for (draw, cloud, chunks) in seen.into_iter().filter(|(_, _, chunks)| !chunks.is_empty()) {
            let index = plan.draws.len() as u32;
            plan.draws.push(draw);
            plan.items.extend(chunks.iter().map(|seen| PlannedItem {
                draw: index,
                cloud,
                chunk: seen.chunk,
                points: seen.points,
                crop: seen.crop,
                nearest_m: seen.nearest_m,
            }));
        }
        near_first(&mut plan.items, job.schedule.z_far_m());
        plan
    }

    fn push_band(&mut self, job: &FrameJob<'_>, cut: &Partition, band: &RowStrip) {
        let view = &job.views[band.view];
        let size = job.size_of(view);
        let [first, end] = band.source;
        let key_row = self.key_rows;
        self.project_bands.push(ProjectBand {
            columns: view.camera.width as f32,
            rows: (end - first) as f32,
            first_row: first as f32,
            key_row,
        });
        let beyond = cut.pad - PAD;
        let (mut columns, mut rows, mut row_from) = (0, 0, key_row + beyond);
        let mut across = row_pixels(size) as usize;
        if let Some(reductions) = &cut.reductions {
            let reduction = &reductions[band.view];
            columns = self.taps.len() as u32;
            self.taps.extend(&reduction.columns);
            rows = self.taps.len() as u32;
            self.taps.extend(&reduction.rows[band.rows[0] as usize..band.rows[1] as usize]);
            row_from = row_from.wrapping_sub(first);
            across = size.width as usize;
        }
        let height = band.rows[1] - band.rows[0];
        // Shaders write four pixels at a time, as two 64-bit words.
        let pixel = self.pixels.next_multiple_of(4);
        self.resolve_bands.push(ResolveBand {
            width: size.width,
            height,
            key_row: row_from,
            pixel: pixel as u32,
            columns,
            rows,
            pair: beyond / 2,
            pad_1: 0,
        });
        self.results.push(BandResult { band: *band, pixel, row_pixels: across });
        self.pixels = pixel + across * height as usize;
        self.key_rows += band.key_rows(cut.pad);
    }
}

/// Sorts coarsely by depth: later points then mostly fail the depth test, which is cheaper than passing it.
fn near_first(items: &mut Vec<PlannedItem>, z_far_m: f32) {
    const SLICES: usize = 256;
    let slice = |item: &PlannedItem| ((item.nearest_m / z_far_m * SLICES as f32) as usize).min(SLICES - 1);
    let mut starts = [0; SLICES + 1];
    items.iter().for_each(|item| starts[slice(item) + 1] += 1);
    (0..SLICES).for_each(|i| starts[i + 1] += starts[i]);
    let mut sorted = items.clone();
    for item in items.iter() {
        let start = &mut starts[slice(item)];
        sorted[*start] = *item;
        *start += 1;
    }
    *items = sorted;
}

/// Interleaves items so that each thread's contiguous share of a dispatch is sorted nearest first.
pub(super) fn dealt<T: Copy>(items: &[T], threads: usize) -> Vec<T> {
    (0..threads).flat_map(|thread| items.iter().skip(thread).step_by(threads).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(chunk: u32, nearest_m: f32) -> PlannedItem {
        PlannedItem { draw: 0, cloud: 0, chunk, points: [0, 1], crop: false, nearest_m }
    }

    #[test]
    fn near_chunks_come_first() {
        let mut items = vec![item(0, 90.0), item(1, 0.0), item(2, 150.0), item(3, 20.0), item(4, 0.0)];
        near_first(&mut items, 100.0);
        assert_eq!(items.iter().map(|i| i.chunk).collect::<Vec<_>>(), [1, 4, 3, 0, 2]);
    }

    #[test]
    fn items_are_dealt_to_all_threads() {
        assert_eq!(dealt(&[0, 1, 2, 3, 4], 2), [0, 2, 4, 1, 3]);
        assert_eq!(dealt(&[0, 1], 1), [0, 1]);
        assert!(dealt::<u8>(&[], 3).is_empty());
    }
}
