//! Projection of points into visibility buffers.
//!
//! Operations and their order equal `project` in `reference.rs`, many points at a time: plain loops over
//! arrays, which the compiler vectorizes under `pulp`'s dispatch.

use super::packed::GROUP;
use super::window::{Layer, Window, key};
use crate::raster::Draw;
use crate::raster::schedule::Z_NEAR_M;

/// What decides where the points of a draw fall.
pub(super) struct Projection {
    image: [[f32; 4]; 3],
    crop: [[f32; 4]; 2],
    crop_radius_m: f32,
    z_far_m: f32,
    /// First and end column and row.
    columns: [f32; 2],
    rows: [f32; 2],
    stride: f32,
    /// Cell of the first column and row.
    first_cell: f32,
}

/// Cells, depths and keys for the points of a group; cell 0 for points that are not drawn.
pub(super) struct Cells {
    cell: [u32; GROUP],
    depth_m: [f32; GROUP],
    key: [u64; GROUP],
}

/// 2²³: the bits of its sum with a smaller integer contain that integer.
const INTEGER: f32 = 8_388_608.0;

#[inline(always)]
fn dot(row: &[f32; 4], x: f32, y: f32, z: f32) -> f32 {
    row[0] * x + row[1] * y + row[2] * z + row[3]
}

impl Projection {
    /// Maximum cell count of a window.
    pub(super) const MAX_CELLS: usize = 1 << 23;

    pub(super) fn new(draw: &Draw, window: &Window, z_far_m: f32) -> Self {
        let [left, top] = window.origin();
        Self {
            image: draw.image_from_local,
            crop: draw.crop_from_local,
            crop_radius_m: draw.crop_radius_m,
            z_far_m,
            columns: [left, left + window.stride() as f32],
            rows: [top, top + window.height() as f32],
            stride: window.stride() as f32,
            first_cell: window.cell(0, 0) as f32,
        }
    }

    /// Projects the points of a group; `crops`: whether the crop may exclude some of them.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
    pub(super) fn cells(&self, [xs, ys, zs]: &[[f32; GROUP]; 3], crops: bool, cells: &mut Cells) {
        let [left, right] = self.columns;
        let [top, bottom] = self.rows;
        for i in 0..GROUP {
            let (x, y, z) = (xs[i], ys[i], zs[i]);
            let depth_m = dot(&self.image[2], x, y, z);
            let column = (dot(&self.image[0], x, y, z) / depth_m).floor();
            let row = (dot(&self.image[1], x, y, z) / depth_m).floor();
            let drawn = (depth_m > Z_NEAR_M)
                & (depth_m <= self.z_far_m)
                & (column >= left)
                & (column < right)
                & (row >= top)
                & (row < bottom);
            let cell = (row - top) * self.stride + (column - left) + self.first_cell;
            let cell = (cell + INTEGER).to_bits() & (INTEGER as u32 - 1);
            cells.cell[i] = if drawn { cell } else { 0 };
            cells.depth_m[i] = depth_m;
        }
        if crops {
            for i in 0..GROUP {
                let across = self.crop.each_ref().map(|row| dot(row, xs[i], ys[i], zs[i]).abs());
                let drawn = (across[0] <= self.crop_radius_m) & (across[1] <= self.crop_radius_m);
                cells.cell[i] = if drawn { cells.cell[i] } else { 0 };
            }
        }
    }
}

impl Default for Cells {
    fn default() -> Self {
        Self { cell: [0; GROUP], depth_m: [0.0; GROUP], key: [0; GROUP] }
    }
}

impl Cells {
    /// Numbers the points: `first` plus the index of each in the cloud, which is its place if there is no
    /// `index`. `group`: number of the group in the cloud.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
    pub(super) fn number(&mut self, first: u32, group: usize, index: Option<&[u32; GROUP]>) {
        let own = first + (group * GROUP) as u32;
        for i in 0..GROUP {
            let number = index.map_or(own + i as u32, |index| first + index[i]);
            self.key[i] = key(self.depth_m[i], number);
        }
    }

    /// Draws the points: the least key of each cell remains. Without branches: whether a point wins is hard
    /// to predict.
    #[inline(always)]
    pub(super) fn put(&self, layer: &mut Layer) {
        let keys = &mut layer.keys[..];
        for (cell, key) in self.cell.iter().zip(&self.key) {
            let at = &mut keys[*cell as usize];
            *at = (*at).min(*key);
        }
    }
}
