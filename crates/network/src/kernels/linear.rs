use rayon::prelude::*;

use super::math::{Product, wide};

/// Rows per task.
const ROWS_PER_TASK: usize = 64;

/// A linear layer, `x W + b`.
#[derive(Clone, Debug)]
pub(in super::super) struct Linear {
    /// Width of the input, K.
    pub(in super::super) inputs: usize,
    /// Width of the output, N.
    pub(in super::super) outputs: usize,
    /// `[K, M]`; M is the next multiple of [`LANES`](super::LANES) from N, and the columns behind N are 0.
    pub(in super::super) weights: Vec<f32>,
    /// `[M]`, 0 behind N.
    pub(in super::super) bias: Vec<f32>,
}

impl Linear {
    /// Computes rows `[R, N]` from rows `[R, K]`.
    pub(in super::super) fn forward(&self, x: &[f32]) -> Vec<f32> {
        let Self { inputs, outputs, weights, bias } = self;
        let columns = bias.len();
        let mut out = vec![0.0_f32; x.len() / inputs * columns];
        let parts = out.par_chunks_mut(ROWS_PER_TASK * columns).zip(x.par_chunks(ROWS_PER_TASK * inputs));
        parts.for_each(|(out, a)| {
            let rows = a.len() / inputs;
            wide(
                #[inline(always)]
                || {
                    out.chunks_mut(columns).for_each(|row| row.copy_from_slice(bias));
                    let strides = [*inputs, 1];
                    let inner = *inputs;
                    Product { rows, inner, columns, a, strides, b: weights, out, accumulate: true }.run();
                },
            );
        });
        if columns > *outputs {
            out = out.chunks(columns).flat_map(|row| &row[..*outputs]).copied().collect();
        }
        out
    }
}
