//! Visibility buffers to visible points: each pixel gets the nearest of the points whose squares cover it.
//!
//! A buffer contains the nearest point per pixel, whatever its radius. Radii never increase with depth, so
//! the points of at least radius `r` are those up to a depth. The winner of a pixel is the nearest of, for
//! each radius, the nearest point of the square window of that radius, if it lies within that depth. Windows
//! are computed row by row: first along rows, for all radii, then across rows. Depths are compared as 32-bit
//! numbers, and the numbers of points decide ties.

use pulp::{Simd, WithSimd};

use super::window::{Layer, Window, depth_m};
use crate::raster::SplatSchedule;

/// Depths (infinite where empty) and numbers of the nearest points of a row.
#[derive(Clone, Default)]
struct Row {
    depth_m: Vec<f32>,
    number: Vec<u32>,
}

/// Points of at least a radius.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reach {
    radius: usize,
    /// Depth up to which points have at least that radius, meters.
    depth_m: f32,
}

/// Window rows over one buffer row.
#[derive(Clone, Default)]
struct Fold {
    /// Per radius, largest first: nearest points of windows along the row of this or a larger radius.
    rows: Vec<Row>,
    /// Row of the buffer.
    source: Option<usize>,
    is_empty: bool,
}

/// The visible points of a row.
#[derive(Default)]
pub(super) struct VisibleRow {
    /// Infinite where no point is visible.
    nearest: Row,
    /// All bits are set where a point is visible. In memory, so that lookups need no branch: whether a pixel
    /// is empty is hard to predict.
    mask: Vec<u32>,
}

/// Walks down a visibility buffer.
#[derive(Default)]
pub(super) struct Dilation {
    /// Distinct radii, largest first.
    reaches: Vec<Reach>,
    /// The last folded rows, by row modulo their number.
    folds: Vec<Fold>,
    /// The last results, by row modulo their number, and their rows.
    results: [(Option<usize>, VisibleRow); RESULTS],
    scratch: [Row; 2],
}

/// Rows whose results can be used at the same time.
const RESULTS: usize = 4;

/// [`Dilation::compute`] in the widest vectors of the processor.
struct Compute<'c> {
    dilation: &'c mut Dilation,
    layer: &'c Layer,
    window: &'c Window,
    row: usize,
}

impl WithSimd for Compute<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.dilation.compute(self.layer, self.window, self.row);
    }
}

impl Dilation {
    /// Begins with the first row of a window.
    pub(super) fn start(&mut self, schedule: &SplatSchedule) {
        self.reaches.clear();
        for step in schedule.steps() {
            let radius = step.radius as usize;
            match self.reaches.last_mut() {
                Some(last) if last.radius == radius => last.depth_m = step.z_max_m,
                _ => self.reaches.push(Reach { radius, depth_m: step.z_max_m }),
            }
        }
        let rows = 2 * self.reaches[0].radius + 1 + RESULTS;
        self.folds.resize(rows, Fold::default());
        self.folds.iter_mut().for_each(|fold| fold.source = None);
        self.results.iter_mut().for_each(|(row, _)| *row = None);
    }

    /// Returns the visible points of the window's row `row`, without padding. Rows are computed
    /// once if they are asked for in increasing order, up to three back.
    pub(super) fn row(&mut self, layer: &Layer, window: &Window, row: usize) -> &VisibleRow {
        let place = row % RESULTS;
        if self.results[place].0 != Some(row) {
            pulp::Arch::new().dispatch(Compute { dilation: self, layer, window, row });
            self.results[place].0 = Some(row);
        }
        &self.results[place].1
    }

    #[inline(always)]
    fn compute(&mut self, layer: &Layer, window: &Window, row: usize) {
        let pad = window.pad as usize;
        let center = row + pad;
        let radius = self.reaches[0].radius;
        let width = window.width as usize;
        let VisibleRow { nearest, mask } = &mut self.results[row % RESULTS].1;
        nearest.clear(width);
        for source in center - radius..=center + radius {
            let at = source % self.folds.len();
            let fold = &mut self.folds[at];
            if fold.source != Some(source) {
                fold.fold(layer.row(window, source), pad, &self.reaches, &mut self.scratch);
                fold.source = Some(source);
            }
            if fold.is_empty {
                continue;
            }
            let distance = source.abs_diff(center);
            let level = self.reaches.iter().rposition(|reach| reach.radius >= distance);
            if let Some(level) = level {
                lower(nearest, &fold.rows[level], 0, f32::INFINITY);
            }
        }
        mask.clear();
        mask.extend(nearest.depth_m.iter().map(|depth| if *depth < f32::INFINITY { u32::MAX } else { 0 }));
        nearest.number.iter_mut().zip(mask).for_each(|(number, mask)| *number &= *mask);
    }
}

impl Fold {
    /// Computes the windows along a row of cells with `pad` cells of padding on both sides.
    #[inline(always)]
    fn fold(&mut self, keys: &[u64], pad: usize, reaches: &[Reach], scratch: &mut [Row; 2]) {
        // The window of radius 0 is the row; larger ones grow from smaller ones. Place `i` of a window row of
        // radius `r` is the cell `i + r`.
        let [window, wider] = scratch;
        window.depth_m.clear();
        window.depth_m.extend(keys.iter().map(|key| depth_m(*key)));
        self.is_empty = !window.depth_m.iter().fold(false, |any, depth| any | (*depth < f32::INFINITY));
        self.rows.resize(reaches.len(), Row::default());
        if self.is_empty {
            return;
        }
        window.number.clear();
        window.number.extend(keys.iter().map(|key| *key as u32));
        let width = keys.len() - 2 * pad;
        let mut radius = 0;
        for (reach, row) in reaches.iter().zip(&mut self.rows).rev() {
            while radius < reach.radius {
                let step = (reach.radius - radius).min(radius.max(1));
                widen(window, step, radius == 0, wider);
                std::mem::swap(window, wider);
                radius += step;
            }
            row.clear(width);
            lower(row, window, pad - radius, reach.depth_m);
        }
        for level in 1..reaches.len() {
            let (larger, smaller) = self.rows.split_at_mut(level);
            lower(&mut smaller[0], &larger[level - 1], 0, f32::INFINITY);
        }
    }
}

impl VisibleRow {
    /// Depths, meters; infinite where no point is visible.
    pub(super) fn depth_m(&self) -> &[f32] {
        &self.nearest.depth_m
    }

    /// Returns the number of the point in a column, 0 if there is none, and whether there is one: all bits or
    /// none.
    #[inline(always)]
    pub(super) fn number(&self, column: usize) -> (u32, u32) {
        (self.nearest.number[column], self.mask[column])
    }
}

impl Row {
    fn clear(&mut self, width: usize) {
        self.depth_m.clear();
        self.depth_m.resize(width, f32::INFINITY);
        self.number.resize(width, 0);
    }
}

/// Widens windows by `step` on both sides; `gap`: whether the old windows that far apart leave one out
/// between them.
#[inline(always)]
fn widen(window: &Row, step: usize, gap: bool, wider: &mut Row) {
    let count = window.depth_m.len() - 2 * step;
    wider.depth_m.clear();
    wider.depth_m.extend_from_slice(&window.depth_m[..count]);
    wider.number.clear();
    wider.number.extend_from_slice(&window.number[..count]);
    if gap {
        lower(wider, window, step, f32::INFINITY);
    }
    lower(wider, window, 2 * step, f32::INFINITY);
}

/// Replaces points in `nearest` by points of `other`, `shift` places further, that are nearer and within
/// `reach_m`.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
fn lower(nearest: &mut Row, other: &Row, shift: usize, reach_m: f32) {
    let count = nearest.depth_m.len();
    let (depths, numbers) = (&mut nearest.depth_m[..count], &mut nearest.number[..count]);
    let (other_depths, other_numbers) =
        (&other.depth_m[shift..shift + count], &other.number[shift..shift + count]);
    for i in 0..count {
        let (a, b) = (depths[i], other_depths[i]);
        let b = if b <= reach_m { b } else { f32::INFINITY };
        let tied = numbers[i].min(other_numbers[i]);
        let number = if b < a { other_numbers[i] } else { numbers[i] };
        numbers[i] = if a == b { tied } else { number };
        depths[i] = if b < a { b } else { a };
    }
}
