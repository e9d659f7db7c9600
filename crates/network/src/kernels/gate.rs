use rayon::prelude::*;

use super::math::wide;

/// Minimum number of rows per task.
const ROWS_PER_TASK: usize = 64;

/// Returns `x + gate y`; `x, y [R, d]`, `gate [G, d]`; each gate row applies to `R / G` consecutive rows.
pub(in super::super) fn gate_forward(x: &[f32], y: &[f32], gate: &[f32], d: usize) -> Vec<f32> {
    let per_group = x.len() / gate.len();
    let mut out = vec![0.0_f32; x.len()];
    out.par_chunks_mut(d).with_min_len(ROWS_PER_TASK).enumerate().for_each(|(row, out)| {
        let (x, y) = (&x[row * d..(row + 1) * d], &y[row * d..(row + 1) * d]);
        let gate = &gate[row / per_group * d..][..d];
        wide(
            #[inline(always)]
            || {
                for j in 0..d {
                    out[j] = gate[j].mul_add(y[j], x[j]);
                }
            },
        );
    });
    out
}

/// Returns the gradients of `y` and of the gate from the output's gradient, which is also the gradient of
/// `x`.
pub(in super::super) fn gate_backward(
    y: &[f32],
    gate: &[f32],
    grad: &[f32],
    d: usize,
) -> (Vec<f32>, Vec<f32>) {
    let per_group = y.len() / gate.len();
    let (mut y_grad, mut gate_grad) = (vec![0.0_f32; y.len()], vec![0.0_f32; gate.len()]);
    let groups = y_grad.par_chunks_mut(per_group * d).zip(gate_grad.par_chunks_mut(d));
    groups.enumerate().for_each(|(group, (y_grad, gate_grad))| {
        let gate = &gate[group * d..(group + 1) * d];
        let begin = group * per_group * d;
        let (y, grad) = (&y[begin..][..per_group * d], &grad[begin..][..per_group * d]);
        wide(
            #[inline(always)]
            || {
                for ((y, grad), y_grad) in y.chunks(d).zip(grad.chunks(d)).zip(y_grad.chunks_mut(d)) {
                    for j in 0..d {
                        y_grad[j] = grad[j] * gate[j];
                        gate_grad[j] = grad[j].mul_add(y[j], gate_grad[j]);
                    }
                }
            },
        );
    });
    (y_grad, gate_grad)
}
