//! Visible points to maps: lookups, and the reduction to the size of the maps.

use std::ops::Range;

use super::dilate::{Dilation, VisibleRow};
use super::numbering::Numbering;
use super::strips::{Sampling, Strip};
use super::window::{Layer, Window};
use crate::raster::layers::Layers;
use crate::raster::maps::reduce::Tap;
use crate::raster::{FrameJob, MapKind, MapSet, rgb_of};

/// Pixels of a row whose colors are loaded before they are used.
const COLORS_AHEAD: usize = 32;

/// Rows of a view's maps; a map that is not wanted has length 0.
pub(super) struct MapRows<'m> {
    pub(super) rgb_class: &'m mut [u32],
    pub(super) depth_m: &'m mut [f32],
    pub(super) instance: &'m mut [u32],
    pub(super) point: &'m mut [u32],
}

impl<'m> MapRows<'m> {
    /// Removes and returns the first pixels of all maps.
    pub(super) fn take_first(&mut self, pixels: usize) -> Self {
        fn first<'m, T>(map: &mut &'m mut [T], pixels: usize) -> &'m mut [T] {
            let whole = std::mem::take(map);
            let (first, rest) = whole.split_at_mut(pixels.min(whole.len()));
            *map = rest;
            first
        }
        MapRows {
            rgb_class: first(&mut self.rgb_class, pixels),
            depth_m: first(&mut self.depth_m, pixels),
            instance: first(&mut self.instance, pixels),
            point: first(&mut self.point, pixels),
        }
    }

    /// Returns row `row`, counted from the first, in maps of this width.
    fn row(&mut self, row: usize, width: usize) -> MapRows<'_> {
        fn part<T>(map: &mut [T], row: usize, width: usize) -> &mut [T] {
            if map.is_empty() { map } else { &mut map[row * width..][..width] }
        }
        MapRows {
            rgb_class: part(self.rgb_class, row, width),
            depth_m: part(self.depth_m, row, width),
            instance: part(self.instance, row, width),
            point: part(self.point, row, width),
        }
    }
}

/// Maps that a layer contributes to.
fn maps_of(job: &FrameJob<'_>, layers: &Layers, layer: usize) -> MapSet {
    let semantics = layers.actors.or(layers.geometry);
    let of = |at: Option<usize>, maps: MapSet| if at == Some(layer) { job.maps & maps } else { MapSet::NONE };
    of(layers.color, MapSet::COLOR) | of(layers.geometry, MapSet::GEOMETRY) | of(semantics, MapSet::ACTORS)
}

/// A strip's view, and what its numbers refer to.
pub(super) struct Resolve<'r> {
    pub(super) job: &'r FrameJob<'r>,
    pub(super) layers: &'r Layers,
    /// Window rows, padding included, where the layers of color and geometry may differ.
    pub(super) forked: Range<u32>,
    pub(super) strip: &'r Strip,
    pub(super) sampling: &'r Sampling,
    pub(super) numbering: &'r Numbering<'r>,
}

impl Resolve<'_> {
    /// Fills the strip's rows of the maps from its layers.
    pub(super) fn fill(&self, buffers: &[Layer], dilations: &mut [Dilation], maps: &mut MapRows<'_>) {
        let width = self.sampling.to.width as usize;
        if self.numbering.is_empty() {
            maps.rgb_class.fill(0);
            maps.depth_m.fill(f32::INFINITY);
            maps.instance.fill(0);
            maps.point.fill(0);
            return;
        }
        dilations.iter_mut().for_each(|dilation| dilation.start(self.job.schedule));
        let mut across = [vec![[0; 3]; width], vec![[0; 3]; width]];
        for (at, row) in (self.strip.rows[0] as usize..self.strip.rows[1] as usize).enumerate() {
            let mut maps = maps.row(at, width);
            maps.rgb_class.fill(0);
            let layers = if self.is_forked(row) { *self.layers } else { self.layers.shared() };
            for layer in 0..layers.count {
                let wanted = maps_of(self.job, &layers, layer);
                self.fill_row(&buffers[layer], &mut dilations[layer], (row, wanted), &mut maps, &mut across);
            }
        }
    }

    /// Returns whether the color in a row of the maps may differ between the layers of color and geometry.
    fn is_forked(&self, row: usize) -> bool {
        let nearest = self.sampling.nearest[0][row] as usize;
        let [first, last] = self.sampling.taps.as_ref().map_or([nearest; 2], |[rows, _]| rows[row].at);
        let Window { rows: [top, _], pad, .. } = self.strip.window;
        // Rows of cells whose squares may reach the pixels; they are counted from `pad` rows above the
        // window.
        let (first, end) = (first as u32 - top, last as u32 - top + 2 * pad + 1);
        first < self.forked.end && end > self.forked.start
    }

    fn fill_row(
        &self,
        buffer: &Layer,
        dilation: &mut Dilation,
        (row, wanted): (usize, MapSet),
        maps: &mut MapRows<'_>,
        across: &mut [Vec<[i32; 3]>; 2],
    ) {
        let window = &self.strip.window;
        let top = window.rows[0] as usize;
        let at_once = if self.sampling.taps.is_some() { wanted.without(MapKind::Color) } else { wanted };
        if at_once != MapSet::NONE {
            let visible = dilation.row(buffer, window, self.sampling.nearest[0][row] as usize - top);
            self.look_up(visible, at_once, maps);
        }
        let Some([rows, columns]) = self.sampling.taps.as_ref().filter(|_| wanted.contains(MapKind::Color))
        else {
            return;
        };
        let tap = rows[row];
        for (side, colors) in across.iter_mut().enumerate() {
            self.across(dilation.row(buffer, window, tap.at[side] - top), columns, colors);
        }
        for (rgb, (upper, lower)) in maps.rgb_class.iter_mut().zip(across[0].iter().zip(&across[1])) {
            let channel = |i: usize| {
                let [upper, lower] =
                    [(upper, 0), (lower, 1)].map(|(row, side)| (tap.weight[side] * row[i]) >> 16);
                ((upper + lower + 2) >> 2) as u8
            };
            *rgb |= u32::from_le_bytes([channel(0), channel(1), channel(2), 0]);
        }
    }

    /// Fills rows of maps with one point per pixel.
    fn look_up(&self, visible: &VisibleRow, wanted: MapSet, maps: &mut MapRows<'_>) {
        let bits = |kind, bits: u32| if wanted.contains(kind) { bits } else { 0 };
        let rgb_class = bits(MapKind::Color, 0x00ff_ffff) | bits(MapKind::Class, 0xff00_0000);
        let columns = &self.sampling.nearest[1];
        // Empty pixels look up point 0 and mask it.
        let at = |column: u32| visible.number(column as usize);
        if rgb_class != 0 {
            for (i, (packed, column)) in maps.rgb_class.iter_mut().zip(columns).enumerate() {
                if let Some(later) = columns.get(i + COLORS_AHEAD) {
                    self.prefetch(visible, *later as usize);
                }
                let (number, mask) = at(*column);
                *packed |= self.numbering.rgb_class(number) & mask & rgb_class;
            }
        }
        if wanted.contains(MapKind::Depth) {
            let depths = columns.iter().map(|column| visible.depth_m()[*column as usize]);
            maps.depth_m.iter_mut().zip(depths).for_each(|(to, depth_m)| *to = depth_m);
        }
        if wanted.contains(MapKind::Instance) {
            for (instance, (number, mask)) in maps.instance.iter_mut().zip(columns.iter().map(|c| at(*c))) {
                *instance = self.numbering.instance(number) & mask;
            }
        }
        if wanted.contains(MapKind::Point) {
            for (point, (number, mask)) in maps.point.iter_mut().zip(columns.iter().map(|c| at(*c))) {
                *point = self.numbering.point(number) & mask;
            }
        }
    }

    /// Loads the color of a pixel into the cache.
    #[inline(always)]
    fn prefetch(&self, visible: &VisibleRow, column: usize) {
        self.numbering.prefetch_rgb_class(visible.number(column).0);
    }

    /// Interpolates the colors of a row between columns, as the first pass of OpenCV's fixed-point
    /// arithmetic.
    fn across(&self, visible: &VisibleRow, columns: &[Tap], colors: &mut [[i32; 3]]) {
        let rgb = |column: usize| {
            let (number, mask) = visible.number(column);
            rgb_of(self.numbering.rgb_class(number) & mask).map(i32::from)
        };
        for (i, (color, tap)) in colors.iter_mut().zip(columns).enumerate() {
            if let Some(later) = columns.get(i + COLORS_AHEAD) {
                later.at.iter().for_each(|column| self.prefetch(visible, *column));
            }
            let [left, right] = tap.at.map(rgb);
            *color = [0, 1, 2].map(|i| (left[i] * tap.weight[0] + right[i] * tap.weight[1]) >> 4);
        }
    }
}
