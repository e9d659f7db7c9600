//! Clouds split into chunks of neighboring points, with bounds.

use rayon::prelude::*;

use crate::cloud::{Bounds, Point, morton_order};

/// Points per chunk; the last one of a cloud may have fewer. Also the width of point images, and the
/// alignment of a draw's first number.
pub(super) const CHUNK: usize = 4096;
/// Points that are culled as one unit, a block: a quarter of a chunk.
pub(super) const CULL_BLOCK: usize = 1024;
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
    /// Bounds of all of them; `None` if no point in them is ever drawn.
    pub(super) all: Option<Extent>,
    center: [[f64; GROUP]; 3],
    half: [[f64; GROUP]; 3],
    /// Bit mask of the blocks that have points that may be drawn.
    pub(super) drawn: u64,
}

impl GroupExtents {
    fn of(blocks: &[Option<Bounds>]) -> Self {
        let all = union(blocks).map(|bounds| Extent::of(&bounds));
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

/// A cloud in the order of its chunks. Bounds exclude points with non-finite positions, which are never
/// drawn.
pub(super) struct ChunkedCloud<'a> {
    points: &'a [Point],
    /// Cloud index of each point in chunk order; `None` for the cloud's own order.
    order: Option<Vec<u32>>,
    /// Bounds of each run with [`CULL_BLOCK`] points; [`GROUP`] runs together.
    pub(super) groups: Vec<GroupExtents>,
}

impl<'a> ChunkedCloud<'a> {
    pub(super) fn new(points: &'a [Point]) -> Self {
        let parts: Vec<Option<Bounds>> =
            points.par_chunks(CHUNK).map(|part| finite_bounds(part.iter())).collect();
        let order = union(&parts).and_then(|bounds| morton_order(points, &bounds));
        let mut cloud = Self { points, order, groups: Vec::new() };
        let blocks = points.len().div_ceil(CULL_BLOCK);
        let bounds = |block: usize| {
            let places = block * CULL_BLOCK..points.len().min((block + 1) * CULL_BLOCK);
            finite_bounds(cloud.points_at(places).map(|(_, point)| point))
        };
        let bounds: Vec<Option<Bounds>> = (0..blocks).into_par_iter().map(bounds).collect();
        cloud.groups = bounds.chunks(GROUP).map(GroupExtents::of).collect();
        cloud
    }

    /// Returns the number of points.
    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Returns the number of chunks.
    pub(super) fn chunks(&self) -> usize {
        self.points.len().div_ceil(CHUNK)
    }

    /// Returns the number of points in a chunk.
    pub(super) fn count(&self, chunk: usize) -> u32 {
        (self.points.len() - chunk * CHUNK).min(CHUNK) as u32
    }

    /// Returns whether the order differs from the cloud's own.
    pub(super) fn is_reordered(&self) -> bool {
        self.order.is_some()
    }

    /// Returns a range of points in chunk order, with their cloud indices.
    pub(super) fn points_at(&self, places: std::ops::Range<usize>) -> impl Iterator<Item = (u32, &'a Point)> {
        places.map(|place| {
            let index = self.order.as_ref().map_or(place as u32, |order| order[place]);
            (index, &self.points[index as usize])
        })
    }

    /// Writes a chunk in the device's layout: bits of x, y, z and the cloud index, a row of [`CHUNK`] texels.
    pub(super) fn write_row(&self, chunk: usize, row: &mut [[u32; 4]]) {
        let first = chunk * CHUNK;
        let places = first..first + self.count(chunk) as usize;
        for (texel, (index, point)) in row.iter_mut().zip(self.points_at(places)) {
            let [x, y, z] = point.position.map(f32::to_bits);
            *texel = [x, y, z, index];
        }
    }

    /// Returns colors and classes in the cloud's own order.
    pub(super) fn colors(&self, range: std::ops::Range<usize>) -> impl Iterator<Item = u32> {
        let end = range.end.min(self.points.len());
        self.points[range.start.min(end)..end].iter().map(|point| point.rgb_class)
    }
}

fn finite_bounds<'p>(points: impl Iterator<Item = &'p Point>) -> Option<Bounds> {
    Bounds::of(points.filter(|point| point.position.iter().all(|v| v.is_finite())))
}

fn union(parts: &[Option<Bounds>]) -> Option<Bounds> {
    parts.iter().flatten().copied().reduce(|a, b| Bounds {
        min: [0, 1, 2].map(|axis| a.min[axis].min(b.min[axis])),
        max: [0, 1, 2].map(|axis| a.max[axis].max(b.max[axis])),
    })
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
        let cloud = ChunkedCloud::new(&points);
        assert_eq!((cloud.chunks(), cloud.groups.len(), cloud.groups[0].drawn), (3, 1, 0x3ff));
        assert_eq!(cloud.count(2), 10_000 - 2 * 4096);
        let mut seen = vec![0; points.len()];
        for chunk in 0..3 {
            let mut row = vec![[0; 4]; CHUNK];
            cloud.write_row(chunk, &mut row);
            for (i, [x, _, _, index]) in row[..cloud.count(chunk) as usize].iter().enumerate() {
                let extent = cloud.groups[0].block((chunk * CHUNK + i) / CULL_BLOCK);
                seen[*index as usize] += 1;
                assert_eq!(f32::from_bits(*x), points[*index as usize].position[0]);
                assert!((f64::from(f32::from_bits(*x)) - extent.center[0]).abs() <= extent.half[0]);
            }
        }
        assert!(seen.iter().all(|n| *n == 1));
        let widths: f64 = (0..10).map(|block| 2.0 * cloud.groups[0].block(block).half[0]).sum();
        assert!(widths < 66_000.0, "{widths}: chunks of a line share a cell at most");
    }

    #[test]
    fn non_finite_points_do_not_widen_bounds() {
        let points = [point(1.0), point(f32::NAN), point(f32::INFINITY), point(3.0)];
        let cloud = ChunkedCloud::new(&points);
        let extent = cloud.groups[0].block(0);
        assert_eq!((extent.center[0], extent.half[0]), (2.0, 1.0));
        assert!(ChunkedCloud::new(&points[1..3]).groups[0].drawn == 0);
        assert!(ChunkedCloud::new(&[]).groups.is_empty());
        assert_eq!(cloud.colors(2..100).count(), 2);
    }
}
