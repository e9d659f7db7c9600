//! Compares kernels with plain loops.

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

const MIX: AttentionMlp = AttentionMlp {
    grid: Grid { frames: 3, views: 2, height: 3, width: 2 },
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
fn attention_matches_its_definition() {
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
    }
}

#[test]
fn norm_and_gate_match_their_definitions() {
    let (x, modulation) = (normal(3, 6 * 32), normal(4, 2 * 64));
    let out = norm_modulate(&x, &modulation, 32);
    for (row, values) in x.chunks(32).enumerate() {
        let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / 32.0;
        let variance = values.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / 32.0;
        for j in 0..32 {
            let [shift, scale] = [0, 32].map(|part| f64::from(modulation[row / 3 * 64 + part + j]));
            let expected = (f64::from(values[j]) - mean) / (variance + 1e-6).sqrt() * (1.0 + scale) + shift;
            assert!((f64::from(out[row * 32 + j]) - expected).abs() < 1e-5);
        }
    }
    let (y, gate) = (normal(6, 6 * 32), normal(7, 2 * 32));
    let out = gated_add(&x, &y, &gate, 32);
    for i in 0..out.len() {
        assert!((out[i] - (x[i] + gate[i / 96 * 32 + i % 32] * y[i])).abs() < 1e-6);
    }
}

/// Rows of several tasks, and columns that are padded.
#[test]
fn linear_layers_match_their_definition() {
    let (rows, inputs, outputs, columns) = (150, 5, 19, 32);
    let (x, mut bias) = (normal(10, rows * inputs), normal(11, columns));
    let mut weights = normal(12, inputs * columns);
    bias[outputs..].fill(0.0);
    weights.chunks_mut(columns).for_each(|row| row[outputs..].fill(0.0));
    let out = Linear { inputs, outputs, weights: weights.clone(), bias: bias.clone() }.forward(&x);
    assert_eq!(out.len(), rows * outputs);
    for (i, value) in out.iter().enumerate() {
        let (row, column) = (i / outputs, i % outputs);
        let of = |k: usize| f64::from(x[row * inputs + k]) * f64::from(weights[k * columns + column]);
        let expected = f64::from(bias[column]) + (0..inputs).map(of).sum::<f64>();
        assert!((f64::from(*value) - expected).abs() < 1e-5, "{i}: {value} {expected}");
    }
    let mut values = vec![-30.0, -1.0, 0.0, 0.5, 20.0];
    silu(&mut values);
    for (value, x) in values.iter().zip([-30.0, -1.0, 0.0, 0.5, 20.0_f64]) {
        assert!((f64::from(*value) - x / (1.0 + (-x).exp())).abs() < 1e-5 * x.abs().max(1e-3), "{x} {value}");
    }
}

#[test]
fn products_of_odd_sizes_are_correct() {
    for (rows, inner, columns) in [(1, 1, 16), (5, 3, 16), (7, 9, 48), (4, 2, 64)] {
        let (a, b) = (normal(8, rows * inner), normal(9, inner * columns));
        for strides in [[inner, 1], [1, rows]] {
            let mut out = vec![f32::NAN; rows * columns];
            Product { rows, inner, columns, a: &a, strides, b: &b, out: &mut out, accumulate: false }.run();
            for (i, value) in out.iter().enumerate() {
                let (row, column) = (i / columns, i % columns);
                let of = |k: usize| a[row * strides[0] + k * strides[1]] * b[k * columns + column];
                assert!((value - (0..inner).map(of).sum::<f32>()).abs() < 1e-5);
            }
        }
    }
}

#[test]
fn exp_is_accurate_to_4e_7() {
    for x in (-8700..8800).map(|i| i as f32 / 100.0) {
        let ratio = f64::from(exp(x)) / f64::from(x).exp();
        assert!((ratio - 1.0).abs() < 4e-7, "{x} {ratio}");
    }
    assert!(exp(-1e9) < 1.1e-37);
}

/// Returns a convolution by its definition at one place, in `f64`.
fn convolved(shape: &Convolution, x: &[f32], weights: &[f32], bias: &[f32], at: usize) -> f64 {
    let Convolution { height, width, channels, outputs, rectified } = *shape;
    let (pixel, output) = (at / outputs, at % outputs);
    let (image, y, x_at) = (pixel / (height * width), pixel / width % height, pixel % width);
    let mut sum = f64::from(bias[output]);
    for (tap, from) in (0..9).flat_map(|tap| (0..channels).map(move |from| (tap, from))) {
        let (row, column) = (y + tap / 3, x_at + tap % 3);
        if (1..=height).contains(&row) && (1..=width).contains(&column) {
            let place = (image * height + row - 1) * width + column - 1;
            let weight = weights[(tap * channels + from) * outputs + output];
            sum += f64::from(x[place * channels + from]) * f64::from(weight);
        }
    }
    if rectified { sum.max(0.1 * sum) } else { sum }
}

#[test]
fn convolution_matches_its_definition() {
    for (height, width, channels, outputs, rectified) in [(20, 5, 16, 32, true), (3, 14, 32, 16, false)] {
        let shape = Convolution { height, width, channels, outputs, rectified };
        let (pixels, taps) = (3 * height * width, 9 * channels);
        let x = normal(20, pixels * channels);
        let weights: Vec<f32> = normal(21, taps * outputs).iter().map(|w| 0.1 * w).collect();
        let bias = normal(22, outputs);
        let out = shape.forward(&x, &weights, &bias);
        for (at, value) in out.iter().enumerate().step_by(7) {
            let expected = convolved(&shape, &x, &weights, &bias, at);
            assert!((f64::from(*value) - expected).abs() < 1e-4, "{at}: {value} {expected}");
        }
    }
}

#[test]
fn resizing_keeps_constants_and_ramps() {
    let shape = Resize { height: 6, width: 10, channels: 16 };
    let (large, small) = (2 * 6 * 10 * 16, 2 * 3 * 5 * 16);
    assert!(
        shape
            .downsample(&vec![0.7; large])
            .iter()
            .chain(&shape.upsample(&vec![0.7; small]))
            .all(|v| (v - 0.7).abs() < 1e-6)
    );
    // A ramp stays a ramp, except at the borders.
    let ramp: Vec<f32> = (0..small).map(|i| (i / 16 % 5) as f32).collect();
    let doubled = shape.upsample(&ramp);
    let row: Vec<f32> = (0..10).map(|x| doubled[(2 * 10 + x) * 16]).collect();
    assert_eq!(row, [0.0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.25, 3.75, 4.0]);
    let halved = shape.downsample(&doubled);
    assert_eq!(halved[16], (0.75 + 1.25) / 2.0);
}
