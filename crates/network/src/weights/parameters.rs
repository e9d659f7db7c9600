//! Names, shapes and initial values of the parameters.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use point_skeleton::memory::{Need, reserve};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::Seeder;

use super::config::LATENT_CHANNELS;
use crate::inputs::{EGO, PLANES, RAY};
use crate::kernels::LANES;
use crate::{NetworkConfig, NetworkError};

/// Number of frequencies in the encoding of a noise level.
pub(crate) const WAVES: usize = 32;
/// Initial value of the gates.
const FIRST_GATE: f32 = 0.1;

/// A parameter: a matrix or a vector, with the standard deviation of its initial values.
struct Parameter {
    name: String,
    shape: Vec<usize>,
    spread: f64,
}

impl Parameter {
    fn values(&self) -> u128 {
        self.shape.iter().map(|side| *side as u128).product()
    }
}

/// Columns of the modulation: of the first and the last residual block (shift, scale and gate), of the output
/// (shift and scale), and of each token block (shift, scale and gate).
pub(crate) struct Modulations {
    quarter: usize,
    width: usize,
    blocks: usize,
}

impl Modulations {
    pub(crate) fn new(config: &NetworkConfig) -> Self {
        Self { quarter: config.channels[2], width: config.width, blocks: config.blocks.len() }
    }

    /// Number of columns.
    fn count(&self) -> usize {
        self.output() + 2 * self.quarter
    }

    /// First column of a token block.
    pub(crate) fn block(&self, block: usize) -> usize {
        3 * self.width * block
    }

    /// First column of the residual block before the tokens (0) or behind them (1).
    pub(crate) fn residual(&self, which: usize) -> usize {
        self.block(self.blocks) + 3 * self.quarter * which
    }

    /// First column of the output.
    pub(crate) fn output(&self) -> usize {
        self.residual(2)
    }

    /// Columns of the gates: first column and number.
    fn gates(&self) -> Vec<[usize; 2]> {
        let blocks = (0..self.blocks).map(|block| [self.block(block) + 2 * self.width, self.width]);
        let residuals = (0..2).map(|which| [self.residual(which) + 2 * self.quarter, self.quarter]);
        blocks.chain(residuals).collect()
    }
}

fn parameters(config: &NetworkConfig) -> Vec<Parameter> {
    let (d, [full, half, quarter, eighth]) = (config.width, config.channels);
    let modulations = Modulations::new(config).count();
    let mut all = Vec::new();
    let mut add = |name: &str, shape: &[usize], spread: f64| {
        all.push(Parameter { name: name.to_owned(), shape: shape.to_vec(), spread });
    };
    let of = |n: usize| 1.0 / (n as f64).sqrt();
    // He et al., "Delving Deep into Rectifiers", 2015.
    let mut convolution = |name: &str, from: usize, to: usize, gain: f64| {
        add(name, &[9 * from, to], gain * std::f64::consts::SQRT_2 * of(9 * from));
        add(&format!("{name}_bias"), &[to], 0.0);
    };
    for (name, from, to) in [
        ("encode.full", PLANES, full),
        ("encode.half", full, half),
        ("encode.quarter", half, quarter),
        ("encode.eighth", quarter, eighth),
        ("encode.up", eighth + quarter, quarter),
        ("decode.quarter", quarter + LANES, quarter),
        ("decode.half", quarter + half, half),
        ("decode.full", half + full, full),
    ] {
        convolution(&format!("{name}.a"), from, to, 1.0);
        convolution(&format!("{name}.b"), to, to, 1.0);
    }
    for name in ["denoise.first", "denoise.last"] {
        convolution(&format!("{name}.a"), quarter, quarter, 1.0);
        convolution(&format!("{name}.b"), quarter, quarter, 0.5);
    }
    for (name, shape, spread) in [
        ("decode.out", [3, full], 0.1 * of(full)),
        ("latent.in", [quarter, LATENT_CHANNELS], of(LATENT_CHANNELS)),
        ("conditions.in", [quarter, quarter], of(quarter)),
        ("tokens.in", [d, quarter], of(quarter)),
        ("tokens.out", [quarter, d], 0.5 * of(d)),
        ("rays.in", [d, RAY], of(RAY)),
        ("frame", [config.frames, d], 0.02),
        ("level.a", [d, 2 * WAVES], of(2 * WAVES)),
        ("level.b", [d, d], of(d)),
        ("ego.a", [d, EGO], of(EGO)),
        ("ego.b", [d, d], of(d)),
        ("modulation", [modulations, d], 0.02 * of(d)),
        ("out", [LATENT_CHANNELS, quarter], 0.1 * of(quarter)),
    ] {
        add(name, &shape, spread);
    }
    for (name, count) in [("decode.out_bias", 3), ("level.a_bias", d), ("modulation_bias", modulations)] {
        add(name, &[count], 0.0);
    }
    for block in 0..config.blocks.len() {
        let (wide, mixed) = (3 * d + config.hidden, d + config.hidden);
        add(&format!("block.{block:02}.in"), &[wide, d], of(d));
        add(&format!("block.{block:02}.out"), &[d, mixed], of(mixed));
    }
    all
}

/// Returns names and shapes of the parameters.
pub(crate) fn shapes(config: &NetworkConfig) -> Vec<(String, Vec<usize>)> {
    parameters(config).into_iter().map(|parameter| (parameter.name, parameter.shape)).collect()
}

/// Creates the initial parameters.
///
/// # Errors
/// Returns any error of the tensor library.
pub(crate) fn fresh(config: &NetworkConfig, seed: u64) -> Result<BTreeMap<String, Tensor>, NetworkError> {
    // With their gradient and the two moments of the optimizer.
    let count: u128 = parameters(config).iter().map(Parameter::values).sum();
    let bytes = u64::try_from(4 * 4 * count).unwrap_or(u64::MAX);
    let advice = "a configuration of fewer channels or a smaller width needs less";
    let need = || Need { what: format!("training a network of {count} parameters"), bytes, advice };
    let _memory = reserve(bytes, need)?;
    let gates = Modulations::new(config).gates();
    let make = |Parameter { name, shape, spread }| {
        let mut random: ChaCha8Rng = Seeder::from((seed, &name)).into_rng();
        let normal =
            || spread as f32 * <StandardNormal as Distribution<f32>>::sample(&StandardNormal, &mut random);
        let mut values = vec![0.0_f32; shape.iter().product()];
        if name == "modulation_bias" {
            gates.iter().for_each(|[first, count]| values[*first..][..*count].fill(FIRST_GATE));
        } else if spread > 0.0 {
            values.fill_with(normal);
        }
        Ok((name, Tensor::from_vec(values, shape, &Device::Cpu)?))
    };
    parameters(config).into_iter().map(make).collect()
}
