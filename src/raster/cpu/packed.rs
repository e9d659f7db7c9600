//! Clouds in the layout of the projection loop.

use rayon::prelude::*;

use crate::cloud::Point;
use crate::raster::chunk::{CHUNK, CULL_BLOCK, ChunkedCloud};

/// Points that are projected in one loop, and skipped together if all of them are hidden.
pub(super) const GROUP: usize = 64;
/// Groups in a block of points that are culled together.
pub(super) const GROUPS: usize = CULL_BLOCK / GROUP;

/// A chunk's points, coordinate by coordinate, in the order of [`ChunkedCloud`].
pub(super) struct PackedChunk {
    /// Meters, whole groups; padded with NaN, which is never drawn.
    pub(super) position: [Vec<f32>; 3],
    /// Index of each point in the cloud, padded with zeros; empty if the order is the cloud's own.
    pub(super) index: Vec<u32>,
    /// Bounds of the finite positions of each group, meters: minimum x, y, z, maximum x, y, z. NaN if there are none.
    pub(super) bounds: [Vec<f32>; 6],
}

/// A cloud's points and the bounds of their blocks.
pub(super) struct PackedCloud<'a> {
    pub(super) chunked: ChunkedCloud<'a>,
    pub(super) chunks: Vec<PackedChunk>,
    /// Index of its first color among those of all clouds.
    pub(super) first_color: usize,
    /// Maximum absolute coordinates of the finite positions, meters.
    pub(super) reach_m: [f32; 3],
}

impl<'a> PackedCloud<'a> {
    pub(super) fn new(points: &'a [Point], first_color: usize) -> Self {
        let chunked = ChunkedCloud::new(points);
        let chunks: Vec<PackedChunk> =
            (0..chunked.chunks()).into_par_iter().map(|chunk| PackedChunk::new(&chunked, chunk)).collect();
        let largest = |axis: usize| {
            let sides = chunks.iter().flat_map(|c| c.bounds[axis].iter().chain(&c.bounds[axis + 3]));
            sides.fold(0.0_f32, |most, side| most.max(side.abs()))
        };
        let reach_m = [0, 1, 2].map(largest);
        Self { chunked, chunks, first_color, reach_m }
    }
}

impl PackedChunk {
    fn new(cloud: &ChunkedCloud<'_>, chunk: usize) -> Self {
        let count = cloud.count(chunk) as usize;
        let padded = count.next_multiple_of(CULL_BLOCK);
        let first = chunk * CHUNK;
        let mut position = [0, 1, 2].map(|_| vec![f32::NAN; padded]);
        let mut index = vec![0; if cloud.is_reordered() { padded } else { 0 }];
        for (at, (from, point)) in cloud.points_at(first..first + count).enumerate() {
            (0..3).for_each(|axis| position[axis][at] = point.position[axis]);
            if cloud.is_reordered() {
                index[at] = from;
            }
        }
        let mut bounds = [0; 6].map(|_| vec![f32::NAN; padded / GROUP]);
        for at in 0..count {
            if position.iter().all(|axis| axis[at].is_finite()) {
                for axis in 0..3 {
                    let (value, group) = (position[axis][at], at / GROUP);
                    // The minimum of a number and NaN is the number.
                    bounds[axis][group] = bounds[axis][group].min(value);
                    bounds[axis + 3][group] = bounds[axis + 3][group].max(value);
                }
            }
        }
        Self { position, index, bounds }
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
        assert_eq!(cloud.chunks.len(), 2);
        let mut seen = vec![0; points.len()];
        for (number, chunk) in cloud.chunks.iter().enumerate() {
            for at in 0..cloud.chunked.count(number) as usize {
                let index = chunk.index.get(at).map_or(number * CHUNK + at, |i| *i as usize);
                let x = chunk.position[0][at];
                seen[index] += 1;
                assert_eq!(x.to_bits(), points[index].position[0].to_bits());
                let [low, high] = [0, 3].map(|side| chunk.bounds[side][at / GROUP]);
                assert!(x.is_nan() || (low <= x && x <= high));
            }
        }
        assert!(seen.iter().all(|n| *n == 1));
        assert_eq!(cloud.reach_m, [999.0, 1.0, 2.0]);
    }

    #[test]
    fn groups_without_finite_points_have_no_bounds() {
        let points = [Point::new([f32::INFINITY, 0.0, 0.0], [0; 3], 0)];
        let cloud = PackedCloud::new(&points, 0);
        assert!(cloud.chunks[0].bounds[0][0].is_nan() && cloud.reach_m == [0.0; 3]);
        assert!(PackedCloud::new(&[], 0).chunks.is_empty());
    }
}
