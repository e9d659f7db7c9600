//! The part of a view that one task renders, and its visibility buffers.

/// Rows of a view with padding on all sides, in which the squares of points outside reach in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// Width of the view, pixels.
    pub(super) width: u32,
    /// Rows of the view: first and end.
    pub(super) rows: [u32; 2],
    /// Padding on each side, pixels.
    pub(super) pad: u32,
}

/// Cells before the first row. Cell 0 belongs to no pixel: its depth is below all others, so that points outside the
/// window can be drawn there without effect.
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

/// A visibility buffer: the depth and number of the nearest point per cell of a window.
#[derive(Default)]
pub(super) struct Layer {
    /// Meters; infinite where empty.
    pub(super) depth_m: Vec<f32>,
    /// Undefined where empty.
    pub(super) number: Vec<u32>,
}

impl Layer {
    /// Empties the layer for a window.
    pub(super) fn clear(&mut self, window: &Window) {
        let cells = LEAD + window.stride() * window.height();
        self.depth_m.clear();
        self.depth_m.resize(cells, f32::INFINITY);
        self.depth_m[0] = f32::NEG_INFINITY;
        if self.number.len() < cells {
            self.number.resize(cells, 0);
        }
    }

    /// Returns depths and numbers of a row, padding included.
    pub(super) fn row(&self, window: &Window, row: usize) -> (&[f32], &[u32]) {
        let first = window.cell(0, row);
        let cells = first..first + window.stride();
        (&self.depth_m[cells.clone()], &self.number[cells])
    }
}
