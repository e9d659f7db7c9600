//! Rendering of one row strip.

use std::time::Instant;

use pulp::{Simd, WithSimd};

use super::dilate::Dilation;
use super::hidden::{Covered, Footprint, Footprints, GroupFootprints};
use super::numbering::{Numbered, Numbering};
use super::packed::GROUP;
use super::project::{Cells, Projection};
use super::resolve::{MapRows, Resolve};
use super::strips::{Sampling, Strip};
use super::window::Layer;
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
    covered: Vec<Covered>,
}

/// Points drawn per cell of a window until it is computed anew which cells they cover.
const POINTS_PER_UPDATE: usize = 2;

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

/// Points of an instance that may be visible.
struct Item {
    /// Index into the draws.
    draw: usize,
    range: VisibleRange,
}

/// An instance as the strip sees it.
struct StripDraw<'t> {
    numbered: &'t Numbered<'t>,
    projection: Projection,
    footprints: Footprints,
}

/// [`Task::project`] in the widest vectors of the processor.
struct Project<'p> {
    task: &'p Task<'p>,
    draw: &'p StripDraw<'p>,
    range: &'p VisibleRange,
    layers: &'p mut [Layer],
    covered: &'p [Covered],
}

impl WithSimd for Project<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        self.task.project(self.draw, self.range, self.layers, self.covered)
    }
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
            scratch.covered.resize_with(self.layers.count, Covered::default);
        }
        let layers = &mut scratch.layers[..self.layers.count];
        layers.iter_mut().for_each(|layer| layer.clear(&self.strip.window));
        stamp("clear");
        let dilations = &mut scratch.dilations[..self.layers.count];
        let covered = &mut scratch.covered[..self.layers.count];
        covered.iter_mut().for_each(Covered::clear);
        let enough = POINTS_PER_UPDATE * self.strip.window.stride() * self.strip.window.height();
        let mut drawn = 0;
        for (at, item) in items.iter().enumerate() {
            let (draw, range) = (&draws[item.draw], &item.range);
            drawn += pulp::Arch::new().dispatch(Project { task: self, draw, range, layers, covered });
            // Worth it if as many points follow.
            if drawn >= enough && (items.len() - at) * CULL_BLOCK >= enough && self.culls {
                for ((layer, covered), dilation) in
                    layers.iter().zip(covered.iter_mut()).zip(dilations.iter_mut())
                {
                    dilation.start(self.job.schedule);
                    covered.update(layer, &self.strip.window, dilation);
                }
                drawn = 0;
            }
        }
        stamp("project");
        let Self { job, layers: purposes, strip, sampling, numbering, .. } = *self;
        let resolve = Resolve { job, layers: purposes, strip, sampling, numbering };
        resolve.fill(layers, dilations, maps);
        stamp("resolve");
        times
    }

    /// Returns the draws of the strip, and their parts that may be visible, nearest first.
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
            items.extend(seen.into_iter().map(|range| Item { draw: draws.len(), range }));
            let projection = Projection::new(&draw, window, z_far_m);
            let footprints = Footprints::new(&draw, numbered.cloud.reach_m, z_far_m);
            draws.push(StripDraw { numbered, projection, footprints });
        }
        items.sort_by(|a, b| a.range.nearest_m.total_cmp(&b.range.nearest_m));
        (draws, items)
    }

    /// Draws the points of a block; returns how many were not skipped.
    #[inline(always)]
    fn project(
        &self,
        draw: &StripDraw<'_>,
        range: &VisibleRange,
        layers: &mut [Layer],
        covered: &[Covered],
    ) -> usize {
        let Numbered { cloud, layers: mask, first: first_number, .. } = *draw.numbered;
        let window = &self.strip.window;
        let first_place = range.chunk as usize * CHUNK + range.points[0] as usize;
        let block = first_place / CULL_BLOCK;
        let (mut cells, mut groups) = (Cells::default(), GroupFootprints::default());
        draw.footprints.of_block(&cloud.bounds[block], &mut groups);
        let whole = groups.block();
        if whole.misses(window) || self.hides(&whole, (mask, layers, covered)) {
            return 0;
        }
        let index = &cloud.index[..];
        let mut drawn = 0;
        for (group, positions) in cloud.positions[block].0.iter().enumerate() {
            let footprint = groups.group(group);
            if footprint.misses(window) || self.hides(&footprint, (mask, layers, covered)) {
                continue;
            }
            draw.projection.cells(positions, range.crop, &mut cells);
            drawn += GROUP;
            let place = first_place + group * GROUP;
            let own = first_number + place as u32;
            for (_, layer) in layers.iter_mut().enumerate().filter(|(i, _)| mask >> i & 1 == 1) {
                match index.get(place..place + GROUP) {
                    Some(index) => cells.put(layer, |i| first_number + index[i]),
                    None => cells.put(layer, |i| own + i as u32),
                }
            }
        }
        drawn
    }

    /// Returns whether what is drawn hides a footprint in all layers of a bit mask.
    #[inline(always)]
    fn hides(&self, footprint: &Footprint, (mask, layers, covered): (u32, &[Layer], &[Covered])) -> bool {
        let window = &self.strip.window;
        self.culls
            && (0..layers.len()).filter(|layer| mask >> layer & 1 == 1).all(|layer| {
                footprint.is_hidden(&layers[layer], window)
                    || footprint.is_covered(&covered[layer], window, self.job.schedule)
            })
    }
}
