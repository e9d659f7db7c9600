//! Entries of the shaders' tables, in their layout.

use bytemuck::{Pod, Zeroable};

use super::bands::ResolveTap;
use crate::gpu::{assert_layout, shaders};
use crate::raster::Draw;

/// Entry for a block of [`CHUNK`](crate::raster::chunk::CHUNK) point numbers: the wrapping offsets from a
/// number to its color index and to the point's number + 1, the instance number, and padding.
pub(super) type Block = [u32; 4];

/// An instance in a row strip.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct ProjectDraw {
    image_x: [f32; 4],
    image_y: [f32; 4],
    image_z: [f32; 4],
    crop_x: [f32; 4],
    crop_y: [f32; 4],
    crop_radius_m: f32,
    first_number: u32,
    band: u32,
    layers: u32,
}
assert_layout!(ProjectDraw, shaders::project_wgsl_pixel::project_draw, [
    image_x: IMAGE_X,
    image_y: IMAGE_Y,
    image_z: IMAGE_Z,
    crop_x: CROP_X,
    crop_y: CROP_Y,
    crop_radius_m: CROP_RADIUS_M,
    first_number: FIRST_NUMBER,
    band: BAND,
    layers: LAYERS,
]);

impl ProjectDraw {
    /// Creates the entry. `band`: index in the table of strips; `layers`: bit mask.
    pub(super) fn new(draw: &Draw, band: u32, layers: u32) -> Self {
        let [image_x, image_y, image_z] = draw.image_from_local;
        let [crop_x, crop_y] = draw.crop_from_local;
        let (crop_radius_m, first_number) = (draw.crop_radius_m, draw.first_number);
        Self { image_x, image_y, image_z, crop_x, crop_y, crop_radius_m, first_number, band, layers }
    }
}

/// Location of a strip's keys.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct ProjectBand {
    /// Width, pixels.
    pub(super) columns: f32,
    /// Height, pixels.
    pub(super) rows: f32,
    /// First row in the view.
    pub(super) first_row: f32,
    /// Key row where its padding begins.
    pub(super) key_row: u32,
}
assert_layout!(ProjectBand, shaders::project_wgsl_pixel::project_band, [
    columns: COLUMNS,
    rows: ROWS,
    first_row: FIRST_ROW,
    key_row: KEY_ROW,
]);
assert_layout!(ProjectBand, shaders::spread_wgsl_fold::spread_band, [
    columns: COLUMNS,
    rows: ROWS,
    first_row: FIRST_ROW,
    key_row: KEY_ROW,
]);

/// Range of a chunk's points to draw.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct ProjectItem {
    pub(super) draw: u32,
    /// Row in the page.
    pub(super) row: u32,
    /// First column.
    pub(super) first: u32,
    /// End column.
    pub(super) end: u32,
}
assert_layout!(ProjectItem, shaders::project_wgsl_pixel::project_item, [
    draw: DRAW,
    row: ROW,
    first: FIRST,
    end: END,
]);

/// Location of a strip's keys, taps and results.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct ResolveBand {
    /// Width of the result, pixels.
    pub(super) width: u32,
    /// Rows of the result.
    pub(super) height: u32,
    /// Key row at which the gather for source row 0 begins (full size: for the strip's first row), wrapping.
    pub(super) key_row: u32,
    /// Offset of the strip in the results, pixels.
    pub(super) pixel: u32,
    /// Index of column 0's tap.
    pub(super) columns: u32,
    /// Index of the tap for the strip's first row.
    pub(super) rows: u32,
    /// Number of key column pairs to the left of the pairs that are read.
    pub(super) pair: u32,
    pub(super) pad_1: u32,
}
assert_layout!(ResolveBand, shaders::resolve_full_wgsl_both::resolve_band, [
    width: WIDTH,
    height: HEIGHT,
    key_row: KEY_ROW,
    pixel: PIXEL,
    columns: COLUMNS,
    rows: ROWS,
    pair: PAIR,
    pad_1: PAD_1,
]);
assert_layout!(ResolveTap, shaders::resolve_reduced_wgsl_both::resolve_tap, [
    nearest: NEAREST,
    low: LOW,
    weights: WEIGHTS,
]);
