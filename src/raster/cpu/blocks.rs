//! The points of a block: which of their groups may be visible, and drawing them.
//!
//! Memory is slower than arithmetic here: a group is loaded into the cache while others are drawn.

use pulp::{Simd, WithSimd};

use super::arena::PackedBlock;
use super::footprint::{Footprint, FootprintLanes, Footprints};
use super::memory::prefetch;
use super::numbering::Numbered;
use super::packed::{BoundsLanes, GROUP, GROUPS};
use super::project::{Cells, Projection};
use super::window::{Layer, Window};
use crate::bits::Ones;

/// Groups that are loaded before they are drawn.
const GROUPS_AHEAD: usize = 2;

/// Footprints of more cells per point are not tested cell by cell: that costs more than drawing their points.
const CELLS_PER_POINT: usize = 2;

/// Bit mask over a block's groups.
pub(super) type GroupMask = u64;
const _: () = assert!(GROUPS <= GroupMask::BITS as usize);

/// An instance as a strip sees it.
pub(super) struct StripDraw<'t> {
    pub(super) numbered: &'t Numbered<'t>,
    pub(super) projection: Projection,
    pub(super) footprints: Footprints,
}

/// A block of a draw.
#[derive(Clone, Copy)]
pub(super) struct Block<'b> {
    pub(super) draw: &'b StripDraw<'b>,
    /// Number of the block in its cloud.
    pub(super) block: usize,
    pub(super) points: PackedBlock<'b>,
    /// Bit mask of the layers that its points are drawn into.
    pub(super) layers: u32,
    /// Whether the crop may exclude some of its points.
    pub(super) crops: bool,
}

/// [`Footprints::of`] in the widest vectors of the processor.
struct Project<'p> {
    footprints: &'p Footprints,
    bounds: &'p BoundsLanes,
}

/// [`Block::is_hidden`] in the widest vectors of the processor.
struct IsHidden<'h> {
    block: Block<'h>,
    footprint: &'h Footprint,
    radius: u32,
    window: &'h Window,
    layers: &'h mut [Layer],
}

/// [`Block::visible`] in the widest vectors of the processor.
struct Visible<'v> {
    block: Block<'v>,
    window: &'v Window,
    layers: &'v [Layer],
    culls: bool,
}

/// [`Block::draw_groups`] in the widest vectors of the processor.
struct DrawGroups<'d> {
    block: Block<'d>,
    groups: GroupMask,
    layers: &'d mut [Layer],
}

impl WithSimd for Project<'_> {
    type Output = FootprintLanes;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> FootprintLanes {
        self.footprints.of(self.bounds)
    }
}

impl WithSimd for IsHidden<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> bool {
        self.block.hidden(self.footprint, self.radius, self.window, self.layers)
    }
}

impl WithSimd for Visible<'_> {
    type Output = GroupMask;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> GroupMask {
        self.block.visible_groups(self.window, self.layers, self.culls)
    }
}

impl WithSimd for DrawGroups<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.block.draw_groups(self.groups, self.layers);
    }
}

impl StripDraw<'_> {
    /// Returns the footprints of blocks in the draw's cloud, [`LANES`](super::packed::LANES) at a time.
    pub(super) fn footprints(&self, lanes: usize) -> FootprintLanes {
        let bounds = &self.numbered.cloud.blocks[lanes];
        pulp::Arch::new().dispatch(Project { footprints: &self.footprints, bounds })
    }
}

impl<'b> Block<'b> {
    /// Returns whether what is drawn hides all points. `radius`: of the nearest.
    pub(super) fn is_hidden(
        self,
        footprint: &Footprint,
        radius: u32,
        window: &Window,
        layers: &mut [Layer],
    ) -> bool {
        pulp::Arch::new().dispatch(IsHidden { block: self, footprint, radius, window, layers })
    }

    /// Loads what [`Self::visible`] reads into the cache.
    pub(super) fn prefetch(self) {
        prefetch(self.points.bounds);
    }

    /// Returns the groups whose points may be visible. Those that what is drawn hides are not, if it `culls`.
    pub(super) fn visible(self, window: &Window, layers: &[Layer], culls: bool) -> GroupMask {
        pulp::Arch::new().dispatch(Visible { block: self, window, layers, culls })
    }

    /// Draws groups.
    pub(super) fn draw(self, groups: GroupMask, layers: &mut [Layer]) {
        pulp::Arch::new().dispatch(DrawGroups { block: self, groups, layers });
    }

    // Loops instead of closures, which would not be compiled for the vectors of the caller.
    #[inline(always)]
    fn hidden(self, footprint: &Footprint, radius: u32, window: &Window, layers: &mut [Layer]) -> bool {
        let small = footprint.cells() <= CELLS_PER_POINT * GROUP * GROUPS;
        for (i, layer) in layers.iter_mut().enumerate() {
            let own = self.layers >> i & 1 == 1;
            if own && !layer.covers(footprint, radius, window) && !(small && layer.hides(footprint, window)) {
                return false;
            }
        }
        true
    }

    #[inline(always)]
    fn visible_groups(self, window: &Window, layers: &[Layer], culls: bool) -> GroupMask {
        let lanes = self.draw.footprints.of(self.points.bounds);
        let mut groups = lanes.drawn();
        let tested = if culls { groups & lanes.within(CELLS_PER_POINT * GROUP) } else { 0 };
        for group in Ones(tested) {
            let footprint = lanes.lane(group);
            let mut hidden = true;
            for (i, layer) in layers.iter().enumerate() {
                let own = self.layers >> i & 1 == 1;
                hidden = hidden && (!own || layer.hides(&footprint, window));
            }
            groups &= !(GroupMask::from(hidden) << group);
        }
        for group in Ones(groups).take(GROUPS_AHEAD) {
            self.prefetch_group(group);
        }
        groups
    }

    #[inline(always)]
    fn draw_groups(self, groups: GroupMask, layers: &mut [Layer]) {
        let first_number = self.draw.numbered.first;
        let mut cells = Cells::default();
        let mut ahead = Ones(groups);
        ahead.by_ref().take(GROUPS_AHEAD).for_each(drop);
        for group in Ones(groups) {
            if let Some(later) = ahead.next() {
                self.prefetch_group(later);
            }
            self.draw.projection.cells(&self.points.positions.0[group], self.crops, &mut cells);
            cells.number(first_number, self.block * GROUPS + group, self.index(group));
            for (_, layer) in layers.iter_mut().enumerate().filter(|(i, _)| self.layers >> i & 1 == 1) {
                cells.put(layer);
            }
        }
    }

    #[inline(always)]
    fn prefetch_group(self, group: usize) {
        prefetch(&self.points.positions.0[group]);
        if let Some(index) = self.index(group) {
            prefetch(index);
        }
    }

    /// Returns the cloud index of each point in a group; `None` if the order is the cloud's own.
    #[inline(always)]
    fn index(self, group: usize) -> Option<&'b [u32; GROUP]> {
        let groups: &[[u32; GROUP]] = bytemuck::cast_slice(self.draw.numbered.cloud.chunked.order()?);
        groups.get(self.block * GROUPS + group)
    }
}
