//! Rendering of one row strip.

use std::collections::VecDeque;
use std::ops::Range;
use std::time::Instant;

use super::blocks::{Block, StripDraw};
use super::dilate::Dilation;
use super::footprint::{Footprint, Footprints};
use super::numbering::Numbering;
use super::packed::LANES;
use super::project::Projection;
use super::resolve::{MapRows, Resolve};
use super::strips::{Sampling, Strip};
use super::window::Layer;
use crate::bits::Ones;
use crate::raster::chunk::{CHUNK, CULL_BLOCK};
use crate::raster::cull::{VisibleRange, seen_blocks};
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
    /// Of its points.
    footprint: Footprint,
    /// Index into the draws.
    draw: u32,
    /// Number of the block in its cloud.
    block: u32,
    /// Bit mask of the layers that its points are drawn into.
    layers: u32,
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
        let (draws, mut items) = self.plan();
        let (forked, common) = self.fork(&mut items);
        stamp("plan");
        if scratch.layers.len() < self.layers.count {
            scratch.layers.resize_with(self.layers.count, Layer::default);
            scratch.dilations.resize_with(self.layers.count, Dilation::default);
        }
        let layers = &mut scratch.layers[..self.layers.count];
        let (window, reach_m) = (&self.strip.window, self.job.schedule.reach_m(1));
        Ones(self.layers.shared().used().into()).for_each(|layer| layers[layer].clear(window, reach_m));
        stamp("clear");
        self.project(&draws, &items[..common], layers);
        if let (Some(geometry), Some(color)) = (self.layers.geometry, self.layers.color)
            && let Ok([from, to]) = layers.get_disjoint_mut([geometry, color])
            && !forked.is_empty()
        {
            to.copy_rows(from, window, &forked);
        }
        self.project(&draws, &items[common..], layers);
        stamp("project");
        let Self { job, layers: purposes, strip, sampling, numbering, .. } = *self;
        let resolve = Resolve { job, layers: purposes, forked, strip, sampling, numbering };
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
        for numbered in &self.numbering.instances {
            let job = SplatJob { view, schedule, instances: &[], crop: self.job.crop, maps: MapSet::NONE };
            let draw = draw_from_instance(&job, &numbered.instance, numbered.first);
            let shown = (window.width, window.rows);
            let seen = seen_blocks(&numbered.cloud.chunked, &draw, shown, window.pad, z_far_m);
            if seen.is_empty() {
                continue;
            }
            let projection = Projection::new(&draw, window, z_far_m);
            let footprints = Footprints::new(&draw, window, numbered.cloud.reach_m, z_far_m);
            let strip_draw = StripDraw { numbered, projection, footprints };
            let block =
                |range: &VisibleRange| (range.chunk as usize * CHUNK + range.points[0] as usize) / CULL_BLOCK;
            for near in seen.chunk_by(|a, b| block(a) / LANES == block(b) / LANES) {
                let lanes = strip_draw.footprints(block(&near[0]) / LANES);
                let drawn = lanes.drawn();
                for range in near {
                    let (block, lane) = (block(range), block(range) % LANES);
                    // No camera sees a block that is not loaded.
                    if drawn >> lane & 1 == 1 && numbered.blocks[block].is_some() {
                        let (draw, footprint, layers) =
                            (draws.len() as u32, lanes.lane(lane), numbered.layers);
                        items.push(Item { footprint, draw, block: block as u32, layers, crops: range.crop });
                    }
                }
            }
            draws.push(strip_draw);
        }
        // The bits of depths that are not negative are ordered like their values.
        items.sort_unstable_by_key(|item| item.footprint.nearest_m.max(0.0).to_bits());
        (draws, items)
    }

    /// Divides blocks into those that color and geometry share, which are only to be drawn into the layer of
    /// the geometry, and the others, in the same order. Returns the window rows, padding included, where the
    /// layers may then differ, and the number of shared blocks.
    fn fork(&self, items: &mut [Item]) -> (Range<u32>, usize) {
        let shared = self.layers.shared();
        if shared == *self.layers {
            return (0..0, items.len());
        }
        // A stable sort.
        items.sort_by_key(|item| !self.layers.is_in_both(item.layers));
        let common = items.partition_point(|item| self.layers.is_in_both(item.layers));
        items[..common].iter_mut().for_each(|item| item.layers &= shared.used());
        let [first, end] = items[common..].iter().fold([u32::MAX, 0], |[first, end], item| {
            [first.min(item.footprint.first[1]), end.max(item.footprint.last[1] + 1)]
        });
        (first..end, common)
    }

    /// Draws blocks in order. Each is tested as a whole, then group by group once their bounds are in the
    /// cache, and drawn after the next one was tested, while its points are loaded.
    fn project(&self, draws: &[StripDraw<'_>], items: &[Item], layers: &mut [Layer]) {
        let window = &self.strip.window;
        let mut items = items.iter();
        let mut waiting = VecDeque::with_capacity(BLOCKS_AHEAD);
        let mut tested = None;
        loop {
            while waiting.len() < BLOCKS_AHEAD {
                let Some(item) = items.next() else { break };
                let Item { footprint, draw, block, layers: mask, crops } = item;
                let (draw, block) = (&draws[*draw as usize], *block as usize);
                let Some(points) = draw.numbered.blocks[block] else { continue };
                let block = Block { draw, block, points, layers: *mask, crops: *crops };
                let radius = self.job.schedule.radius_at(footprint.nearest_m).unwrap_or(window.pad);
                if self.culls && block.is_hidden(footprint, radius, window, layers) {
                    continue;
                }
                block.prefetch();
                waiting.push_back(block);
            }
            let next = waiting.pop_front().map(|block| (block, block.visible(window, layers, self.culls)));
            let is_last = next.is_none();
            if let Some((block, groups)) = std::mem::replace(&mut tested, next) {
                block.draw(groups, layers);
            }
            if is_last {
                return;
            }
        }
    }
}
