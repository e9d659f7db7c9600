use rayon::prelude::*;

use super::LANES;
use super::math::{Product, wide};

/// Convolution by 3x3 pixels of images `[N, H, W, C]` with zeros around them, a bias, and optionally a
/// rectification: numbers below 0 are multiplied by [`SLOPE`]. The weights are `[9 C, D]`, with a row per (y,
/// x, input channel) and a column per output channel. C and D are multiples of [`LANES`].
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Convolution {
    pub(in super::super) height: usize,
    pub(in super::super) width: usize,
    /// Input channels, C.
    pub(in super::super) channels: usize,
    /// Output channels, D.
    pub(in super::super) outputs: usize,
    /// Whether outputs are rectified.
    pub(in super::super) rectified: bool,
}

/// Slope of rectified numbers below 0. Source: Maas et al., 2013.
pub(super) const SLOPE: f32 = 0.1;
/// Rows of an image per task.
const ROWS_PER_TASK: usize = 16;
impl Convolution {
    /// Computes `[N, H, W, D]`.
    pub(in super::super) fn forward(&self, x: &[f32], weights: &[f32], bias: &[f32]) -> Vec<f32> {
        let Self { height, width, channels, outputs, rectified } = *self;
        let mut out = vec![0.0_f32; x.len() / channels * outputs];
        let images =
            out.par_chunks_mut(height * width * outputs).zip(x.par_chunks(height * width * channels));
        images.for_each(|(out, x)| {
            let bands = out.par_chunks_mut(ROWS_PER_TASK * width * outputs).enumerate();
            bands.for_each_init(Vec::new, |padded, (band, out)| {
                let rows = out.len() / (width * outputs);
                self.pad(x, band * ROWS_PER_TASK, rows, padded);
                let stride = (width + 2) * channels;
                for (y, out) in out.chunks_mut(width * outputs).enumerate() {
                    for (dy, weights) in weights.chunks(3 * channels * outputs).enumerate() {
                        let a = &padded[(y + dy) * stride..][..stride];
                        let (strides, accumulate) = ([channels, 1], dy > 0);
                        let inner = 3 * channels;
                        let (rows, columns, b) = (width, outputs, weights);
                        Product { rows, inner, columns, a, strides, b, out, accumulate }.run();
                    }
                    finish(out, bias, rectified);
                }
            });
        });
        out
    }

    /// Copies `rows` rows of an image from row `first`, with the row before and the one behind them, and a
    /// pixel of zeros on either side: `[rows + 2, W + 2, C]`.
    fn pad(&self, x: &[f32], first: usize, rows: usize, padded: &mut Vec<f32>) {
        let Self { height, width, channels, .. } = *self;
        padded.clear();
        padded.resize((rows + 2) * (width + 2) * channels, 0.0);
        for (row, padded) in padded.chunks_mut((width + 2) * channels).enumerate() {
            let y = (first + row).wrapping_sub(1);
            if y < height {
                padded[channels..][..width * channels]
                    .copy_from_slice(&x[y * width * channels..][..width * channels]);
            }
        }
    }
}

/// Adds the bias to rows, and rectifies them.
fn finish(out: &mut [f32], bias: &[f32], rectified: bool) {
    let slope = if rectified { SLOPE } else { 1.0 };
    wide(
        #[inline(always)]
        || {
            for out in out.chunks_mut(bias.len()) {
                for (out, bias) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(bias.as_chunks::<LANES>().0)
                {
                    for l in 0..LANES {
                        let sum = out[l] + bias[l];
                        out[l] = sum.max(slope * sum);
                    }
                }
            }
        },
    );
}
