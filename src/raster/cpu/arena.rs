//! Loaded chunks of points in the layout of the projection loop.

use rayon::prelude::*;

use super::memory::HugeSlice;
use super::packed::{BlockColors, BoundsLanes, PackedCloud, Positions, fill_colors};
use crate::cloud::Point;
use crate::error::FileError;
use crate::raster::chunk::{CHUNK, CULL_BLOCK};

/// Blocks of a chunk.
const BLOCKS: usize = CHUNK / CULL_BLOCK;
/// Rows that are allocated at once.
pub(super) const SEGMENT_ROWS: usize = 256;
/// Memory of a row, bytes.
pub(super) const ROW_BYTES: usize = BLOCKS * size_of::<(Positions, BoundsLanes, BlockColors)>();

/// Rows of one chunk each. Memory is taken when rows are filled, in segments, and never moved.
#[derive(Default)]
pub(super) struct Arena {
    segments: Vec<Segment>,
}

/// [`SEGMENT_ROWS`] rows, block by block.
struct Segment {
    positions: HugeSlice<Positions>,
    /// For the groups of each block.
    bounds: HugeSlice<BoundsLanes>,
    colors: HugeSlice<BlockColors>,
}

/// A loaded block.
#[derive(Clone, Copy)]
pub(super) struct PackedBlock<'a> {
    pub(super) positions: &'a Positions,
    /// Of its groups.
    pub(super) bounds: &'a BoundsLanes,
    pub(super) colors: &'a BlockColors,
}

/// A chunk to load: cloud, chunk, and row.
pub(super) type Load = (u32, u32, u32);

impl Arena {
    /// Returns the number of rows.
    pub(super) fn rows(&self) -> usize {
        self.segments.len() * SEGMENT_ROWS
    }

    /// Adds a segment.
    pub(super) fn grow(&mut self) {
        let blocks = SEGMENT_ROWS * BLOCKS;
        self.segments.push(Segment {
            positions: HugeSlice::zeroed(blocks),
            bounds: HugeSlice::zeroed(blocks),
            colors: HugeSlice::zeroed(blocks),
        });
    }

    /// Returns a block of the chunk in a row.
    #[inline(always)]
    pub(super) fn block(&self, row: u32, block: usize) -> PackedBlock<'_> {
        let segment = &self.segments[row as usize / SEGMENT_ROWS];
        let at = row as usize % SEGMENT_ROWS * BLOCKS + block;
        PackedBlock {
            positions: &segment.positions[at],
            bounds: &segment.bounds[at],
            colors: &segment.colors[at],
        }
    }

    /// Reads chunks into their rows, all of which exist and occur once.
    ///
    /// # Errors
    /// Returns the first error in the order of the rows; some rows are undefined then.
    pub(super) fn load(&mut self, clouds: &[PackedCloud<'_>], loads: &[Load]) -> Result<(), FileError> {
        let mut of_row = vec![None; self.rows()];
        loads.iter().for_each(|&(cloud, chunk, row)| of_row[row as usize] = Some((cloud, chunk)));
        let segments = self.segments.par_iter_mut().zip(of_row.par_chunks(SEGMENT_ROWS));
        let rows = segments.flat_map(|(segment, of_row)| segment.par_rows().zip(of_row));
        let wanted = rows.filter_map(|(row, of_row)| Some((row, (*of_row)?)));
        let failed = wanted.map_init(Vec::new, |buffer, (row, (cloud, chunk))| {
            row.fill(clouds[cloud as usize].chunked.read(chunk as usize, buffer)?);
            Ok(())
        });
        failed.find_first(Result::is_err).unwrap_or(Ok(()))
    }
}

/// Memory of a chunk.
struct RowMut<'a> {
    positions: &'a mut [Positions],
    bounds: &'a mut [BoundsLanes],
    colors: &'a mut [BlockColors],
}

impl Segment {
    fn par_rows(&mut self) -> impl IndexedParallelIterator<Item = RowMut<'_>> {
        let positions = self.positions.par_chunks_mut(BLOCKS);
        let others = self.bounds.par_chunks_mut(BLOCKS).zip(self.colors.par_chunks_mut(BLOCKS));
        positions.zip(others).map(|(positions, (bounds, colors))| RowMut { positions, bounds, colors })
    }
}

impl RowMut<'_> {
    fn fill(self, points: &[Point]) {
        let Self { positions, bounds, colors } = self;
        let blocks = points.chunks(CULL_BLOCK).chain(std::iter::repeat(&[][..]));
        for (((positions, bounds), colors), points) in
            positions.iter_mut().zip(bounds).zip(colors).zip(blocks)
        {
            *positions = Positions::of(points);
            *bounds = positions.bounds();
            fill_colors(colors, points);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_hold_the_chunks_that_were_loaded_last() {
        let cloud = |from: usize, count: usize| -> Vec<Point> {
            let point = |i| Point { position: [(from + i) as f32, 0.0, 0.0], rgb_class: (from + i) as u32 };
            (0..count).map(point).collect()
        };
        let points = [cloud(0, 3 * CHUNK), cloud(50_000, CHUNK + 1030)];
        let clouds = points.each_ref().map(|points| PackedCloud::new(points.into()));
        let mut arena = Arena::default();
        (0..2).for_each(|_| arena.grow());
        assert_eq!(arena.rows(), 512);
        arena.load(&clouds, &[(0, 2, 0), (0, 0, 300), (1, 1, 299)]).unwrap();
        arena.load(&clouds, &[(1, 0, 0)]).unwrap();
        let first = |row, block| {
            let PackedBlock { positions, bounds, colors } = arena.block(row, block);
            (positions.0[0][0][0], bounds.0[0][0], colors[0])
        };
        assert_eq!(first(300, 3), (3072.0, 3072.0, 3072));
        assert_eq!(first(0, 1), (51_024.0, 51_024.0, 51_024));
        assert_eq!(first(299, 1), (55_120.0, 55_120.0, 55_120));
        let last = arena.block(299, 1);
        assert!(last.positions.0[0][0][6].is_nan() && last.bounds.0[0][1].is_nan());
        assert!(arena.block(299, 2).positions.0[15][2][63].is_nan());
    }
}
