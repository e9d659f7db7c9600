use rayon::prelude::*;

use super::EPSILON;
use super::math::{total, wide};

/// Minimum number of rows per task.
const ROWS_PER_TASK: usize = 64;

/// Returns the mean, and one over the standard deviation.
#[inline(always)]
fn moments(x: &[f32]) -> (f32, f32) {
    let mean = total(x, |x| x) / x.len() as f32;
    let variance = total(x, |x| (x - mean) * (x - mean)) / x.len() as f32;
    (mean, 1.0 / (variance + EPSILON).sqrt())
}

/// Returns `norm(x) (1 + scale) + shift`, where `norm` scales each row of `x [R, d]` to zero mean and unit
/// variance. `modulation [G, 2d]` is `(shift, scale)`; each row applies to `R / G` consecutive rows. Source:
/// Peebles and Xie, "Scalable Diffusion Models with Transformers", 2023 (adaLN).
pub(in super::super) fn norm_modulate(x: &[f32], modulation: &[f32], d: usize) -> Vec<f32> {
    let per_group = x.len() / d / (modulation.len() / (2 * d));
    let mut out = vec![0.0_f32; x.len()];
    out.par_chunks_mut(d).with_min_len(ROWS_PER_TASK).enumerate().for_each(|(row, out)| {
        let x = &x[row * d..(row + 1) * d];
        let (shift, scale) = modulation[row / per_group * 2 * d..][..2 * d].split_at(d);
        wide(
            #[inline(always)]
            || {
                let (mean, factor) = moments(x);
                for j in 0..d {
                    out[j] = ((x[j] - mean) * factor).mul_add(1.0 + scale[j], shift[j]);
                }
            },
        );
    });
    out
}
