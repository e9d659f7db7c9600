//! Resizing of maps, each compatible with another library.
//!
//! [`nearest`] is OpenCV's INTER_NEAREST, [`bilinear`] its INTER_LINEAR for bytes, [`pil_bilinear`] Pillow's
//! BILINEAR. [`valid_area`] is specific to this project: a mean over the pixels that are not empty.

pub(super) mod hidden;
pub(super) mod pil;

use rayon::prelude::*;

use crate::geometry::ImageSize;
pub use crate::raster::reduce::{bilinear, nearest, nearest_indices};
pub use pil::pil_bilinear;

/// Source pixels covered by each output pixel along one axis, with the covered length.
fn spans(from: u32, to: u32) -> Vec<Vec<(usize, f64)>> {
    let scale = f64::from(from) / f64::from(to);
    let span = |i: u32| {
        let (start, end) = (f64::from(i) * scale, f64::from(i + 1) * scale);
        let covered = |s: u32| (f64::from(s + 1).min(end) - f64::from(s).max(start)).max(0.0);
        let pixels = start as u32..(end.ceil() as u32).min(from);
        pixels.map(|s| (s as usize, covered(s))).filter(|(_, length)| *length > 0.0).collect()
    };
    (0..to).map(span).collect()
}

/// Returns the area-weighted mean of the pixels with finite `depth_m` (not empty) under each output pixel;
/// black if all are empty.
pub fn valid_area(map: &[[u8; 3]], depth_m: &[f32], from: ImageSize, to: ImageSize) -> Vec<[u8; 3]> {
    let (rows, columns) = (spans(from.height, to.height), spans(from.width, to.width));
    let width = from.width as usize;
    let pixel = |vertical: &[(usize, f64)], horizontal: &[(usize, f64)]| {
        let (mut sum, mut area) = ([0.0; 3], 0.0);
        for &(row, height) in vertical {
            for &(column, length) in horizontal {
                let at = row * width + column;
                if depth_m[at].is_finite() {
                    area += height * length;
                    (0..3).for_each(|c| sum[c] += height * length * f64::from(map[at][c]));
                }
            }
        }
        if area > 0.0 { sum.map(|s| (s / area).round() as u8) } else { [0; 3] }
    };
    let pixel = &pixel;
    rows.par_iter().flat_map_iter(|row| columns.iter().map(move |column| pixel(row, column))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(height: u32, width: u32) -> ImageSize {
        ImageSize { height, width }
    }

    #[test]
    fn valid_area_skips_empty_pixels() {
        let map = [[10, 0, 0], [0, 0, 0], [30, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]];
        let empty = f32::INFINITY;
        let depth = [1.0, empty, 1.0, empty, empty, empty];
        assert_eq!(valid_area(&map, &depth, size(1, 6), size(1, 2)), [[20, 0, 0], [0, 0, 0]]);
        // 6 to 4: one and a half pixels each; half of the third pixel lies under the second output pixel.
        assert_eq!(
            valid_area(&map, &depth, size(1, 6), size(1, 4)),
            [[10, 0, 0], [30, 0, 0], [0, 0, 0], [0, 0, 0]]
        );
        let black = [[0; 3], [200; 3]];
        assert_eq!(valid_area(&black, &[1.0, 1.0], size(1, 2), size(1, 1)), [[100; 3]]);
    }

    #[test]
    fn same_size_changes_nothing() {
        let map: Vec<[u8; 3]> = (0..35).map(|i: u8| [i, 7 * i, 255 - i]).collect();
        let s = size(5, 7);
        assert!((1..2000).all(|side| nearest_indices(side, side).into_iter().eq(0..side)));
        assert_eq!(nearest(&map, s, s), map);
        assert_eq!(bilinear(&map, s, s), map);
        assert_eq!(valid_area(&map, &[1.0; 35], s, s), map);
        assert_eq!(pil_bilinear(&map, s, s), map);
    }
}
