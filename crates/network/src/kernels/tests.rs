//! Compares kernels with plain loops, and gradients with finite differences.

use pskel_generate::{GaussianNoise, LatentShape, NoiseSource};

use super::math::{Product, exp};
use super::*;

fn normal(purpose: usize, count: usize) -> Vec<f32> {
    let shape = LatentShape { views: 1, channels: 1, height: 1, width: count };
    GaussianNoise { seed: 1 }.noise(shape, purpose, 0).values().to_vec()
}

fn sum(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// Asserts that a gradient matches finite differences of `f`, at about forty places.
fn assert_gradient(f: impl Fn(&[f32]) -> f64, x: &[f32], gradient: &[f32]) {
    assert_eq!(x.len(), gradient.len());
    for at in (0..x.len()).step_by(x.len() / 40 + 1) {
        let step = 4e-3;
        let moved = |by: f32| {
            let mut x = x.to_vec();
            x[at] += by;
            f(&x)
        };
        let slope = (moved(step) - moved(-step)) / f64::from(2.0 * step);
        let off = (slope - f64::from(gradient[at])).abs();
        assert!(off < 2e-3 + 1e-2 * slope.abs(), "{at}: {slope} {}", gradient[at]);
    }
}

const MIX: AttentionMlp = AttentionMlp {
    grid: Grid { windows: 2, frames: 3, views: 2, height: 3, width: 2 },
    attend: Attend::Space,
    width: 32,
    head: 16,
    hidden: 16,
};

#[test]
fn groups_cover_all_rows_once() {
    for attend in [Attend::Space, Attend::Views, Attend::Time] {
        let (rows, length) = (MIX.grid.rows(), MIX.grid.group_len(attend));
        let mut seen: Vec<usize> = (0..rows).map(|i| MIX.grid.row(attend, i / length, i % length)).collect();
        for (i, row) in seen.iter().enumerate() {
            assert_eq!(MIX.grid.place(attend, *row), (i / length, i % length), "{attend:?}");
        }
        seen.sort_unstable();
        assert!(seen.into_iter().eq(0..rows));
    }
}

/// Returns attention by its definition, in `f64`, for one row and channel.
fn attended(mix: &AttentionMlp, u: &[f32], row: usize, channel: usize) -> f64 {
    let (d, c) = (mix.width, mix.head);
    let head = channel / c;
    let unit = |row: usize, part: usize| -> Vec<f64> {
        let values = &u[row * mix_stride(mix) + part * d + head * c..][..c];
        let size = (sum(values, values) / c as f64 + 1e-6).sqrt();
        values.iter().map(|value| f64::from(*value) / size).collect()
    };
    let (group, _) = mix.grid.place(mix.attend, row);
    let query = unit(row, 0);
    let (mut above, mut below) = (0.0, 0.0);
    for token in 0..mix.grid.group_len(mix.attend) {
        let other = mix.grid.row(mix.attend, group, token);
        let product: f64 = query.iter().zip(unit(other, 1)).map(|(q, k)| q * k).sum();
        let weight = (product / (c as f64).sqrt()).exp();
        above += weight * f64::from(u[other * mix_stride(mix) + 2 * d + channel]);
        below += weight;
    }
    above / below
}

fn mix_stride(mix: &AttentionMlp) -> usize {
    3 * mix.width + mix.hidden
}

#[test]
fn attention_is_what_its_definition_says() {
    for attend in [Attend::Space, Attend::Views, Attend::Time] {
        let mix = AttentionMlp { attend, ..MIX };
        let (rows, out_stride) = (mix.grid.rows(), mix.width + mix.hidden);
        let u = normal(1, rows * mix_stride(&mix));
        let out = mix.forward(&u);
        for row in 0..rows {
            for channel in 0..mix.width {
                let off = f64::from(out[row * out_stride + channel]) - attended(&mix, &u, row, channel);
                assert!(off.abs() < 1e-5, "{attend:?} {row} {channel}: {off}");
            }
            for hidden in 0..mix.hidden {
                let x = f64::from(u[row * mix_stride(&mix) + 3 * mix.width + hidden]);
                let root = (2.0 / std::f64::consts::PI).sqrt();
                let gelu = 0.5 * x * (1.0 + (root * (x + 0.044_715 * x * x * x)).tanh());
                assert!((f64::from(out[row * out_stride + mix.width + hidden]) - gelu).abs() < 1e-6);
            }
        }
        let grad = normal(2, out.len());
        assert_gradient(|u| sum(&mix.forward(u), &grad), &u, &mix.backward(&u, &grad));
    }
}

#[test]
fn norm_and_gate_have_their_gradients() {
    let (x, modulation, grad) = (normal(3, 6 * 32), normal(4, 2 * 64), normal(5, 6 * 32));
    let out = norm_forward(&x, &modulation, 32);
    for (row, values) in x.chunks(32).enumerate() {
        let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / 32.0;
        let variance = values.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / 32.0;
        for j in 0..32 {
            let [shift, scale] = [0, 32].map(|part| f64::from(modulation[row / 3 * 64 + part + j]));
            let expected = (f64::from(values[j]) - mean) / (variance + 1e-6).sqrt() * (1.0 + scale) + shift;
            assert!((f64::from(out[row * 32 + j]) - expected).abs() < 1e-5);
        }
    }
    let (x_grad, modulation_grad) = norm_backward(&x, &modulation, &grad, 32);
    assert_gradient(|x| sum(&norm_forward(x, &modulation, 32), &grad), &x, &x_grad);
    assert_gradient(|m| sum(&norm_forward(&x, m, 32), &grad), &modulation, &modulation_grad);

    let (y, gate) = (normal(6, 6 * 32), normal(7, 2 * 32));
    let out = gate_forward(&x, &y, &gate, 32);
    for i in 0..out.len() {
        assert!((out[i] - (x[i] + gate[i / 96 * 32 + i % 32] * y[i])).abs() < 1e-6);
    }
    let (y_grad, gate_grad) = gate_backward(&y, &gate, &grad, 32);
    assert_gradient(|y| sum(&gate_forward(&x, y, &gate, 32), &grad), &y, &y_grad);
    assert_gradient(|gate| sum(&gate_forward(&x, &y, gate, 32), &grad), &gate, &gate_grad);
}

#[test]
fn products_of_odd_sizes_are_right() {
    for (rows, inner, columns) in [(1, 1, 16), (5, 3, 16), (7, 9, 48), (4, 2, 64)] {
        let (a, b) = (normal(8, rows * inner), normal(9, inner * columns));
        for strides in [[inner, 1], [1, rows]] {
            let mut out = vec![f32::NAN; rows * columns];
            Product { rows, inner, columns, a: &a, strides, b: &b, out: &mut out }.run();
            for (i, value) in out.iter().enumerate() {
                let (row, column) = (i / columns, i % columns);
                let of = |k: usize| a[row * strides[0] + k * strides[1]] * b[k * columns + column];
                assert!((value - (0..inner).map(of).sum::<f32>()).abs() < 1e-5);
            }
        }
    }
}

#[test]
fn exponentials_are_true_to_their_last_places() {
    for x in (-8700..8800).map(|i| i as f32 / 100.0) {
        let ratio = f64::from(exp(x)) / f64::from(x).exp();
        assert!((ratio - 1.0).abs() < 4e-7, "{x} {ratio}");
    }
    assert!(exp(-1e9) < 1.1e-37);
}
