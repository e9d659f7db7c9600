//! Joint numbering for the points of a frame's instances.

use super::memory::prefetch;
use super::packed::PackedCloud;
use crate::raster::layers::LayerInstance;
use crate::raster::{Instance, RasterError};

/// Granularity of first numbers, so that a block of numbers belongs to one instance.
const BLOCK: usize = 1024;

/// An instance, and the numbers of its points: `first` and following.
pub(super) struct Numbered<'c> {
    pub(super) instance: Instance,
    /// Bit mask of its layers.
    pub(super) layers: u32,
    pub(super) cloud: &'c PackedCloud<'c>,
    pub(super) first: u32,
}

/// The instances of a frame in order.
pub(super) struct Numbering<'c> {
    pub(super) instances: Vec<Numbered<'c>>,
    blocks: Vec<Block>,
    /// Colors and classes of all clouds.
    colors: &'c [u32],
}

/// What the maps show for a block of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    /// Wrapping offset from numbers to indices of colors.
    color: usize,
    /// Wrapping offset from numbers to values in the point map.
    point: u32,
    instance: u32,
}

impl<'c> Numbering<'c> {
    /// Numbers the instances; `colors` belong to all clouds.
    ///
    /// # Errors
    /// Fails for an unknown cloud or for too many points.
    pub(super) fn new(
        merged: &[LayerInstance],
        clouds: &'c [PackedCloud<'c>],
        colors: &'c [u32],
    ) -> Result<Self, RasterError> {
        let max = u64::from(u32::MAX) - 1;
        let mut numbering = Self { instances: Vec::with_capacity(merged.len()), blocks: Vec::new(), colors };
        let (mut points, mut geometry_points) = (0_u64, 0_u64);
        for layered in merged {
            let id = layered.instance.cloud;
            let cloud =
                clouds.get(id).ok_or(RasterError::UnknownCloud { cloud: id, clouds: clouds.len() })?;
            let first = (numbering.blocks.len() * BLOCK) as u64;
            let count = cloud.chunked.len();
            points += count as u64;
            let end = first + count.next_multiple_of(BLOCK) as u64;
            if points > max || end > max {
                return Err(RasterError::TooManyPoints { found: points.max(end), max });
            }
            let first = first as u32;
            let block = Block {
                color: cloud.first_color.wrapping_sub(first as usize),
                point: (geometry_points as u32).wrapping_add(1).wrapping_sub(first),
                instance: layered.instance.number,
            };
            numbering.blocks.extend(std::iter::repeat_n(block, count.div_ceil(BLOCK)));
            let LayerInstance { instance, layers, numbered } = *layered;
            numbering.instances.push(Numbered { instance, layers, cloud, first });
            geometry_points += if numbered { count as u64 } else { 0 };
        }
        Ok(numbering)
    }

    /// Returns whether there are no points.
    pub(super) fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    fn block(&self, number: u32) -> &Block {
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
        &self.colors[self.block(number).color.wrapping_add(number as usize)]
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
