//! Footprints of groups of points, and which of them are hidden.
//!
//! A footprint is a rectangle of cells and a depth: every point of the group falls into the rectangle, or outside the
//! window, and is not nearer. It is hidden if every cell of the rectangle already has a nearer point: then none of its
//! points would be drawn. Bounds are widened by more than the rounding errors of the projection.

use super::dilate::Dilation;
use super::packed::{BlockBounds, GROUP, GROUPS};
use super::window::{Layer, Window};
use crate::raster::schedule::Z_NEAR_M;
use crate::raster::{Draw, SplatSchedule};

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

/// Depth of the nearest point that covers each pixel of a window, without padding, at some time.
#[derive(Default)]
pub(super) struct Covered {
    depth_m: Vec<f32>,
    is_known: bool,
}

impl Covered {
    /// Forgets all depths.
    pub(super) fn clear(&mut self) {
        self.is_known = false;
    }

    /// Computes the depths from what is drawn so far.
    pub(super) fn update(&mut self, layer: &Layer, window: &Window, dilation: &mut Dilation) {
        self.depth_m.clear();
        for row in 0..(window.rows[1] - window.rows[0]) as usize {
            self.depth_m.extend_from_slice(&dilation.row(layer, window, row).depth_m);
        }
        self.is_known = true;
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
    #[inline(always)]
    pub(super) fn is_hidden(&self, layer: &Layer, window: &Window) -> bool {
        let [left, top] = window.origin();
        let columns = self.columns.map(|column| column - left);
        let rows = self.rows.map(|row| row - top);
        Rect::new(columns, rows, [window.stride(), window.height()]).all(self.points, |row, columns| {
            let first = window.cell(columns.start, row);
            all_nearer(&layer.depth_m[first..first + columns.len()], self.nearest_m)
        })
    }

    /// Returns whether every pixel that a square may cover is covered by a nearer point. `schedule`: radii of points.
    #[inline(always)]
    pub(super) fn is_covered(&self, covered: &Covered, window: &Window, schedule: &SplatSchedule) -> bool {
        let Some(radius) = schedule.radius_at(self.nearest_m).filter(|_| covered.is_known) else {
            return false;
        };
        let radius = radius as f32;
        let columns = [self.columns[0] - radius, self.columns[1] + radius];
        let first_row = window.rows[0] as f32;
        let rows = [self.rows[0] - radius - first_row, self.rows[1] + radius - first_row];
        let size = [window.width as usize, (window.rows[1] - window.rows[0]) as usize];
        Rect::new(columns, rows, size).all(self.points, |row, columns| {
            let first = row * window.width as usize;
            all_nearer(&covered.depth_m[first + columns.start..first + columns.end], self.nearest_m)
        })
    }
}

/// Columns and rows of a grid: first and last.
struct Rect {
    columns: [usize; 2],
    rows: [usize; 2],
}

impl Rect {
    /// Returns the part of a rectangle that lies in a grid of `size` columns and rows; the nearest border if none does.
    #[inline(always)]
    fn new(columns: [f32; 2], rows: [f32; 2], size: [usize; 2]) -> Self {
        let clamp = |at: f32, count: usize| at.clamp(0.0, (count - 1) as f32) as u32 as usize;
        Self { columns: columns.map(|at| clamp(at, size[0])), rows: rows.map(|at| clamp(at, size[1])) }
    }

    /// Returns whether a condition holds for the columns of every row; `false` if there are too many cells for `points`.
    #[inline(always)]
    fn all(&self, points: usize, condition: impl Fn(usize, std::ops::Range<usize>) -> bool) -> bool {
        let ([left, right], [top, bottom]) = (self.columns, self.rows);
        if (right - left + 1) * (bottom - top + 1) > CELLS_PER_POINT * points {
            return false;
        }
        for row in top..=bottom {
            if !condition(row, left..right + 1) {
                return false;
            }
        }
        true
    }
}

/// Returns whether all depths are less than another; without branches, so that it compiles to vector comparisons.
#[inline(always)]
fn all_nearer(depths_m: &[f32], depth_m: f32) -> bool {
    depths_m.iter().fold(true, |nearer, other| nearer & (*other < depth_m))
}
