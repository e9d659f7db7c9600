//! Clouds in the layout of the projection loop.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::memory::HugeSlice;
use crate::cloud::{Bounds, Cloud, Point};
use crate::raster::chunk::{CULL_BLOCK, ChunkedCloud, RUN};

/// Points that are projected in one loop, and skipped together if all of them are hidden.
pub(super) const GROUP: usize = RUN;
/// Groups in a block of points that are culled together.
pub(super) const GROUPS: usize = CULL_BLOCK / GROUP;
/// Bounds that are projected in one loop: of a block's groups, or as many blocks.
pub(super) const LANES: usize = GROUPS;

/// Positions of a block's points, group by group and coordinate by coordinate, in the order of
/// [`ChunkedCloud`]. Meters; padded with NaN, which is never drawn.
#[repr(transparent)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct Positions(pub(super) [[[f32; GROUP]; 3]; GROUPS]);

/// Bounds over the finite positions of point sets, meters: minimum x, y, z, maximum x, y, z. NaN if there are
/// none.
#[repr(transparent)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct BoundsLanes(pub(super) [[f32; LANES]; 6]);

/// Colors and classes of a block's points.
pub(super) type BlockColors = [u32; CULL_BLOCK];

/// A cloud, without its points.
pub(super) struct PackedCloud<'a> {
    pub(super) chunked: ChunkedCloud<'a>,
    /// Colors and classes in the cloud's own order, if that is not the order of its chunks.
    pub(super) colors: HugeSlice<BlockColors>,
    /// Bounds of the blocks, [`LANES`] at a time.
    pub(super) blocks: Vec<BoundsLanes>,
    /// Maximum absolute coordinates of the finite positions, meters.
    pub(super) reach_m: [f32; 3],
}

impl<'a> PackedCloud<'a> {
    pub(super) fn new(cloud: Cloud<'a>) -> Self {
        let (chunked, blocks) = ChunkedCloud::with_blocks(cloud);
        let blocks = blocks.chunks(LANES).map(BoundsLanes::of_blocks).collect();
        let largest = |bounds: &Bounds, axis: usize| bounds.min[axis].abs().max(bounds.max[axis].abs());
        let reach_m = chunked.all.map_or([0.0; 3], |all| [0, 1, 2].map(|axis| largest(&all, axis)));
        let mut colors = HugeSlice::zeroed(0);
        if let (Some(_), Cloud::Memory(points)) = (chunked.order(), chunked.cloud) {
            colors = HugeSlice::zeroed(points.len().div_ceil(CULL_BLOCK));
            let blocks = colors.par_iter_mut().zip(points.par_chunks(CULL_BLOCK));
            blocks.for_each(|(to, points)| fill_colors(to, points));
        }
        Self { chunked, colors, blocks, reach_m }
    }
}

/// Copies the colors and classes of a block's points.
pub(super) fn fill_colors(colors: &mut BlockColors, points: &[Point]) {
    colors.iter_mut().zip(points).for_each(|(color, point)| *color = point.rgb_class);
}

impl<'a> AsRef<ChunkedCloud<'a>> for PackedCloud<'a> {
    fn as_ref(&self) -> &ChunkedCloud<'a> {
        &self.chunked
    }
}

impl Positions {
    /// Packs the points of a block.
    pub(super) fn of(points: &[Point]) -> Self {
        let mut groups = [[[f32::NAN; GROUP]; 3]; GROUPS];
        for (at, point) in points.iter().enumerate() {
            (0..3).for_each(|axis| groups[at / GROUP][axis][at % GROUP] = point.position[axis]);
        }
        Self(groups)
    }

    /// Returns the bounds of the groups.
    pub(super) fn bounds(&self) -> BoundsLanes {
        let mut bounds = BoundsLanes::NONE;
        for (group, [xs, ys, zs]) in self.0.iter().enumerate() {
            for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
                let position = [*x, *y, *z];
                if position.iter().all(|value| value.is_finite()) {
                    bounds.include(group, position, position);
                }
            }
        }
        bounds
    }
}

impl BoundsLanes {
    const NONE: Self = Self([[f32::NAN; LANES]; 6]);

    fn of_blocks(blocks: &[Option<Bounds>]) -> Self {
        let mut lanes = Self::NONE;
        for (lane, bounds) in blocks.iter().enumerate() {
            if let Some(Bounds { min, max }) = bounds {
                lanes.include(lane, *min, *max);
            }
        }
        lanes
    }

    /// Extends the bounds of a lane. The lower or higher of a number and NaN is the number.
    fn include(&mut self, lane: usize, low: [f32; 3], high: [f32; 3]) {
        for axis in 0..3 {
            self.0[axis][lane] = self.0[axis][lane].min(low[axis]);
            self.0[axis + 3][lane] = self.0[axis + 3][lane].max(high[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_bound_their_finite_points() {
        let at = |i: usize| if i % 7 == 3 { f32::NAN } else { (i * 37 % 1000) as f32 };
        let points: Vec<Point> = (0..5000).map(|i| Point::new([at(i), -1.0, 2.0], [0; 3], 0)).collect();
        let cloud = PackedCloud::new((&points).into());
        assert_eq!((cloud.blocks.len(), cloud.reach_m), (1, [999.0, 1.0, 2.0]));
        let mut buffer = Vec::new();
        for chunk in 0..2 {
            let points = cloud.chunked.read(chunk, &mut buffer).unwrap();
            for (block, points) in points.chunks(CULL_BLOCK).enumerate() {
                let positions = Positions::of(points);
                let bounds = positions.bounds();
                for (i, point) in points.iter().enumerate() {
                    let x = positions.0[i / GROUP][0][i % GROUP];
                    assert_eq!(x.to_bits(), point.position[0].to_bits());
                    let [low, high] = [0, 3].map(|side| bounds.0[side][i / GROUP]);
                    let [least, most] = [0, 3].map(|side| cloud.blocks[0].0[side][4 * chunk + block]);
                    assert!(x.is_nan() || (least <= low && low <= x && x <= high && high <= most));
                }
                let padding =
                    &positions.0.as_flattened().as_flattened()[3 * points.len().next_multiple_of(GROUP)..];
                assert!(padding.iter().all(|value| value.is_nan()));
            }
        }
    }

    #[test]
    fn groups_without_finite_points_have_no_bounds() {
        let points = [Point::new([f32::INFINITY, 0.0, 0.0], [0; 3], 0)];
        let cloud = PackedCloud::new((&points).into());
        assert!(cloud.blocks[0].0[0][0].is_nan() && cloud.reach_m == [0.0; 3]);
        assert!(Positions::of(&points).bounds().0[0][0].is_nan());
        assert!(PackedCloud::new((&[]).into()).blocks.is_empty());
    }
}
