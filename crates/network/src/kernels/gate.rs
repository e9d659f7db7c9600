use rayon::prelude::*;

use super::math::wide;

/// Minimum number of rows per task.
const ROWS_PER_TASK: usize = 64;

/// Returns `x + gate y`; `x, y [R, d]`, `gate [G, d]`; each gate row applies to `R / G` consecutive rows.
pub(in super::super) fn gated_add(x: &[f32], y: &[f32], gate: &[f32], d: usize) -> Vec<f32> {
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
