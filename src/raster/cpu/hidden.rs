//! Footprints of groups of points, and which of them are hidden.
//!
//! A footprint is a rectangle of cells and a depth: every point of the group falls into the rectangle, or outside the
//! window, and is not nearer. It is hidden if every cell of the rectangle already has a nearer point: then none of its
//! points would be drawn. Bounds are widened by more than the rounding errors of the projection.

use super::packed::{BlockBounds, GROUP, GROUPS};
use super::window::{Layer, Window, depth_m};
use crate::raster::Draw;
use crate::raster::schedule::Z_NEAR_M;

/// Relative rounding error of a projected coordinate, with a margin: four products, three sums, 2⁻²⁴ each.
const ROUNDING: f32 = 2e-6;
/// Absolute margin of pixel coordinates.
const PIXEL_MARGIN: f32 = 2e-3;
/// Depth below which a footprint is not computed, meters.
const MIN_DEPTH_M: f32 = 0.05;
/// Rectangles of more cells per point are never hidden: testing them costs more than drawing their points.
const CELLS_PER_POINT: usize = 2;

/// Footprints of the groups of a draw.
pub(super) struct Footprints {
    image: [[f32; 4]; 3],
    z_far_m: f32,
    /// Rounding errors of the three rows of the projection.
    error: [f32; 3],
}

/// Footprints of the groups of a block.
#[derive(Default)]
pub(super) struct GroupFootprints {
    /// Lower bound of depths, meters; NaN if there are no points.
    nearest_m: [f32; GROUPS],
    /// First and last column and row: floored pixel coordinates.
    left: [f32; GROUPS],
    right: [f32; GROUPS],
    top: [f32; GROUPS],
    bottom: [f32; GROUPS],
}

/// A rectangle of floored pixel coordinates, and a depth: of the points of a group or a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    pub(super) nearest_m: f32,
    /// First and last column.
    columns: [f32; 2],
    /// First and last row.
    rows: [f32; 2],
    points: usize,
}

impl Footprints {
    /// `reach_m`: maximum absolute coordinates of the draw's points.
    pub(super) fn new(draw: &Draw, reach_m: [f32; 3], z_far_m: f32) -> Self {
        let size = |row: &[f32; 4]| (0..3).map(|i| row[i].abs() * reach_m[i]).sum::<f32>() + row[3].abs();
        let error = draw.image_from_local.each_ref().map(|row| ROUNDING * size(row));
        Self { image: draw.image_from_local, z_far_m, error }
    }

    /// Computes the footprints of the groups of a block.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
    pub(super) fn of_block(&self, bounds: &BlockBounds, groups: &mut GroupFootprints) {
        let [x0, y0, z0, x1, y1, z1] = &bounds.0;
        let [u, v, w] = self.image;
        for i in 0..GROUPS {
            let center = [(x0[i] + x1[i]) * 0.5, (y0[i] + y1[i]) * 0.5, (z0[i] + z1[i]) * 0.5];
            let half = [(x1[i] - x0[i]) * 0.5, (y1[i] - y0[i]) * 0.5, (z1[i] - z0[i]) * 0.5];
            let at = |row: &[f32; 4]| row[0] * center[0] + row[1] * center[1] + row[2] * center[2] + row[3];
            let spread = |a: f32, b: f32, c: f32| a.abs() * half[0] + b.abs() * half[1] + c.abs() * half[2];
            let depth_m = at(&w);
            let nearest_m = depth_m - spread(w[0], w[1], w[2]) - self.error[2];
            let farthest_m = depth_m + spread(w[0], w[1], w[2]) + self.error[2];
            // A pixel coordinate minus that of the center is linear in the point, divided by its depth.
            let across = at(&u) / depth_m;
            let reach = spread(u[0] - across * w[0], u[1] - across * w[1], u[2] - across * w[2]);
            let reach =
                (reach + 2.0 * (self.error[0] + across.abs() * self.error[2])) / nearest_m + PIXEL_MARGIN;
            let (left, right) = ((across - reach).floor(), (across + reach).floor());
            let down = at(&v) / depth_m;
            let reach = spread(v[0] - down * w[0], v[1] - down * w[1], v[2] - down * w[2]);
            let reach =
                (reach + 2.0 * (self.error[1] + down.abs() * self.error[2])) / nearest_m + PIXEL_MARGIN;
            let (top, bottom) = ((down - reach).floor(), (down + reach).floor());
            // Written so that a group without points, whose bounds are NaN, is not near.
            let near = nearest_m < MIN_DEPTH_M;
            let outside = (farthest_m < Z_NEAR_M) | (nearest_m > self.z_far_m);
            let everywhere = if near { f32::INFINITY } else { 0.0 };
            groups.nearest_m[i] = if outside { f32::NAN } else { nearest_m };
            groups.left[i] = if near { -everywhere } else { left };
            groups.right[i] = if near { everywhere } else { right };
            groups.top[i] = if near { -everywhere } else { top };
            groups.bottom[i] = if near { everywhere } else { bottom };
        }
    }
}

impl GroupFootprints {
    /// Returns the footprint of a group.
    #[inline(always)]
    pub(super) fn group(&self, group: usize) -> Footprint {
        Footprint {
            nearest_m: self.nearest_m[group],
            columns: [self.left[group], self.right[group]],
            rows: [self.top[group], self.bottom[group]],
            points: GROUP,
        }
    }

    /// Returns the footprint of all groups.
    #[inline(always)]
    pub(super) fn block(&self) -> Footprint {
        // The lower or higher of a number and NaN is the number.
        let lowest = |of: &[f32; GROUPS]| of.iter().copied().fold(f32::NAN, f32::min);
        let highest = |of: &[f32; GROUPS]| of.iter().copied().fold(f32::NAN, f32::max);
        Footprint {
            nearest_m: lowest(&self.nearest_m),
            columns: [lowest(&self.left), highest(&self.right)],
            rows: [lowest(&self.top), highest(&self.bottom)],
            points: GROUPS * GROUP,
        }
    }
}

impl Footprint {
    /// Returns whether no point falls into the window.
    #[inline(always)]
    pub(super) fn misses(&self, window: &Window) -> bool {
        let ([left, top], [width, height]) =
            (window.origin(), [window.stride() as f32, window.height() as f32]);
        let inside = self.columns[1] >= left
            && self.columns[0] < left + width
            && self.rows[1] >= top
            && self.rows[0] < top + height
            && !self.nearest_m.is_nan();
        !inside
    }

    /// Returns whether every cell that a point may fall into already has a nearer point. The footprint must not miss
    /// the window.
    // Loops instead of closures, which would not be compiled for the vectors of the caller.
    #[inline(always)]
    pub(super) fn is_hidden(&self, layer: &Layer, window: &Window) -> bool {
        let [left, top] = window.origin();
        // Saturates at the borders of the window.
        let columns = [self.columns[0] - left, self.columns[1] - left].map(|column| column as u32 as usize);
        let rows = [self.rows[0] - top, self.rows[1] - top].map(|row| row as u32 as usize);
        let (last_column, last_row) = (columns[1].min(window.stride() - 1), rows[1].min(window.height() - 1));
        let width = last_column - columns[0] + 1;
        if width * (last_row - rows[0] + 1) > CELLS_PER_POINT * self.points {
            return false;
        }
        for row in rows[0]..=last_row {
            let first = window.cell(columns[0], row);
            // Without branches, so that it compiles to vector comparisons.
            let mut nearer = true;
            for key in &layer.keys[first..first + width] {
                nearer &= depth_m(*key) < self.nearest_m;
            }
            if !nearer {
                return false;
            }
        }
        true
    }
}
