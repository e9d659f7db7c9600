//! The points of a block: which of their groups may be visible, and drawing them.
//!
//! Memory is slower than arithmetic here: a group is loaded into the cache while others are drawn.

use pulp::{Simd, WithSimd};

use super::hidden::{Footprint, Footprints, GroupFootprints};
use super::memory::prefetch;
use super::numbering::Numbered;
use super::packed::GROUPS;
use super::project::{Cells, Projection};
use super::window::{Layer, Window};
use crate::bits::Ones;

/// Groups that are loaded before they are drawn.
const GROUPS_AHEAD: usize = 2;

/// Bit mask of the groups of a block.
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
    /// Whether the crop may exclude some of its points.
    pub(super) crops: bool,
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

impl Block<'_> {
    /// Loads what [`Self::visible`] reads into the cache.
    pub(super) fn prefetch(self) {
        prefetch(&self.draw.numbered.cloud.bounds[self.block]);
    }

    /// Returns the groups whose points may be visible. Those that what is drawn hides are not, if it `culls`.
    pub(super) fn visible(self, window: &Window, layers: &[Layer], culls: bool) -> GroupMask {
        pulp::Arch::new().dispatch(Visible { block: self, window, layers, culls })
    }

    /// Draws groups.
    pub(super) fn draw(self, groups: GroupMask, layers: &mut [Layer]) {
        pulp::Arch::new().dispatch(DrawGroups { block: self, groups, layers });
    }

    #[inline(always)]
    fn visible_groups(self, window: &Window, layers: &[Layer], culls: bool) -> GroupMask {
        let mut footprints = GroupFootprints::default();
        self.draw.footprints.of_block(&self.draw.numbered.cloud.bounds[self.block], &mut footprints);
        let mut groups: GroupMask = 0;
        if self.is_hidden(&footprints.block(), window, layers, culls) {
            return groups;
        }
        for group in 0..GROUPS {
            if self.is_hidden(&footprints.group(group), window, layers, culls) {
                continue;
            }
            if groups.count_ones() < GROUPS_AHEAD as u32 {
                self.prefetch_group(group);
            }
            groups |= 1 << group;
        }
        groups
    }

    /// Returns whether a footprint misses the window or, if it `culls`, is hidden in all layers of the draw.
    // Loops instead of closures, which would not be compiled for the vectors of the caller.
    #[inline(always)]
    fn is_hidden(self, footprint: &Footprint, window: &Window, layers: &[Layer], culls: bool) -> bool {
        if footprint.misses(window) {
            return true;
        }
        for (i, layer) in layers.iter().enumerate() {
            let own = self.draw.numbered.layers >> i & 1 == 1;
            if own && !(culls && footprint.is_hidden(layer, window)) {
                return false;
            }
        }
        true
    }

    #[inline(always)]
    fn draw_groups(self, groups: GroupMask, layers: &mut [Layer]) {
        let Numbered { cloud, layers: mask, first: first_number, .. } = *self.draw.numbered;
        let mut cells = Cells::default();
        let mut ahead = Ones(groups);
        ahead.by_ref().take(GROUPS_AHEAD).for_each(drop);
        for group in Ones(groups) {
            if let Some(later) = ahead.next() {
                self.prefetch_group(later);
            }
            let number = self.block * GROUPS + group;
            self.draw.projection.cells(&cloud.positions[self.block].0[group], self.crops, &mut cells);
            cells.number(first_number, number, cloud.index.get(number));
            for (_, layer) in layers.iter_mut().enumerate().filter(|(i, _)| mask >> i & 1 == 1) {
                cells.put(layer);
            }
        }
    }

    #[inline(always)]
    fn prefetch_group(self, group: usize) {
        let cloud = self.draw.numbered.cloud;
        prefetch(&cloud.positions[self.block].0[group]);
        if let Some(index) = cloud.index.get(self.block * GROUPS + group) {
            prefetch(index);
        }
    }
}
