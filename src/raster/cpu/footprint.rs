//! Footprints: where points may fall in a window, computed from bounds of them.
//!
//! A footprint is a rectangle of cells and a depth: every point falls into the rectangle, or outside the
//! window, and is not nearer. Bounds are widened by more than the rounding errors of the projection.

use super::packed::{BoundsLanes, LANES};
use super::window::Window;
use crate::raster::Draw;
use crate::raster::schedule::Z_NEAR_M;

/// Relative rounding error of a projected coordinate, with a margin: four products, three sums, 2⁻²⁴ each.
const ROUNDING: f32 = 2e-6;
/// Absolute margin of pixel coordinates.
const PIXEL_MARGIN: f32 = 2e-3;
/// Depth below which a footprint is not computed, meters.
const MIN_DEPTH_M: f32 = 0.05;

/// Projection of bounds for one draw and window.
pub(super) struct Footprints {
    image: [[f32; 4]; 3],
    z_far_m: f32,
    /// Rounding errors of the three rows of the projection.
    error: [f32; 3],
    /// Column and row of the window's first cell.
    origin: [f32; 2],
    /// Last column and row, counted from the first.
    last: [f32; 2],
}

/// Footprints of several sets of points.
#[derive(Default)]
pub(super) struct FootprintLanes {
    /// Lower bound of depths, meters.
    nearest_m: [f32; LANES],
    /// First and last column and row in the window.
    left: [f32; LANES],
    right: [f32; LANES],
    top: [f32; LANES],
    bottom: [f32; LANES],
    /// Number of cells, 0 if no point falls into the window.
    cells: [f32; LANES],
}

/// Where points may fall.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// Lower bound of depths, meters.
    pub(super) nearest_m: f32,
    /// First column and row of the rectangle, relative to the window's.
    pub(super) first: [u32; 2],
    /// Last column and row.
    pub(super) last: [u32; 2],
}

impl Footprints {
    /// `reach_m`: maximum absolute coordinates of the draw's points.
    pub(super) fn new(draw: &Draw, window: &Window, reach_m: [f32; 3], z_far_m: f32) -> Self {
        let size = |row: &[f32; 4]| (0..3).map(|i| row[i].abs() * reach_m[i]).sum::<f32>() + row[3].abs();
        let error = draw.image_from_local.each_ref().map(|row| ROUNDING * size(row));
        let last = [window.stride() as f32 - 1.0, window.height() as f32 - 1.0];
        Self { image: draw.image_from_local, z_far_m, error, origin: window.origin(), last }
    }

    /// Computes the footprints of point sets with some bounds.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
    pub(super) fn of(&self, bounds: &BoundsLanes) -> FootprintLanes {
        let [x0, y0, z0, x1, y1, z1] = &bounds.0;
        let [u, v, w] = self.image;
        let mut lanes = FootprintLanes::default();
        for i in 0..LANES {
            let center = [(x0[i] + x1[i]) * 0.5, (y0[i] + y1[i]) * 0.5, (z0[i] + z1[i]) * 0.5];
            let half = [(x1[i] - x0[i]) * 0.5, (y1[i] - y0[i]) * 0.5, (z1[i] - z0[i]) * 0.5];
            let at = |row: &[f32; 4]| row[0] * center[0] + row[1] * center[1] + row[2] * center[2] + row[3];
            let spread = |a: f32, b: f32, c: f32| a.abs() * half[0] + b.abs() * half[1] + c.abs() * half[2];
            let depth_m = at(&w);
            let nearest_m = depth_m - spread(w[0], w[1], w[2]) - self.error[2];
            let farthest_m = depth_m + spread(w[0], w[1], w[2]) + self.error[2];
            // A pixel coordinate relative to the center is linear in the point, divided by its depth.
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
            // Of something near, nothing is known but its depth. Of nothing, whose bounds are NaN, not even
            // that.
            let near = nearest_m < MIN_DEPTH_M;
            let drawn = (farthest_m >= Z_NEAR_M) & (nearest_m <= self.z_far_m);
            let [left, top] = [left - self.origin[0], top - self.origin[1]];
            let [right, bottom] = [right - self.origin[0], bottom - self.origin[1]];
            let left = if near | (left < 0.0) { 0.0 } else { left };
            let top = if near | (top < 0.0) { 0.0 } else { top };
            let right = if near | (right > self.last[0]) { self.last[0] } else { right };
            let bottom = if near | (bottom > self.last[1]) { self.last[1] } else { bottom };
            let cells = (right - left + 1.0) * (bottom - top + 1.0);
            // Written so that NaN is not drawn.
            let drawn = drawn & (left <= right) & (top <= bottom);
            lanes.nearest_m[i] = nearest_m;
            (lanes.left[i], lanes.right[i]) = (left, right);
            (lanes.top[i], lanes.bottom[i]) = (top, bottom);
            lanes.cells[i] = if drawn { cells } else { 0.0 };
        }
        lanes
    }
}

impl FootprintLanes {
    /// Returns the point sets that may reach into the window: a bit mask.
    #[inline(always)]
    pub(super) fn drawn(&self) -> u64 {
        (0..LANES).fold(0, |mask, i| mask | u64::from(self.cells[i] > 0.0) << i)
    }

    /// Returns those with at most so many cells.
    #[inline(always)]
    pub(super) fn within(&self, most: usize) -> u64 {
        (0..LANES).fold(0, |mask, i| mask | u64::from(self.cells[i] <= most as f32) << i)
    }

    /// Returns the footprint of a drawn point set.
    #[inline(always)]
    pub(super) fn lane(&self, i: usize) -> Footprint {
        Footprint {
            nearest_m: self.nearest_m[i],
            first: [self.left[i] as u32, self.top[i] as u32],
            last: [self.right[i] as u32, self.bottom[i] as u32],
        }
    }
}

impl Footprint {
    /// Returns the number of cells.
    #[inline(always)]
    pub(super) fn cells(&self) -> usize {
        let side = |axis: usize| (self.last[axis] - self.first[axis] + 1) as usize;
        side(0) * side(1)
    }
}
