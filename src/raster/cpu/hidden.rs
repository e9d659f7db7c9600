//! What is already drawn hides points: exact occlusion culling.
//!
//! Points are hidden if something nearer than all of them was drawn wherever they may be seen. There are two
//! tests: whether each cell of their footprint has a nearer point, whose square covers theirs; and whether
//! each pixel that their squares may reach is covered by the square of some nearer point, tile by tile.

use super::footprint::Footprint;
use super::window::{Layer, TILE, Window, depth_m};

impl Layer {
    /// Returns whether every cell of a footprint has a nearer point.
    // Loops instead of closures, which would not be compiled for the vectors of the caller.
    #[inline(always)]
    pub(super) fn hides(&self, footprint: &Footprint, window: &Window) -> bool {
        let ([left, top], [right, bottom]) = (footprint.first, footprint.last);
        for row in top..=bottom {
            let first = window.cell(left as usize, row as usize);
            // Without branches, so that it compiles to vector comparisons.
            let mut nearer = true;
            for key in &self.keys[first..=first + (right - left) as usize] {
                nearer &= depth_m(*key) < footprint.nearest_m;
            }
            if !nearer {
                return false;
            }
        }
        true
    }

    /// Returns whether every pixel that squares of `radius` around the cells of a footprint reach is covered
    /// by a nearer square.
    #[inline(always)]
    pub(super) fn covers(&mut self, footprint: &Footprint, radius: u32, window: &Window) -> bool {
        let size = [window.stride() as u32, window.height() as u32];
        // Cells of the padding are no pixels. A square beyond the border is tested at the border.
        let pixel = |at: u32, axis: usize| at.clamp(window.pad, size[axis] - window.pad - 1) as usize / TILE;
        let first = [0, 1].map(|axis| pixel(footprint.first[axis].saturating_sub(radius), axis));
        let last = [0, 1].map(|axis| pixel(footprint.last[axis] + radius, axis));
        for row in first[1]..=last[1] {
            for column in first[0]..=last[0] {
                let tile = row * self.tiles.stride + column;
                if self.tiles.depth_m[tile] < footprint.nearest_m {
                    continue;
                }
                let depth_m = covered_m(&self.keys, window, [column * TILE, row * TILE]);
                if depth_m > self.tiles.reach_m || depth_m >= footprint.nearest_m {
                    return false;
                }
                self.tiles.depth_m[tile] = depth_m;
            }
        }
        true
    }
}

/// Returns an upper depth bound over all pixels of the tile that begins with a cell, meters, if points have a
/// radius of at least 1: the nearest point of 2x2 cells covers all four. Infinite for a tile across the
/// window's border.
#[inline(always)]
fn covered_m(keys: &[u64], window: &Window, [column, row]: [usize; 2]) -> f32 {
    if column + TILE > window.stride() || row + TILE > window.height() {
        return f32::INFINITY;
    }
    let mut farthest_m = 0.0;
    for above in (row..row + TILE).step_by(2) {
        let [upper, lower] = [above, above + 1].map(|row| &keys[window.cell(column, row)..][..TILE]);
        let mut nearest_m = [0.0; TILE];
        for i in 0..TILE {
            let (a, b) = (depth_m(upper[i]), depth_m(lower[i]));
            nearest_m[i] = if a < b { a } else { b };
        }
        for i in (0..TILE).step_by(2) {
            let (a, b) = (nearest_m[i], nearest_m[i + 1]);
            let nearest_m = if a < b { a } else { b };
            farthest_m = if nearest_m > farthest_m { nearest_m } else { farthest_m };
        }
    }
    farthest_m
}

#[cfg(test)]
mod tests {
    use super::super::window::key;
    use super::*;
    use crate::hash::hash;

    const REACH_M: f32 = 30.0;

    /// Returns a layer where some share of the cells has a point at about `depth_m`.
    fn layer(window: &Window, seed: u64, share: f64, depth_m: f32) -> Layer {
        let mut layer = Layer::default();
        layer.clear(window, REACH_M);
        for cell in window.cell(0, 0)..layer.keys.len() {
            let random = |what: i64| (hash(seed, &[cell as i64, what]) >> 40) as f64 / (1 << 24) as f64;
            if random(0) < share {
                layer.keys[cell] = key(depth_m + random(1) as f32, cell as u32);
            }
        }
        layer
    }

    /// Returns the cells at most `grow` cells from a rectangle and at least `border` cells within the window.
    fn cells(window: &Window, first: [u32; 2], last: [u32; 2], grow: u32, border: u32) -> Vec<[u32; 2]> {
        let size = [window.stride() as u32, window.height() as u32];
        let low = [0, 1].map(|axis| first[axis].saturating_sub(grow).max(border));
        let high = [0, 1].map(|axis| (last[axis] + grow + 1).min(size[axis] - border));
        (low[1]..high[1]).flat_map(|y| (low[0]..high[0]).map(move |x| [x, y])).collect()
    }

    /// What is said to be hidden is, pixel by pixel, and dense surfaces do hide.
    #[test]
    fn hidden_points_show_in_no_pixel() {
        let window = Window { width: 60, rows: [10, 51], pad: 3 };
        let size = [window.stride() as u32, window.height() as u32];
        let mut counts = [[0; 2]; 2];
        for case in 0..4000_usize {
            let random = |what: i64, below: u32| hash(7, &[case as i64, what]) as u32 % below;
            let (share, depth_m) = ([0.3, 0.7, 0.95, 1.0][case % 4], [5.0, 29.5][case / 4 % 2]);
            let mut layer = layer(&window, case as u64, share, depth_m);
            let first = [random(0, size[0]), random(1, size[1])];
            let last = [0, 1].map(|axis| (first[axis] + random(2 + axis as i64, 12)).min(size[axis] - 1));
            let nearest_m = depth_m + [0.5, 1.0, 1.5][random(4, 3) as usize];
            let (footprint, radius) = (Footprint { nearest_m, first, last }, random(5, 4));
            let drawn_m = |[x, y]: [u32; 2]| super::depth_m(layer.keys[window.cell(x as usize, y as usize)]);
            let nearer = cells(&window, first, last, 0, 0).into_iter().all(|cell| drawn_m(cell) < nearest_m);
            assert_eq!(layer.hides(&footprint, &window), nearer, "case {case}");
            let covered = cells(&window, first, last, radius, window.pad).into_iter().all(|pixel| {
                let around = cells(&window, pixel, pixel, 1, 0).into_iter();
                let depth_m = around.map(drawn_m).fold(f32::INFINITY, f32::min);
                depth_m < nearest_m && depth_m <= REACH_M
            });
            // Asked twice: the second answer comes from what the first one left.
            for _ in 0..2 {
                let covers = layer.covers(&footprint, radius, &window);
                assert!(covered || !covers, "case {case}");
                counts[usize::from(depth_m > 20.0)][usize::from(covers)] += 1;
            }
        }
        assert!(counts.iter().flatten().all(|count| *count > 50), "{counts:?}");
    }
}
