//! Joint numbering for the points of a frame's instances.

use super::arena::PackedBlock;
use super::chunks::Chunks;
use super::memory::prefetch;
use super::packed::{BlockColors, PackedCloud};
use crate::raster::chunk::CULL_BLOCK;
use crate::raster::sight::SeenInstance;
use crate::raster::{Instance, RasterError};

/// Granularity of first numbers, so that a block of numbers belongs to one instance.
const BLOCK: usize = CULL_BLOCK;
/// Colors of a block that is not loaded, none of whose points is drawn.
const BLACK: &BlockColors = &[0; CULL_BLOCK];

/// An instance, and the numbers of its points: `first` and following.
pub(super) struct Numbered<'c> {
    pub(super) instance: Instance,
    /// Bit mask of its layers.
    pub(super) layers: u32,
    pub(super) cloud: &'c PackedCloud<'c>,
    pub(super) first: u32,
    /// Loaded blocks.
    pub(super) blocks: Vec<Option<PackedBlock<'c>>>,
}

/// The instances of a frame that cameras may see, in order.
pub(super) struct Numbering<'c> {
    pub(super) instances: Vec<Numbered<'c>>,
    blocks: Vec<Block<'c>>,
}

/// What the maps show for a block of numbers.
#[derive(Clone, Copy)]
struct Block<'c> {
    colors: &'c BlockColors,
    /// Wrapping offset from numbers to values in the point map.
    point: u32,
    instance: u32,
}

impl<'c> Numbering<'c> {
    /// Numbers the instances.
    ///
    /// # Errors
    /// Fails for too many points.
    pub(super) fn new(seen: &[SeenInstance], chunks: &'c Chunks<'_>) -> Result<Self, RasterError> {
        let max = u64::from(u32::MAX) - 1;
        let mut numbering = Self { instances: Vec::with_capacity(seen.len()), blocks: Vec::new() };
        for SeenInstance { layered, geometry_points } in seen {
            let id = layered.instance.cloud;
            let cloud = &chunks.clouds[id];
            let count = cloud.chunked.len();
            let first = (numbering.blocks.len() * BLOCK) as u64;
            let end = first + count.next_multiple_of(BLOCK) as u64;
            if end > max {
                return Err(RasterError::TooManyPoints { found: end, max });
            }
            let blocks: Vec<_> = (0..count.div_ceil(BLOCK)).map(|block| chunks.block(id, block)).collect();
            let first = first as u32;
            let point = geometry_points.wrapping_add(1).wrapping_sub(first);
            let block = |colors| Block { colors, point, instance: layered.instance.number };
            if cloud.colors.is_empty() {
                numbering
                    .blocks
                    .extend(blocks.iter().map(|loaded| block(loaded.map_or(BLACK, |it| it.colors))));
            } else {
                numbering.blocks.extend(cloud.colors.iter().map(block));
            }
            let (instance, layers) = (layered.instance, layered.layers);
            numbering.instances.push(Numbered { instance, layers, cloud, first, blocks });
        }
        Ok(numbering)
    }

    /// Returns whether there are no points.
    pub(super) fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    fn block(&self, number: u32) -> &Block<'c> {
        &self.blocks[number as usize / BLOCK]
    }

    /// Returns color and class of a point.
    #[inline(always)]
    pub(super) fn rgb_class(&self, number: u32) -> u32 {
        *self.color(number)
    }

    /// Loads color and class of a point into the cache.
    #[inline(always)]
    pub(super) fn prefetch_rgb_class(&self, number: u32) {
        prefetch(self.color(number));
    }

    #[inline(always)]
    fn color(&self, number: u32) -> &u32 {
        &self.block(number).colors[number as usize % BLOCK]
    }

    /// Returns the instance of a point.
    #[inline(always)]
    pub(super) fn instance(&self, number: u32) -> u32 {
        self.block(number).instance
    }

    /// Returns the value of a point in the point map.
    #[inline(always)]
    pub(super) fn point(&self, number: u32) -> u32 {
        self.block(number).point.wrapping_add(number)
    }
}
