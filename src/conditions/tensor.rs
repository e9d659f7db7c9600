//! Network input: 20 channels of point conditions and 6 channels of layout.
//!
//! # How it works
//! The depth channels depend only on the depth bin, so every possible value is computed once and looked up
//! per pixel. The arithmetic is `f32` in the order of the condition contract (`docs/src/reference/maps.md`):
//! near the highest frequency, another order differs by more than 10⁻⁵.

use rayon::prelude::*;

use super::DepthBins;
use crate::{named, named_in_files};

/// Channel count of the point conditions: color, depth, sines, cosines.
pub const POINT_CHANNELS: usize = 3 + 1 + 2 * FREQUENCIES;
/// Channel count of the layout: boxes, then map.
pub const LAYOUT_CHANNELS: usize = 6;
/// Number of sines (and of cosines) in the depth embedding.
pub const FREQUENCIES: usize = 8;
/// Value of the depth channel at empty pixels, and everywhere in [`DepthEmbedding::Discrete`].
const NO_DEPTH: f32 = -1.0;

/// Choice of depth channels to fill.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthEmbedding {
    /// Depth only; sines and cosines are 0.
    #[default]
    Continuous,
    /// Sines and cosines only; the depth is −1 everywhere.
    Discrete,
    /// Depth, sines and cosines.
    Both,
}

named!(DepthEmbedding, "depth embedding" {
    Continuous => "continuous", "Depth only; sines and cosines are 0";
    Discrete => "discrete", "Sines and cosines only; the depth is -1 everywhere";
    Both => "both", "Depth, sines and cosines";
});
named_in_files!(DepthEmbedding);

/// Network input of one camera, channels first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelTensor {
    /// `[20, H, W]`: color / 255 (3), depth (1), its sines (8) and cosines (8).
    pub points: Vec<f32>,
    /// `[6, H, W]`: boxes / 255 (3), map / 255 (3).
    pub layout: Vec<f32>,
}

impl ModelTensor {
    /// Returns a preview image: the layout over the color.
    pub fn preview(&self) -> Vec<[u8; 3]> {
        let pixels = self.points.len() / POINT_CHANNELS;
        let rgb = |channels: &[f32], first: usize, pixel: usize| {
            std::array::from_fn(|c| (channels[(first + c) * pixels + pixel] * 255.0).round() as u8)
        };
        let over = |pixel: usize| {
            let images = [rgb(&self.layout, 0, pixel), rgb(&self.layout, 3, pixel)];
            images.into_iter().find(|rgb| *rgb != [0; 3]).unwrap_or(rgb(&self.points, 0, pixel))
        };
        (0..pixels).map(over).collect()
    }
}

/// Encodes model tensors; create one for all cameras.
#[derive(Clone, Debug)]
pub struct TensorEncoder {
    bins: DepthBins,
    /// For each depth channel (1 + 8 + 8) its value at every bin (`count + 1` values); `None` for a channel
    /// of zeros.
    by_bin: Vec<Option<Vec<f32>>>,
}

impl TensorEncoder {
    /// Creates an encoder for depth in these bins.
    pub fn new(bins: DepthBins, embedding: DepthEmbedding) -> Self {
        let steps = f32::from(bins.count) - 1.0;
        // Normalized depth, 0 to 1, of a bin from 1 upward.
        let unit = |bin: u16| f32::from(bin.min(bins.count - 1)) / steps;
        let channel = |empty: f32, value: &dyn Fn(f32) -> f32| -> Vec<f32> {
            std::iter::once(empty).chain((1..=bins.count).map(|bin| value(unit(bin)))).collect()
        };
        let depth = match embedding {
            DepthEmbedding::Discrete => vec![NO_DEPTH; usize::from(bins.count) + 1],
            _ => channel(NO_DEPTH, &|u| u),
        };
        let wave = |of: fn(f64) -> f64, frequency: f32| {
            // Rounded once to `f32`, so that the result does not depend on the platform's `sinf`.
            let value = |u: f32| of(f64::from((std::f32::consts::TAU * u) * frequency)) as f32;
            (embedding != DepthEmbedding::Continuous).then(|| channel(0.0, &value))
        };
        let frequencies = frequencies(bins.count);
        let mut by_bin = vec![Some(depth)];
        by_bin.extend(frequencies.map(|frequency| wave(f64::sin, frequency)));
        by_bin.extend(frequencies.map(|frequency| wave(f64::cos, frequency)));
        Self { bins, by_bin }
    }

    /// Encodes point conditions `[20, H, W]` from color and camera depth in meters (infinite where empty),
    /// both `[H, W]`.
    pub fn points(&self, color: &[[u8; 3]], depth_m: &[f32]) -> Vec<f32> {
        let bins: Vec<u16> = depth_m.par_iter().map(|depth_m| self.bins.bin(*depth_m)).collect();
        self.points_of_bins(color, &bins)
    }

    /// Encodes point conditions `[20, H, W]` from color and depth bins (0 where empty), both `[H, W]`.
    pub fn points_of_bins(&self, color: &[[u8; 3]], bins: &[u16]) -> Vec<f32> {
        let pixels = color.len();
        let mut points = vec![0.0; POINT_CHANNELS * pixels];
        let (rgb, depth) = points.split_at_mut(3 * pixels);
        fill_levels(rgb, color);
        let channels = depth.par_chunks_exact_mut(pixels.max(1)).zip(&self.by_bin);
        channels.for_each(|(channel, by_bin)| {
            if let Some(by_bin) = by_bin {
                channel.iter_mut().zip(bins).for_each(|(value, bin)| *value = by_bin[usize::from(*bin)]);
            }
        });
        points
    }
}

/// Encodes the layout `[6, H, W]` from two images `[H, W]`; map channels are 0 without a map.
pub fn layout(boxes: &[[u8; 3]], map: Option<&[[u8; 3]]>) -> Vec<f32> {
    let mut layout = vec![0.0; LAYOUT_CHANNELS * boxes.len()];
    let (boxes_part, map_part) = layout.split_at_mut(3 * boxes.len());
    fill_levels(boxes_part, boxes);
    if let Some(map) = map {
        fill_levels(map_part, map);
    }
    layout
}

/// Returns `f_k = 2^(k · log2(n/2) / 7)`: from one period over the depth range to one period over two bins.
fn frequencies(bins: u16) -> [f32; FREQUENCIES] {
    let octaves = (f32::from(bins) / 2.0).log2();
    let last = (FREQUENCIES - 1) as f32;
    std::array::from_fn(|k| f64::from(k as f32 * octaves / last).exp2() as f32)
}

/// Writes an image as three channels of level / 255.
fn fill_levels(channels: &mut [f32], image: &[[u8; 3]]) {
    let levels: [f32; 256] = std::array::from_fn(|level| level as f32 / 255.0);
    channels.par_chunks_exact_mut(image.len().max(1)).enumerate().for_each(|(index, channel)| {
        channel.iter_mut().zip(image).for_each(|(value, rgb)| *value = levels[usize::from(rgb[index])]);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    const BINS: DepthBins = DepthBins { far_m: 50.0, ..DEFAULT_BINS };
    const DEFAULT_BINS: DepthBins =
        DepthBins { scale: super::super::BinScale::Linear, count: 256, far_m: 100.0, gamma: 1.0 };

    /// Returns the 20 channels of one pixel at a depth.
    fn pixel(depth_m: f32, embedding: DepthEmbedding) -> Vec<f32> {
        TensorEncoder::new(BINS, embedding).points(&[[51, 0, 255]], &[depth_m])
    }

    #[test]
    fn frequencies_of_256_bins_are_the_powers_of_two() {
        assert_eq!(frequencies(256), [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]);
    }

    #[test]
    fn options_fill_their_channels() {
        let depth_m = 20.0;
        let u = f32::from(BINS.bin(depth_m)) / 255.0;
        let both = pixel(depth_m, DepthEmbedding::Both);
        assert_eq!(both.len(), POINT_CHANNELS);
        assert_eq!(both[..4], [0.2, 0.0, 1.0, u]);
        let phase = std::f32::consts::TAU * u;
        assert!((both[4] - phase.sin()).abs() < 1e-6 && (both[12] - phase.cos()).abs() < 1e-6);
        assert!(
            (both[7] - (8.0 * phase).sin()).abs() < 1e-6 && (both[15] - (8.0 * phase).cos()).abs() < 1e-6
        );
        let continuous = pixel(depth_m, DepthEmbedding::Continuous);
        assert_eq!((&continuous[..4], &continuous[4..]), (&both[..4], &[0.0; 16][..]));
        let discrete = pixel(depth_m, DepthEmbedding::Discrete);
        assert_eq!((discrete[3], &discrete[4..]), (-1.0, &both[4..]));
    }

    #[test]
    fn ends_of_the_range() {
        for empty in [f32::INFINITY, f32::NAN, -300.0] {
            let values = pixel(empty, DepthEmbedding::Both);
            assert_eq!((values[3], &values[4..]), (-1.0, &[0.0; 16][..]));
        }
        // Depths at `far` get bin n, which is clamped to n − 1.
        assert_eq!((BINS.bin(50.0), pixel(50.0, DepthEmbedding::Both)[3]), (256, 1.0));
        assert_eq!(pixel(1e-3, DepthEmbedding::Both)[3], 1.0 / 255.0);
    }

    #[test]
    fn layouts_are_boxes_then_map() {
        let (boxes, map) = ([[255, 0, 51], [0, 0, 0]], [[0, 102, 0], [0, 0, 255]]);
        let boxes_part = [1.0, 0.0, 0.0, 0.0, 0.2, 0.0];
        assert_eq!(layout(&boxes, Some(&map))[..6], boxes_part);
        assert_eq!(layout(&boxes, Some(&map))[6..], [0.0, 0.0, 0.4, 0.0, 0.0, 1.0]);
        assert_eq!(layout(&boxes, None), [boxes_part, [0.0; 6]].concat());
        assert!(layout(&[], None).is_empty());
    }
}
