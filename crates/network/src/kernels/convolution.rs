use std::borrow::Cow;

use rayon::prelude::*;

use super::LANES;
use super::math::{Product, wide};

/// Convolution by 3x3 pixels of images `[N, H, W, C]` with zeros around them, a bias, and optionally `max(0,
/// x)`. The weights are `[9 C, D]`, with a row per (y, x, input channel) and a column per output channel. C
/// and D are multiples of [`LANES`].
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Convolution {
    pub(in super::super) height: usize,
    pub(in super::super) width: usize,
    /// Input channels, C.
    pub(in super::super) channels: usize,
    /// Output channels, D.
    pub(in super::super) outputs: usize,
    /// Whether negative outputs are 0.
    pub(in super::super) rectified: bool,
}

/// Rows of an image per task.
const ROWS_PER_TASK: usize = 16;
/// Images whose weight gradients are summed by one task. A fixed number, so that sums do not depend on the
/// number of threads.
const IMAGES_PER_SUM: usize = 2;

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

    /// Returns the gradient of the input from the output and its gradient.
    pub(in super::super) fn input_grad(&self, weights: &[f32], out: &[f32], grad: &[f32]) -> Vec<f32> {
        let back = Self { channels: self.outputs, outputs: self.channels, rectified: false, ..*self };
        back.forward(&self.passed(out, grad), &self.flipped(weights), &vec![0.0; self.channels])
    }

    /// Returns the part of a gradient that passes the rectification: that where the output is above 0.
    fn passed<'a>(&self, out: &[f32], grad: &'a [f32]) -> Cow<'a, [f32]> {
        if self.rectified { mask(out, grad).into() } else { grad.into() }
    }

    /// Returns the weights of the transposed convolution, `[9 D, C]`.
    fn flipped(&self, weights: &[f32]) -> Vec<f32> {
        let (c, d) = (self.channels, self.outputs);
        let mut flipped = vec![0.0_f32; weights.len()];
        for (tap, weights) in weights.chunks(c * d).enumerate() {
            let flipped = &mut flipped[(8 - tap) * c * d..][..c * d];
            for (i, row) in weights.chunks(d).enumerate() {
                row.iter().enumerate().for_each(|(j, w)| flipped[j * c + i] = *w);
            }
        }
        flipped
    }

    /// Returns the gradients of weights and bias from the output and its gradient.
    pub(in super::super) fn weights_grad(
        &self,
        x: &[f32],
        out: &[f32],
        grad: &[f32],
    ) -> (Vec<f32>, Vec<f32>) {
        let (Self { height, width, channels, outputs, .. }, grad) = (*self, self.passed(out, grad));
        let (pixels, len) = (height * width, 9 * channels * outputs);
        let groups = x
            .par_chunks(IMAGES_PER_SUM * pixels * channels)
            .zip(grad.par_chunks(IMAGES_PER_SUM * pixels * outputs));
        let of = |(x, grad): (&[f32], &[f32])| {
            let (mut sums, mut bias, mut padded) = (vec![0.0_f32; len], vec![0.0_f32; outputs], Vec::new());
            for (x, grad) in x.chunks(pixels * channels).zip(grad.chunks(pixels * outputs)) {
                self.pad(x, 0, height, &mut padded);
                self.add_products(&padded, grad, &mut sums);
                add_rows(grad, &mut bias);
            }
            (sums, bias)
        };
        let parts: Vec<_> = groups.map(of).collect();
        let (mut sums, mut bias) = (vec![0.0_f32; len], vec![0.0_f32; outputs]);
        for (part, part_bias) in &parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            bias.iter_mut().zip(part_bias).for_each(|(sum, part)| *sum += part);
        }
        (sums, bias)
    }

    /// Adds the products of an image's pixels and their gradients to the weights' gradient.
    fn add_products(&self, padded: &[f32], grad: &[f32], sums: &mut [f32]) {
        let Self { width, channels, outputs, .. } = *self;
        let stride = (width + 2) * channels;
        for (y, b) in grad.chunks(width * outputs).enumerate() {
            for (dy, out) in sums.chunks_mut(3 * channels * outputs).enumerate() {
                let a = &padded[(y + dy) * stride..][..stride];
                let (rows, inner, columns, strides) = (3 * channels, width, outputs, [1, channels]);
                Product { rows, inner, columns, a, strides, b, out, accumulate: true }.run();
            }
        }
    }
}

/// Adds the bias to rows, and sets negative values to 0.
fn finish(out: &mut [f32], bias: &[f32], rectified: bool) {
    let least = if rectified { 0.0 } else { f32::NEG_INFINITY };
    wide(
        #[inline(always)]
        || {
            for out in out.chunks_mut(bias.len()) {
                for (out, bias) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(bias.as_chunks::<LANES>().0)
                {
                    for l in 0..LANES {
                        out[l] = (out[l] + bias[l]).max(least);
                    }
                }
            }
        },
    );
}

/// Returns the gradient where the output is above 0.
fn mask(out: &[f32], grad: &[f32]) -> Vec<f32> {
    const VALUES_PER_TASK: usize = 1 << 16;
    let mut masked = vec![0.0_f32; grad.len()];
    let parts = masked.par_chunks_mut(VALUES_PER_TASK).zip(out.par_chunks(VALUES_PER_TASK));
    parts.zip(grad.par_chunks(VALUES_PER_TASK)).for_each(|((masked, out), grad)| {
        for ((masked, out), grad) in masked.iter_mut().zip(out).zip(grad) {
            *masked = if *out > 0.0 { *grad } else { 0.0 };
        }
    });
    masked
}

fn add_rows(rows: &[f32], sums: &mut [f32]) {
    for row in rows.chunks(sums.len()) {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
}
