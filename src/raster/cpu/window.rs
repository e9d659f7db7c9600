//! The part of a view that one task renders, and its visibility buffers.

use std::ops::Range;

/// Rows of a view, padded on all sides so that squares of points outside reach in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// Width of the view, pixels.
    pub(super) width: u32,
    /// Rows of the view: first and end.
    pub(super) rows: [u32; 2],
    /// Padding on each side, pixels.
    pub(super) pad: u32,
}

/// Cells before the first row. Cell 0 belongs to no pixel: its key is below all others, so that points
/// outside the window can be drawn there without effect.
const LEAD: usize = 16;

impl Window {
    /// Returns the number of cells in a row, padding included.
    pub(super) fn stride(&self) -> usize {
        (self.width + 2 * self.pad) as usize
    }

    /// Returns the number of rows, padding included.
    pub(super) fn height(&self) -> usize {
        (self.rows[1] - self.rows[0] + 2 * self.pad) as usize
    }

    /// Returns the first column and row, which lie in the padding.
    pub(super) fn origin(&self) -> [f32; 2] {
        [-(self.pad as f32), self.rows[0] as f32 - self.pad as f32]
    }

    /// Returns the cell of a column and row relative to [`Window::origin`].
    pub(super) fn cell(&self, column: usize, row: usize) -> usize {
        LEAD + row * self.stride() + column
    }
}

/// Side of a tile, cells.
pub(super) const TILE: usize = 8;

/// How far each tile of a window is covered.
#[derive(Clone, Default)]
pub(super) struct Tiles {
    /// Depth of the farthest square seen in a tile, meters; infinite if a pixel may show something farther.
    /// What is drawn later may be nearer.
    pub(super) depth_m: Vec<f32>,
    /// Number of tiles in a row.
    pub(super) stride: usize,
    /// Depth up to which points have a radius of at least 1, meters.
    pub(super) reach_m: f32,
}

/// A visibility buffer: the key of the nearest point per cell of a window.
#[derive(Default)]
pub(super) struct Layer {
    pub(super) keys: Vec<u64>,
    pub(super) tiles: Tiles,
}

/// Key of an empty cell: infinitely far.
const EMPTY: u64 = key(f32::INFINITY, u32::MAX);

/// Returns the key of a point: the minimum is the nearest point; ties go to the lowest number. The depth must
/// be positive: then its bits are ordered like its values.
#[inline(always)]
pub(super) const fn key(depth_m: f32, number: u32) -> u64 {
    (depth_m.to_bits() as u64) << 32 | number as u64
}

/// Returns the depth of a key, meters; infinite where empty.
#[inline(always)]
pub(super) const fn depth_m(key: u64) -> f32 {
    f32::from_bits((key >> 32) as u32)
}

impl Tiles {
    /// Forgets what covers the tiles of a window; points up to `reach_m` have a radius of at least 1.
    fn clear(&mut self, window: &Window, reach_m: f32) {
        let count = |cells: usize| cells.div_ceil(TILE);
        self.stride = count(window.stride());
        self.depth_m.clear();
        self.depth_m.resize(self.stride * count(window.height()), f32::INFINITY);
        self.reach_m = reach_m;
    }
}

impl Layer {
    /// Empties the layer for a window; points up to `reach_m` have a radius of at least 1.
    pub(super) fn clear(&mut self, window: &Window, reach_m: f32) {
        self.tiles.clear(window, reach_m);
        let cells = LEAD + window.stride() * window.height();
        self.keys.clear();
        self.keys.resize(cells, EMPTY);
        self.keys[0] = 0;
    }

    /// Copies another layer's rows of a window, with the rows around them whose squares reach the same
    /// pixels, or the neighbors that color is interpolated with. Elsewhere, the layer is undefined.
    pub(super) fn copy_rows(&mut self, from: &Self, window: &Window, rows: &Range<u32>) {
        self.keys.resize(from.keys.len(), EMPTY);
        self.keys[0] = 0;
        let around = 2 * window.pad as usize + 1;
        // Whole tiles: their cover is computed from all their keys.
        let first = (rows.start as usize).saturating_sub(around) / TILE * TILE;
        let end = (rows.end as usize + around).next_multiple_of(TILE).min(window.height());
        let cells = window.cell(0, first)..window.cell(0, end);
        self.keys[cells.clone()].copy_from_slice(&from.keys[cells]);
        self.tiles.clone_from(&from.tiles);
    }

    /// Returns the keys of a row, padding included.
    pub(super) fn row(&self, window: &Window, row: usize) -> &[u64] {
        let first = window.cell(0, row);
        &self.keys[first..first + window.stride()]
    }
}
