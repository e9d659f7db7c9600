//! Clouds in the layout of the projection loop.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::memory::HugeSlice;
use crate::cloud::Point;
use crate::raster::chunk::{CULL_BLOCK, ChunkedCloud};

/// Points that are projected in one loop, and skipped together if all of them are hidden.
pub(super) const GROUP: usize = 64;
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

/// A cloud's points and the bounds of their groups, by block.
pub(super) struct PackedCloud<'a> {
    pub(super) chunked: ChunkedCloud<'a>,
    pub(super) positions: HugeSlice<Positions>,
    /// For the groups of each block.
    pub(super) bounds: HugeSlice<BoundsLanes>,
    /// Of the blocks, [`LANES`] at a time.
    pub(super) blocks: Vec<BoundsLanes>,
    /// Index of each point in the cloud, group by group; empty if the order is the cloud's own.
    pub(super) index: HugeSlice<[u32; GROUP]>,
    /// Index of its first color among the colors of all clouds.
    pub(super) first_color: usize,
    /// Maximum absolute coordinates of the finite positions, meters.
    pub(super) reach_m: [f32; 3],
}

impl<'a> PackedCloud<'a> {
    pub(super) fn new(points: &'a [Point], first_color: usize) -> Self {
        let chunked = ChunkedCloud::new(points);
        let blocks = points.len().div_ceil(CULL_BLOCK);
        let mut positions: HugeSlice<Positions> = HugeSlice::zeroed(blocks);
        let indexed = if chunked.is_reordered() { blocks * GROUPS } else { 0 };
        let mut index: HugeSlice<[u32; GROUP]> = HugeSlice::zeroed(indexed);
        let mut bounds: HugeSlice<BoundsLanes> = HugeSlice::zeroed(blocks);
        positions.par_iter_mut().zip(bounds.par_iter_mut()).enumerate().for_each(
            |(block, (positions, bounds))| {
                *positions = Positions::of(&chunked, block);
                *bounds = positions.bounds();
            },
        );
        index.par_chunks_mut(GROUPS).enumerate().for_each(|(block, index)| {
            let places = chunked.points_at(places(&chunked, block));
            index.as_flattened_mut().iter_mut().zip(places).for_each(|(to, (from, _))| *to = from);
        });
        let blocks: Vec<BoundsLanes> = bounds.par_chunks(LANES).map(BoundsLanes::of).collect();
        let largest = |axis: usize| {
            let sides = blocks.iter().flat_map(|b| b.0[axis].iter().chain(&b.0[axis + 3]));
            sides.fold(0.0_f32, |most, side| most.max(side.abs()))
        };
        let reach_m = [0, 1, 2].map(largest);
        Self { chunked, positions, bounds, blocks, index, first_color, reach_m }
    }
}

/// Places of a block's points in chunk order.
fn places(cloud: &ChunkedCloud<'_>, block: usize) -> std::ops::Range<usize> {
    block * CULL_BLOCK..cloud.len().min((block + 1) * CULL_BLOCK)
}

impl Positions {
    fn of(cloud: &ChunkedCloud<'_>, block: usize) -> Self {
        let mut groups = [[[f32::NAN; GROUP]; 3]; GROUPS];
        for (at, (_, point)) in cloud.points_at(places(cloud, block)).enumerate() {
            (0..3).for_each(|axis| groups[at / GROUP][axis][at % GROUP] = point.position[axis]);
        }
        Self(groups)
    }

    fn bounds(&self) -> BoundsLanes {
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

    /// Returns the bounds of blocks; `blocks`: the bounds of their groups.
    fn of(blocks: &[Self]) -> Self {
        let mut bounds = Self::NONE;
        for (block, groups) in blocks.iter().enumerate() {
            for group in 0..GROUPS {
                let [low, high] = [0, 3].map(|side| [0, 1, 2].map(|axis| groups.0[side + axis][group]));
                bounds.include(block, low, high);
            }
        }
        bounds
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
        let cloud = PackedCloud::new(&points, 0);
        assert_eq!((cloud.positions.len(), cloud.bounds.len(), cloud.blocks.len()), (5, 5, 1));
        let mut seen = vec![0; points.len()];
        for place in 0..points.len() {
            let (block, group) = (place / CULL_BLOCK, place % CULL_BLOCK / GROUP);
            let index = cloud.index.as_flattened().get(place).map_or(place, |i| *i as usize);
            let x = cloud.positions[block].0[group][0][place % GROUP];
            seen[index] += 1;
            assert_eq!(x.to_bits(), points[index].position[0].to_bits());
            let [low, high] = [0, 3].map(|side| cloud.bounds[block].0[side][group]);
            let [least, most] = [0, 3].map(|side| cloud.blocks[0].0[side][block]);
            assert!(x.is_nan() || (least <= low && low <= x && x <= high && high <= most));
        }
        assert!(seen.iter().all(|n| *n == 1));
        assert_eq!(cloud.reach_m, [999.0, 1.0, 2.0]);
    }

    #[test]
    fn groups_without_finite_points_have_no_bounds() {
        let points = [Point::new([f32::INFINITY, 0.0, 0.0], [0; 3], 0)];
        let cloud = PackedCloud::new(&points, 0);
        assert!(cloud.bounds[0].0[0][0].is_nan() && cloud.reach_m == [0.0; 3]);
        assert!(PackedCloud::new(&[], 0).positions.is_empty());
    }
}
