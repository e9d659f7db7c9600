//! Clouds split into chunks of neighboring points, with bounds.

use rayon::prelude::*;

use crate::cloud::paged::{BLOCK, PAGE};
use crate::cloud::{Bounds, Cloud, Point, morton_order};
use crate::error::FileError;

/// Points per chunk; the last one of a cloud may have fewer. Also the width of point images, and the
/// alignment of a draw's first number.
pub(super) const CHUNK: usize = PAGE;
/// Points that are culled as one unit, a block: a quarter of a chunk.
pub(super) const CULL_BLOCK: usize = BLOCK;
/// The order of a cloud is padded to a multiple of this number of points.
pub(super) const RUN: usize = 64;
/// Number of blocks in a group; a group is culled before its blocks.
pub(super) const GROUP: usize = 64;

/// An axis-aligned box, as center and half size, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    pub(super) center: [f64; 3],
    pub(super) half: [f64; 3],
}

impl Extent {
    fn of(bounds: &Bounds) -> Self {
        let side = |axis: usize| [f64::from(bounds.min[axis]), f64::from(bounds.max[axis])];
        Self {
            center: [0, 1, 2].map(|axis| side(axis).iter().sum::<f64>() / 2.0),
            half: [0, 1, 2].map(|axis| (side(axis)[1] - side(axis)[0]) / 2.0),
        }
    }
}

/// Bounds of a group's blocks, coordinate by coordinate.
pub(super) struct GroupExtents {
    /// Bounds of all; `None` if no point in them is ever drawn.
    pub(super) all: Option<Extent>,
    center: [[f64; GROUP]; 3],
    half: [[f64; GROUP]; 3],
    /// Bit mask of the blocks that have points that may be drawn.
    pub(super) drawn: u64,
}

impl GroupExtents {
    fn of(blocks: &[Option<Bounds>]) -> Self {
        let all = blocks.iter().flatten().copied().reduce(Bounds::and).map(|bounds| Extent::of(&bounds));
        let mut group = Self { all, center: [[0.0; GROUP]; 3], half: [[0.0; GROUP]; 3], drawn: 0 };
        for (block, bounds) in blocks.iter().enumerate() {
            let Some(extent) = bounds.as_ref().map(Extent::of) else { continue };
            group.drawn |= 1 << block;
            for axis in 0..3 {
                group.center[axis][block] = extent.center[axis];
                group.half[axis][block] = extent.half[axis];
            }
        }
        group
    }

    /// Returns the bounds of a block; they are meaningless if no point in it is ever drawn.
    #[inline(always)]
    pub(super) fn block(&self, block: usize) -> Extent {
        let at = |sides: &[[f64; GROUP]; 3]| [sides[0][block], sides[1][block], sides[2][block]];
        Extent { center: at(&self.center), half: at(&self.half) }
    }
}

impl AsRef<Self> for ChunkedCloud<'_> {
    fn as_ref(&self) -> &Self {
        self
    }
}

/// A cloud in the order of its chunks, which is its own, unless points in memory are not sorted in space:
/// chunks of points that are near each other can be culled. Bounds exclude points with non-finite positions,
/// which are never drawn.
pub(super) struct ChunkedCloud<'a> {
    pub(super) cloud: Cloud<'a>,
    /// Cloud index of each point in chunk order, padded to whole runs of [`RUN`]; `None` for the cloud's own
    /// order.
    order: Option<Vec<u32>>,
    /// Bounds of each run with [`CULL_BLOCK`] points; [`GROUP`] runs together.
    pub(super) groups: Vec<GroupExtents>,
    /// Bounds of each chunk, likewise.
    pub(super) chunk_groups: Vec<GroupExtents>,
    /// Bounds of all points; `None` if none is ever drawn.
    pub(super) all: Option<Bounds>,
}

impl<'a> ChunkedCloud<'a> {
    pub(super) fn new(cloud: Cloud<'a>) -> Self {
        Self::with_blocks(cloud).0
    }

    /// Creates a cloud in its own order in any case.
    pub(super) fn in_order(cloud: Cloud<'a>) -> Self {
        Self::of(cloud, false).0
    }

    /// Returns the bounds of the runs with [`CULL_BLOCK`] points too.
    pub(super) fn with_blocks(cloud: Cloud<'a>) -> (Self, Vec<Option<Bounds>>) {
        Self::of(cloud, true)
    }

    fn of(cloud: Cloud<'a>, reorders: bool) -> (Self, Vec<Option<Bounds>>) {
        let mut blocks = cloud.blocks();
        let all = blocks.iter().flatten().copied().reduce(Bounds::and);
        let mut order = None;
        if let (true, Cloud::Memory(points), Some(all)) = (reorders, cloud, &all) {
            order = morton_order(points, all);
            if let Some(order) = &mut order {
                let bounds = |block: &[u32]| {
                    let points = block.iter().map(|index| &points[*index as usize]);
                    Bounds::of(points.filter(|point| point.is_finite()))
                };
                blocks = order.par_chunks(CULL_BLOCK).map(bounds).collect();
                order.resize(order.len().next_multiple_of(RUN), 0);
            }
        }
        let groups = blocks.chunks(GROUP).map(GroupExtents::of).collect();
        let chunk = |blocks: &[Option<Bounds>]| blocks.iter().flatten().copied().reduce(Bounds::and);
        let chunks: Vec<Option<Bounds>> = blocks.chunks(CHUNK / CULL_BLOCK).map(chunk).collect();
        let chunk_groups = chunks.chunks(GROUP).map(GroupExtents::of).collect();
        (Self { cloud, order, groups, chunk_groups, all }, blocks)
    }

    /// Returns the number of points.
    pub(super) fn len(&self) -> usize {
        self.cloud.len()
    }

    /// Returns the number of chunks.
    pub(super) fn chunks(&self) -> usize {
        self.len().div_ceil(CHUNK)
    }

    /// Returns the number of points in a chunk.
    pub(super) fn count(&self, chunk: usize) -> u32 {
        (self.len() - chunk * CHUNK).min(CHUNK) as u32
    }

    /// Returns the cloud indices of all points in chunk order, padded to whole runs of [`RUN`]; `None` if the
    /// order is the cloud's own.
    pub(super) fn order(&self) -> Option<&[u32]> {
        self.order.as_deref()
    }

    /// Returns the points of a chunk. `buffer` serves to read them.
    ///
    /// # Errors
    /// Fails if they cannot be read or are damaged.
    pub(super) fn read<'b>(
        &self,
        chunk: usize,
        buffer: &'b mut Vec<Point>,
    ) -> Result<&'b [Point], FileError> {
        let first = chunk * CHUNK;
        let places = first..first + self.count(chunk) as usize;
        buffer.clear();
        match (&self.cloud, &self.order) {
            (Cloud::Stored(cloud), _) => {
                buffer.resize(places.len(), Point::default());
                cloud.read(chunk, buffer)?;
            }
            (Cloud::Memory(points), Some(order)) => {
                buffer.extend(order[places].iter().map(|index| points[*index as usize]));
            }
            (Cloud::Memory(points), None) => buffer.extend_from_slice(&points[places]),
        }
        Ok(buffer)
    }

    /// Writes a chunk in the device's layout: bits of x, y, z and the cloud index, a row of [`CHUNK`] texels.
    /// `buffer` serves to read it.
    ///
    /// # Errors
    /// Fails as [`ChunkedCloud::read`].
    pub(super) fn write_row(
        &self,
        chunk: usize,
        row: &mut [[u32; 4]],
        buffer: &mut Vec<Point>,
    ) -> Result<(), FileError> {
        let points = self.read(chunk, buffer)?;
        for ((texel, point), place) in row.iter_mut().zip(points).zip(chunk * CHUNK..) {
            let [x, y, z] = point.position.map(f32::to_bits);
            *texel = [x, y, z, self.order.as_ref().map_or(place as u32, |order| order[place])];
        }
        Ok(())
    }

    /// Returns a chunk's number of points in the cloud's own order. `buffer` serves to read them.
    ///
    /// # Errors
    /// Fails as [`ChunkedCloud::read`].
    pub(super) fn read_in_order<'b>(
        &'b self,
        chunk: usize,
        buffer: &'b mut Vec<Point>,
    ) -> Result<&'b [Point], FileError> {
        match self.cloud {
            Cloud::Memory(points) => Ok(&points[chunk * CHUNK..][..self.count(chunk) as usize]),
            Cloud::Stored(_) => self.read(chunk, buffer),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f32) -> Point {
        Point::new([x, 0.0, 0.0], [1, 2, 3], 4)
    }

    #[test]
    fn chunks_hold_every_point_once_and_bound_it() {
        let scattered = |i: u32| point((i.wrapping_mul(2_654_435_761) >> 16) as f32);
        let points: Vec<Point> = (0..10_000).map(scattered).collect();
        let cloud = ChunkedCloud::new((&points).into());
        assert_eq!((cloud.chunks(), cloud.groups.len(), cloud.groups[0].drawn), (3, 1, 0x3ff));
        assert_eq!(cloud.count(2), 10_000 - 2 * 4096);
        let (mut seen, mut buffer, order) = (vec![0; points.len()], Vec::new(), cloud.order().unwrap());
        assert_eq!(order.len(), 10_048);
        for chunk in 0..3 {
            for (i, point) in cloud.read(chunk, &mut buffer).unwrap().iter().enumerate() {
                let (place, x) = (chunk * CHUNK + i, f64::from(point.position[0]));
                let extent = cloud.groups[0].block(place / CULL_BLOCK);
                seen[order[place] as usize] += 1;
                assert_eq!(*point, points[order[place] as usize]);
                assert!((x - extent.center[0]).abs() <= extent.half[0]);
            }
        }
        assert!(seen.iter().all(|n| *n == 1));
        let widths: f64 = (0..10).map(|block| 2.0 * cloud.groups[0].block(block).half[0]).sum();
        assert!(widths < 66_000.0, "{widths}: chunks of a line share a cell at most");
    }

    #[test]
    fn non_finite_points_do_not_widen_bounds() {
        let points = [point(1.0), point(f32::NAN), point(f32::INFINITY), point(3.0)];
        let cloud = ChunkedCloud::new((&points).into());
        let extent = cloud.groups[0].block(0);
        assert_eq!((extent.center[0], extent.half[0]), (2.0, 1.0));
        assert!(ChunkedCloud::new(points[1..3].into()).groups[0].drawn == 0);
        assert!(ChunkedCloud::new((&[]).into()).groups.is_empty());
    }
}
