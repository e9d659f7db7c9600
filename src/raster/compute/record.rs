//! Recording of a frame's commands.

use super::coverage::Coverage;
use super::plan::Work;
use super::project::ProjectPush;
use super::resolve::{ResolvePush, ResolveStage};
use super::shared::{KEY_IMAGE_ROW_BYTES, Shared};
use super::slot::{DEPTH, MapBuffer, Slot};
use super::tables::{ProjectItem, ResolveBand};
use crate::gpu::{DescriptorSet, Device, GpuError, Recorder, Scope};
use crate::raster::layers::Layers;
use crate::raster::{FrameJob, MapKind, MapSet};

/// Both words of an empty key.
const EMPTY_WORD: u32 = 0x7fff_ffff;

/// Chunks of one dispatch: all from one page, and either all cropped or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) page: usize,
    pub(super) crop: bool,
    pub(super) first: u32,
    pub(super) count: u32,
}

/// A chunk to draw, with its location.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PlacedItem {
    pub(super) page: usize,
    pub(super) crop: bool,
    pub(super) item: ProjectItem,
}

/// Groups chunks into dispatches; each preserves their order.
pub(super) fn runs_of(placed: &[PlacedItem], threads: usize) -> (Vec<ProjectItem>, Vec<Run>) {
    let mut kinds: Vec<(usize, bool)> = placed.iter().map(|p| (p.page, p.crop)).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let (mut items, mut runs) = (Vec::with_capacity(placed.len()), Vec::new());
    for (page, crop) in kinds {
        let of_kind = placed.iter().filter(|p| p.page == page && p.crop == crop);
        let of_kind: Vec<ProjectItem> = of_kind.map(|p| p.item).collect();
        runs.push(Run { page, crop, first: items.len() as u32, count: of_kind.len() as u32 });
        items.extend(super::plan::dealt(&of_kind, threads));
    }
    (items, runs)
}

/// Uploads the shared tables and clears the visibility buffers.
pub(super) fn clear<'a>(
    recorder: &mut Recorder<'a>,
    shared: &'a Shared,
    slot: &'a Slot,
    (key_bytes, blocks): (u64, usize),
    layers: usize,
) -> Result<(), GpuError> {
    // The previous frame may still be reading them.
    recorder.barrier(Scope::Compute, Scope::CopyWrite);
    let rows = (blocks.div_ceil(crate::raster::chunk::CHUNK)).max(1) as u32;
    recorder.write_rows((&slot.block_rows, 0), &slot.blocks, 0, 0..rows)?;
    for layer in &shared.layers[..layers] {
        recorder.fill(&layer.buffer, 0, key_bytes, EMPTY_WORD)?;
    }
    recorder.barrier(Scope::CopyWrite, Scope::Compute);
    recorder.stamp("clear");
    Ok(())
}

/// Projects points into the visibility buffers.
pub(super) fn project<'a>(
    recorder: &mut Recorder<'a>,
    shared: &'a Shared,
    slot: &'a Slot,
    runs: &[Run],
    (covering, layers): (Coverage, usize),
) -> Result<(), GpuError> {
    for run in runs {
        let pipeline = shared.project.pipeline(run.crop, layers, covering);
        let push = ProjectPush { first: run.first, count: run.count };
        let sets = [&slot.project, &shared.store.pages[run.page].set];
        recorder.dispatch_groups(pipeline, &sets, bytemuck::bytes_of(&push), push.groups())?;
        recorder.barrier(Scope::Compute, Scope::Compute);
    }
    recorder.stamp("project");
    Ok(())
}

/// Inputs of the resolve passes.
pub(super) struct Resolve<'j> {
    pub(super) work: &'j Work<'j>,
    pub(super) bands: &'j [ResolveBand],
    /// Pixels of each map.
    pub(super) pixels: usize,
    pub(super) key_rows: u32,
}

impl Resolve<'_> {
    /// Resolves keys into maps that the host can read.
    pub(super) fn record<'a>(
        &self,
        recorder: &mut Recorder<'a>,
        device: &Device,
        shared: &'a Shared,
        slot: &'a Slot,
    ) -> Result<(), GpuError> {
        self.copy_keys(recorder, shared)?;
        let reduced = self.work.cut.reductions.is_some();
        let stage: &ResolveStage = if reduced { &shared.reduced } else { &shared.full };
        let sets = if reduced { &slot.reduced } else { &slot.full };
        let semantics = self.work.job.maps & MapSet::ACTORS;
        let geometry = self.work.job.maps & MapSet::GEOMETRY;
        let joint = self.work.cut.reductions.iter().flatten().all(super::bands::Reduction::joint);
        let rows_each = stage.rows_each(device);
        let push = |maps| ResolvePush::new(self.work.job.schedule, rows_each, maps, self.key_rows);
        let groups = stage.groups(self.bands, rows_each);
        let mut dispatch = |layer: Option<usize>, maps: MapSet| -> Result<(), GpuError> {
            let Some(set) = layer.map(|layer| &sets[layer]) else { return Ok(()) };
            let sets: [&'a DescriptorSet; 1] = [set];
            recorder.dispatch_groups(stage.pipeline(maps), &sets, bytemuck::bytes_of(&push(maps)), groups)?;
            recorder.barrier(Scope::Compute, Scope::Compute);
            Ok(())
        };
        let Layers { color, geometry: scene, actors, .. } = self.work.layers;
        let in_scene = if actors.is_none() { semantics } else { MapSet::NONE };
        if joint && color.is_some() && color == scene && in_scene.contains(MapKind::Class) {
            dispatch(color, MapSet::COLOR | geometry | in_scene)?;
        } else {
            dispatch(color, MapSet::COLOR)?;
            dispatch(scene, geometry | in_scene)?;
        }
        dispatch(actors, semantics)?;
        recorder.stamp("resolve");
        self.read_back(recorder, slot)
    }

    /// Copies keys to the images with memory of their own.
    fn copy_keys<'a>(&self, recorder: &mut Recorder<'a>, shared: &'a Shared) -> Result<(), GpuError> {
        for layer in shared.layers[..self.work.layers.count].iter().filter(|layer| layer.copied) {
            recorder.barrier(Scope::Compute, Scope::CopyRead);
            let rows = self.work.cut.key_bytes(self.key_rows).div_ceil(KEY_IMAGE_ROW_BYTES) as u32;
            recorder.write_rows((&layer.buffer, 0), &layer.image, 0, 0..rows)?;
        }
        Ok(())
    }

    fn read_back<'a>(&self, recorder: &mut Recorder<'a>, slot: &'a Slot) -> Result<(), GpuError> {
        let bytes = 4 * self.pixels as u64;
        let wanted = Slot::wanted(self.work.job.maps);
        let maps = || slot.maps.iter().zip(wanted).filter(|(_, wanted)| *wanted).map(|(map, _)| map);
        let copied = |map: &'a MapBuffer| map.host.as_ref().map(|host| (&map.device, host));
        if maps().any(|map| map.host.is_some()) {
            recorder.barrier(Scope::Compute, Scope::CopyRead);
            for (from, to) in maps().filter_map(copied) {
                recorder.copy((from, 0), (to, 0), bytes)?;
            }
            recorder.barrier(Scope::CopyWrite, Scope::Host);
            recorder.stamp("readback");
        } else {
            recorder.barrier(Scope::Compute, Scope::Host);
        }
        Ok(())
    }
}

/// Clears the maps: the resolve shaders write only non-empty pixels.
pub(super) fn clear_maps<'a>(
    recorder: &mut Recorder<'a>,
    slot: &'a Slot,
    job: &FrameJob<'_>,
    pixels: usize,
) -> Result<(), GpuError> {
    for (index, wanted) in Slot::wanted(job.maps).into_iter().enumerate() {
        if wanted {
            let word = if index == DEPTH { f32::INFINITY.to_bits() } else { 0 };
            recorder.fill(&slot.maps[index].device, 0, 4 * pixels as u64, word)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(draw: u32, page: usize, crop: bool) -> PlacedItem {
        PlacedItem { page, crop, item: ProjectItem { draw, row: 0, first: 0, end: 1 } }
    }

    #[test]
    fn each_kind_of_chunk_is_one_run() {
        let all = [placed(0, 1, false), placed(1, 0, true), placed(2, 1, false), placed(3, 0, false)];
        let (items, runs) = runs_of(&all, 1);
        assert_eq!(items.iter().map(|i| i.draw).collect::<Vec<_>>(), [3, 1, 0, 2]);
        let run = |page, crop, first, count| Run { page, crop, first, count };
        assert_eq!(runs, [run(0, false, 0, 1), run(0, true, 1, 1), run(1, false, 2, 2)]);
    }
}
