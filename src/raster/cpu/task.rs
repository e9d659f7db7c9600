//! Rendering of one row strip.

use std::time::Instant;

use super::blocks::{Block, StripDraw};
use super::dilate::Dilation;
use super::hidden::Footprints;
use super::numbering::Numbering;
use super::project::Projection;
use super::resolve::{MapRows, Resolve};
use super::strips::{Sampling, Strip};
use super::window::Layer;
use crate::raster::chunk::{CHUNK, CULL_BLOCK};
use crate::raster::cull::seen_blocks;
use crate::raster::draw::draw_from_instance;
use crate::raster::layers::Layers;
use crate::raster::{FrameJob, MapSet, SplatJob, StageTimes};

/// Memory of a strip.
#[derive(Default)]
pub(super) struct Scratch {
    layers: Vec<Layer>,
    dilations: Vec<Dilation>,
}

/// Blocks whose bounds are loaded before they are tested.
const BLOCKS_AHEAD: usize = 4;

/// A strip of a frame.
pub(super) struct Task<'t> {
    pub(super) job: &'t FrameJob<'t>,
    pub(super) layers: &'t Layers,
    pub(super) strip: &'t Strip,
    pub(super) sampling: &'t Sampling,
    pub(super) numbering: &'t Numbering<'t>,
    /// Whether groups of points are skipped that what is already drawn hides.
    pub(super) culls: bool,
}

/// A block that may be visible.
struct Item {
    /// Lower bound of the depth of its points, meters.
    nearest_m: f32,
    /// Index into the draws.
    draw: u32,
    /// Number of the block in its cloud.
    block: u32,
    /// Whether the crop may exclude some of its points.
    crops: bool,
}

impl Task<'_> {
    /// Fills the strip's rows of the maps; returns the times of the stages.
    pub(super) fn render(&self, scratch: &mut Scratch, maps: &mut MapRows<'_>) -> StageTimes {
        let mut times = StageTimes::default();
        let mut start = Instant::now();
        let mut stamp = |stage: &'static str| {
            let now = Instant::now();
            times.add(stage, now - std::mem::replace(&mut start, now));
        };
        let (draws, items) = self.plan();
        stamp("plan");
        if scratch.layers.len() < self.layers.count {
            scratch.layers.resize_with(self.layers.count, Layer::default);
            scratch.dilations.resize_with(self.layers.count, Dilation::default);
        }
        let layers = &mut scratch.layers[..self.layers.count];
        layers.iter_mut().for_each(|layer| layer.clear(&self.strip.window));
        stamp("clear");
        self.project(&draws, &items, layers);
        stamp("project");
        let Self { job, layers: purposes, strip, sampling, numbering, .. } = *self;
        let resolve = Resolve { job, layers: purposes, strip, sampling, numbering };
        resolve.fill(layers, &mut scratch.dilations[..self.layers.count], maps);
        stamp("resolve");
        times
    }

    /// Returns the draws of the strip, and their blocks that may be visible, nearest first.
    fn plan(&self) -> (Vec<StripDraw<'_>>, Vec<Item>) {
        let window = &self.strip.window;
        let view = &self.job.views[self.strip.view];
        let (schedule, z_far_m) = (self.job.schedule, self.job.schedule.z_far_m());
        let (mut draws, mut items) = (Vec::new(), Vec::new());
        for numbered in self.numbering.instances.iter().filter(|numbered| numbered.layers != 0) {
            let job = SplatJob { view, schedule, instances: &[], crop: self.job.crop, maps: MapSet::NONE };
            let draw = draw_from_instance(&job, &numbered.instance, numbered.first);
            let shown = (window.width, window.rows);
            let seen = seen_blocks(&numbered.cloud.chunked, &draw, shown, window.pad, z_far_m);
            if seen.is_empty() {
                continue;
            }
            items.extend(seen.into_iter().map(|range| Item {
                nearest_m: range.nearest_m,
                draw: draws.len() as u32,
                block: ((range.chunk as usize * CHUNK + range.points[0] as usize) / CULL_BLOCK) as u32,
                crops: range.crop,
            }));
            let projection = Projection::new(&draw, window, z_far_m);
            let footprints = Footprints::new(&draw, numbered.cloud.reach_m, z_far_m);
            draws.push(StripDraw { numbered, projection, footprints });
        }
        // The bits of depths that are not negative are ordered like their values.
        items.sort_unstable_by_key(|item| item.nearest_m.to_bits());
        (draws, items)
    }

    /// Draws blocks in order. A block is drawn after the next one is tested, while its points are loaded.
    fn project(&self, draws: &[StripDraw<'_>], items: &[Item], layers: &mut [Layer]) {
        let block = |item: &Item| Block {
            draw: &draws[item.draw as usize],
            block: item.block as usize,
            crops: item.crops,
        };
        let mut ahead = items.iter().map(block);
        ahead.by_ref().take(BLOCKS_AHEAD).for_each(Block::prefetch);
        let mut tested = None;
        for item in items.iter().map(Some).chain([None]) {
            if let Some(later) = ahead.next() {
                later.prefetch();
            }
            let next = item.map(|item| {
                let block = block(item);
                (block, block.visible(&self.strip.window, layers, self.culls))
            });
            if let Some((block, groups)) = std::mem::replace(&mut tested, next) {
                block.draw(groups, layers);
            }
        }
    }
}
