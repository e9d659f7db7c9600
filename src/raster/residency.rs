//! Which chunks of clouds are loaded, and in which row of a store.

use super::chunk::ChunkedCloud;

/// Memory that points may take by default, on a device whose memory is the host's, bytes.
pub const DEFAULT_MEMORY_BYTES: u64 = 2 << 30;

/// Row of a chunk that is not loaded, and chunk of an empty row.
const NONE: u32 = u32::MAX;

/// Rows of loaded chunks. If there are too few, the least recently used ones are evicted.
pub(super) struct Residency {
    /// Index of each cloud's first chunk, and the number of all chunks.
    firsts: Vec<u32>,
    /// Row of each chunk.
    row_of: Vec<u32>,
    /// Chunk in each row.
    chunk_in: Vec<u32>,
    /// Frame that last used each row.
    used: Vec<u64>,
    frame: u64,
    /// Number of loaded chunks.
    loaded: usize,
}

impl Residency {
    pub(super) fn new<'c, 'a: 'c>(clouds: impl Iterator<Item = &'c ChunkedCloud<'a>>) -> Self {
        let mut firsts = vec![0];
        firsts.extend(clouds.scan(0, |chunks, cloud| {
            *chunks += cloud.chunks() as u32;
            Some(*chunks)
        }));
        let chunks = firsts.last().copied().unwrap_or(0) as usize;
        let (chunk_in, used) = Default::default();
        Self { firsts, row_of: vec![NONE; chunks], chunk_in, used, frame: 0, loaded: 0 }
    }

    /// Returns the number of all chunks.
    pub(super) fn chunks(&self) -> usize {
        self.row_of.len()
    }

    /// Returns the number of rows.
    pub(super) fn rows(&self) -> usize {
        self.chunk_in.len()
    }

    /// Returns the number of loaded chunks.
    pub(super) fn loaded(&self) -> usize {
        self.loaded
    }

    /// Returns whether all chunks are loaded.
    pub(super) fn is_complete(&self) -> bool {
        self.loaded == self.chunks()
    }

    /// Adds empty rows.
    pub(super) fn grow(&mut self, rows: usize) {
        self.chunk_in.resize(rows.max(self.rows()), NONE);
        self.used.resize(self.rows(), 0);
    }

    /// Begins a frame.
    pub(super) fn next_frame(&mut self) {
        self.frame += 1;
    }

    /// Returns the row of a chunk and marks it as used in this frame; `None` if it is not loaded.
    pub(super) fn row(&mut self, cloud: u32, chunk: u32) -> Option<u32> {
        let row = Some(self.row_of[self.index(cloud, chunk)]).filter(|row| *row != NONE)?;
        self.used[row as usize] = self.frame;
        Some(row)
    }

    /// Returns the row of a cloud's chunk; `None` if it is not loaded.
    pub(super) fn row_of(&self, cloud: usize, chunk: usize) -> Option<u32> {
        Some(self.row_of[self.firsts[cloud] as usize + chunk]).filter(|row| *row != NONE)
    }

    /// Returns the `count` least recently used rows (at most all rows) in ascending order, for eviction.
    pub(super) fn oldest(&self, count: usize) -> Vec<u32> {
        let mut rows: Vec<u32> = (0..self.used.len() as u32).collect();
        let count = count.min(rows.len());
        if count < rows.len() {
            rows.select_nth_unstable_by_key(count, |row| (self.used[*row as usize], *row));
            rows.truncate(count);
        }
        rows.sort_unstable();
        rows
    }

    /// Marks a row as empty.
    pub(super) fn forget(&mut self, row: u32) {
        let old = std::mem::replace(&mut self.chunk_in[row as usize], NONE);
        if old != NONE {
            self.row_of[old as usize] = NONE;
            self.loaded -= 1;
        }
        self.used[row as usize] = 0;
    }

    /// Assigns a chunk that is not loaded to a row, in place of the row's own.
    pub(super) fn replace(&mut self, cloud: u32, chunk: u32, row: u32) {
        self.forget(row);
        let index = self.index(cloud, chunk);
        self.row_of[index] = row;
        self.chunk_in[row as usize] = index as u32;
        self.used[row as usize] = self.frame;
        self.loaded += 1;
    }

    fn index(&self, cloud: u32, chunk: u32) -> usize {
        (self.firsts[cloud as usize] + chunk) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Point;
    use crate::raster::chunk::CHUNK;

    #[test]
    fn least_recently_used_rows_are_evicted_first() {
        let points = vec![Point::default(); 5 * CHUNK];
        let (first, second) = points.split_at(2 * CHUNK);
        let clouds = [first, second].map(|points| ChunkedCloud::new(points.into()));
        let mut residency = Residency::new(clouds.iter());
        assert_eq!((residency.chunks(), residency.rows(), residency.is_complete()), (5, 0, false));
        residency.grow(3);
        assert_eq!(residency.row(1, 0), None);
        residency.next_frame();
        residency.replace(0, 0, 0);
        residency.replace(1, 0, 1);
        residency.replace(1, 2, 2);
        residency.next_frame();
        assert_eq!((residency.row(1, 0), residency.row(1, 2), residency.row(0, 1)), (Some(1), Some(2), None));
        assert_eq!((residency.oldest(1), residency.oldest(9)), (vec![0], vec![0, 1, 2]));
        residency.replace(0, 1, 0);
        assert_eq!((residency.row(0, 0), residency.row_of(0, 1)), (None, Some(0)));
        residency.forget(0);
        assert_eq!((residency.row(0, 1), residency.row(1, 0)), (None, Some(1)));
        residency.grow(5);
        assert_eq!(residency.oldest(3), [0, 3, 4]);
        for (row, (cloud, chunk)) in [(0, (0, 0)), (3, (0, 1)), (4, (1, 1))] {
            assert!(!residency.is_complete());
            residency.replace(cloud, chunk, row);
        }
        assert!(residency.is_complete());
    }
}
