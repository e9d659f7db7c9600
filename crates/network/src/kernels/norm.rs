use rayon::prelude::*;

use super::EPSILON;
use super::math::{dot, total, wide};

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
pub(in super::super) fn norm_forward(x: &[f32], modulation: &[f32], d: usize) -> Vec<f32> {
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

/// Returns the gradients of `x` and of the modulation from the output's, `[R, d]`.
pub(in super::super) fn norm_backward(
    x: &[f32],
    modulation: &[f32],
    grad: &[f32],
    d: usize,
) -> (Vec<f32>, Vec<f32>) {
    let per_group = x.len() / d / (modulation.len() / (2 * d));
    let (mut x_grad, mut modulation_grad) = (vec![0.0_f32; x.len()], vec![0.0_f32; modulation.len()]);
    let groups = x_grad.par_chunks_mut(per_group * d).zip(modulation_grad.par_chunks_mut(2 * d));
    groups.enumerate().for_each(|(group, (x_grad, modulation_grad))| {
        let scale = &modulation[group * 2 * d + d..(group + 1) * 2 * d];
        let begin = group * per_group * d;
        let (x, grad) = (&x[begin..][..per_group * d], &grad[begin..][..per_group * d]);
        wide(
            #[inline(always)]
            || group_backward(x, scale, grad, x_grad, modulation_grad),
        );
    });
    (x_grad, modulation_grad)
}

/// Computes the gradients for the rows that share a row of the modulation.
#[inline(always)]
fn group_backward(x: &[f32], scale: &[f32], grad: &[f32], x_grad: &mut [f32], modulation_grad: &mut [f32]) {
    let d = scale.len();
    let (shift_grad, scale_grad) = modulation_grad.split_at_mut(d);
    let (mut normed, mut normed_grad) = (vec![0.0_f32; d], vec![0.0_f32; d]);
    for ((x, grad), x_grad) in x.chunks(d).zip(grad.chunks(d)).zip(x_grad.chunks_mut(d)) {
        let (mean, factor) = moments(x);
        for j in 0..d {
            normed[j] = (x[j] - mean) * factor;
            normed_grad[j] = grad[j] * (1.0 + scale[j]);
            shift_grad[j] += grad[j];
            scale_grad[j] = grad[j].mul_add(normed[j], scale_grad[j]);
        }
        let along_mean = total(&normed_grad, |x| x) / d as f32;
        let along_normed = dot(&normed_grad, &normed) / d as f32;
        for j in 0..d {
            x_grad[j] = factor * (normed_grad[j] - along_mean - normed[j] * along_normed);
        }
    }
}
