use rayon::prelude::*;

use super::math::{Product, dot, each, every, exp, gelu, total, wide};
use super::{Attend, EPSILON, Grid, LANES};

/// Attention and the activation of a hidden layer in parallel: rows `[q, k, v, hidden]` of width `3d + m`
/// become rows `[softmax(q k / sqrt c) v, gelu(hidden)]` of width `d + m`. q and k are normalized to a mean
/// square of 1 per head, so softmax does not need the maximum of its inputs. Source: Dehghani et al.,
/// "Scaling Vision Transformers to 22 Billion Parameters", 2023 (normed queries and keys, parallel layers).
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct AttentionMlp {
    /// Token grid.
    pub(in super::super) grid: Grid,
    /// Groups of tokens that attend to each other.
    pub(in super::super) attend: Attend,
    /// Width, d.
    pub(in super::super) width: usize,
    /// Width of a head, c.
    pub(in super::super) head: usize,
    /// Width of the hidden layer, m.
    pub(in super::super) hidden: usize,
}

/// Minimum number of rows per task.
const ROWS_PER_TASK: usize = 64;

/// Buffers for a head, in a group with n tokens of width c. Rows of weights are padded to N, a multiple of
/// [`LANES`].
#[derive(Default)]
struct Scratch {
    /// Normalized queries, and values: `[n, c]`.
    q: Vec<f32>,
    v: Vec<f32>,
    /// Normalized keys, transposed: `[c, N]`.
    k_across: Vec<f32>,
    /// Attention weights: `[n, N]`.
    weights: Vec<f32>,
    /// Result of a matrix product: `[n, c]`.
    out: Vec<f32>,
}

impl AttentionMlp {
    fn stride(&self) -> usize {
        3 * self.width + self.hidden
    }

    /// Number of tokens in a group, n, and the next multiple of [`LANES`], N.
    fn lengths(&self) -> (usize, usize) {
        let tokens = self.grid.group_len(self.attend);
        (tokens, tokens.next_multiple_of(LANES))
    }

    #[inline(always)]
    fn gather(&self, u: &[f32], group: usize, head: usize, s: &mut Scratch) {
        let ((n, padded), c) = (self.lengths(), self.head);
        s.k_across.clear();
        s.k_across.resize(c * padded, 0.0);
        for rows in [&mut s.q, &mut s.v, &mut s.out] {
            rows.resize(n * c, 0.0);
        }
        s.weights.resize(n * padded, 0.0);
        for i in 0..n {
            let at = self.grid.row(self.attend, group, i) * self.stride() + head * c;
            let [q, k, v] = [0, 1, 2].map(|part| &u[at + part * self.width..][..c]);
            let factor = |x: &[f32]| 1.0 / (dot(x, x) / c as f32 + EPSILON).sqrt();
            let (q_factor, k_factor) = (factor(q), factor(k));
            for j in 0..c {
                s.q[i * c + j] = q[j] * q_factor;
            }
            for j in 0..c {
                s.k_across[j * padded + i] = k[j] * k_factor;
            }
            s.v[i * c..(i + 1) * c].copy_from_slice(v);
        }
    }

    /// Gathers a head of a group, and computes its attention weights into `s.weights`.
    #[inline(always)]
    fn weigh(&self, u: &[f32], group: usize, head: usize, s: &mut Scratch) {
        self.gather(u, group, head, s);
        let ((n, padded), c) = (self.lengths(), self.head);
        let (a, b, out) = (&s.q, &s.k_across, &mut s.weights);
        Product { rows: n, inner: c, columns: padded, a, strides: [c, 1], b, out, accumulate: false }.run();
        // |q k| <= c, so the argument of `exp` is never above 0.
        let (scale, most) = (1.0 / (c as f32).sqrt(), (c as f32).sqrt());
        for i in 0..n {
            let weights = &mut s.weights[i * padded..(i + 1) * padded];
            every(weights, |x| exp(x.mul_add(scale, -most)));
            weights[n..].fill(0.0);
            let factor = 1.0 / total(weights, |x| x);
            every(weights, |x| x * factor);
        }
    }

    /// Computes `[R, d + m]` from `[R, 3d + m]`.
    pub(in super::super) fn forward(&self, u: &[f32]) -> Vec<f32> {
        let ((n, padded), c, d, m) = (self.lengths(), self.head, self.width, self.hidden);
        let rows = self.grid.rows();
        let mut seen = vec![0.0_f32; rows * d]; // [group, token, d]
        seen.par_chunks_mut(n * d).enumerate().for_each_init(Scratch::default, |s, (group, seen)| {
            wide(
                #[inline(always)]
                || {
                    for head in 0..d / c {
                        self.weigh(u, group, head, s);
                        let (a, b, out) = (&s.weights, &s.v, &mut s.out);
                        Product {
                            rows: n,
                            inner: n,
                            columns: c,
                            a,
                            strides: [padded, 1],
                            b,
                            out,
                            accumulate: false,
                        }
                        .run();
                        for (i, row) in s.out.chunks(c).enumerate() {
                            seen[i * d + head * c..][..c].copy_from_slice(row);
                        }
                    }
                },
            );
        });
        let mut out = vec![0.0_f32; rows * (d + m)];
        out.par_chunks_mut(d + m).with_min_len(ROWS_PER_TASK).enumerate().for_each(|(row, out)| {
            let (group, token) = self.grid.place(self.attend, row);
            let (out_seen, out_hidden) = out.split_at_mut(d);
            out_seen.copy_from_slice(&seen[(group * n + token) * d..][..d]);
            let hidden = &u[row * self.stride() + 3 * d..][..m];
            wide(
                #[inline(always)]
                || each(out_hidden, hidden, hidden, |x, _| gelu(x)),
            );
        });
        out
    }
}
