//! Downscaling of splatted maps with OpenCV's arithmetic: [`nearest`] is INTER_NEAREST, [`bilinear`] is
//! INTER_LINEAR for bytes.

use rayon::prelude::*;

use crate::geometry::ImageSize;

/// Returns the source index of each output index, as OpenCV's INTER_NEAREST: `floor(i · (1 / (out / in)))`,
/// in `f64` and in exactly this order of operations.
pub fn nearest_indices(from: u32, to: u32) -> Vec<u32> {
    let step = 1.0 / (f64::from(to) / f64::from(from));
    (0..to).map(|i| ((f64::from(i) * step).floor() as u32).min(from - 1)).collect()
}

/// Samples one source pixel per output pixel. `map` has `from.pixels()` values, row by row.
pub fn nearest<T: Copy + Send + Sync>(map: &[T], from: ImageSize, to: ImageSize) -> Vec<T> {
    if from == to {
        return map.to_vec();
    }
    let columns = nearest_indices(from.width, to.width);
    let rows = nearest_indices(from.height, to.height);
    let pixel = |row: u32, column: u32| map[row as usize * from.width as usize + column as usize];
    rows.iter().flat_map(|&row| columns.iter().map(move |&column| pixel(row, column))).collect()
}

/// Two source indices of a bilinear filter and their weights in 1/2048.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Tap {
    pub(in super::super) at: [usize; 2],
    pub(in super::super) weight: [i32; 2],
}

/// Returns the taps per output index: half-pixel centers, no antialiasing; the fraction is `f32` as in
/// OpenCV.
pub(in super::super) fn taps(from: u32, to: u32) -> Vec<Tap> {
    let scale = f64::from(from) / f64::from(to);
    let last = from as usize - 1;
    let tap = |i: u32| {
        let center = ((f64::from(i) + 0.5) * scale - 0.5) as f32;
        let low = center.floor();
        let fraction = if low < 0.0 || low as usize >= last { 0.0 } else { center - low };
        let at = (low.max(0.0) as usize).min(last);
        let weight = |part: f32| (part * 2048.0).round_ties_even() as i32;
        Tap { at: [at, (at + 1).min(last)], weight: [weight(1.0 - fraction), weight(fraction)] }
    };
    (0..to).map(tap).collect()
}

/// Downscales 8-bit RGB with OpenCV's INTER_LINEAR in its fixed-point arithmetic: 11-bit weights in each
/// direction, and the four bits that its vector code drops between the two passes.
pub fn bilinear(map: &[[u8; 3]], from: ImageSize, to: ImageSize) -> Vec<[u8; 3]> {
    let columns = taps(from.width, to.width);
    let rows = taps(from.height, to.height);
    let width = from.width as usize;
    let row = |vertical: &Tap| {
        let [top, bottom] = vertical.at.map(|row| &map[row * width..][..width]);
        let pixel = |horizontal: &Tap| {
            let [left, right] = horizontal.at;
            let across = |row: &[[u8; 3]], channel: usize| {
                let part = |at: usize, side: usize| i32::from(row[at][channel]) * horizontal.weight[side];
                (part(left, 0) + part(right, 1)) >> 4
            };
            std::array::from_fn(|channel| {
                let upper = (vertical.weight[0] * across(top, channel)) >> 16;
                let lower = (vertical.weight[1] * across(bottom, channel)) >> 16;
                ((upper + lower + 2) >> 2) as u8
            })
        };
        columns.iter().map(pixel).collect::<Vec<_>>()
    };
    rows.par_iter().flat_map_iter(row).collect()
}
