use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::Seeder;

use super::inputs::{EGO, RAY};
use super::kernels::{AttentionMlp, Grid};
use super::{Inputs, Levels, NetworkConfig, NetworkError, Statistics, ops};

/// Number of frequencies in the encoding of a noise level.
const WAVES: usize = 32;
/// Initial value of the blocks' gates.
const FIRST_GATE: f32 = 0.1;

/// The transformer; a token is a patch of a camera of a frame. A block computes one attention and one hidden layer
/// in parallel after a shared norm: `x + gate W_out [attention(q, k, v), gelu(hidden)]` with
/// `[q, k, v, hidden] = W_in norm(x)`. Gate and norm are modulated per frame by the noise level and the ego motion.
/// Sources: Peebles and Xie, "Scalable Diffusion Models with Transformers", 2023; Chen et al., "Diffusion Forcing",
/// 2024 (a level per frame).
#[derive(Clone, Debug)]
pub(crate) struct Model {
    config: NetworkConfig,
    priors: Vec<f32>,
    parameters: BTreeMap<String, Tensor>,
}

/// Embedded conditions of windows; the same for all noise levels.
#[derive(Clone, Debug)]
pub(crate) struct EmbeddedConditions {
    grid: Grid,
    /// Tokens of the conditions, `[R, d]`.
    tokens: Tensor,
    /// First guess of the latents, from the maps of each patch alone, `[R, C]`.
    guess: Tensor,
    /// Embedded ego motion, `[B L, d]`.
    ego: Tensor,
}

/// A parameter: a matrix `[out, in]` or a vector, with the standard deviation of its initial values.
struct Parameter {
    name: String,
    shape: Vec<usize>,
    spread: f64,
}

fn parameters(config: &NetworkConfig) -> Vec<Parameter> {
    let (d, channels, maps) = (config.width, config.channels(), config.map_numbers());
    let (patches, blocks) = (config.shape().height * config.shape().width, config.blocks.len());
    let modulations = (3 * blocks + 2) * d;
    let of = |n: usize| 1.0 / (n as f64).sqrt();
    let parameter = |name: &str, shape: &[usize], spread: f64| Parameter {
        name: name.to_owned(),
        shape: shape.to_vec(),
        spread,
    };
    let mut all = vec![
        parameter("latent.in", &[d, channels], of(channels)),
        // Neighboring pixels of a map are strongly correlated.
        parameter("maps.in", &[d, maps], 2.0 * of(maps)),
        parameter("maps.guess", &[channels, maps], 0.0),
        parameter("maps.guess_bias", &[channels], 0.0),
        parameter("rays.in", &[d, RAY], of(RAY)),
        parameter("place", &[patches, d], 0.02),
        parameter("frame", &[config.frames, d], 0.02),
        parameter("level.a", &[d, 2 * WAVES], of(2 * WAVES)),
        parameter("level.a_bias", &[d], 0.0),
        parameter("level.b", &[d, d], of(d)),
        parameter("ego.a", &[d, EGO], of(EGO)),
        parameter("ego.b", &[d, d], of(d)),
        parameter("modulation", &[modulations, d], 0.02 * of(d)),
        parameter("modulation_bias", &[modulations], 0.0),
        parameter("out", &[channels, d], 0.1 * of(d)),
    ];
    for block in 0..blocks {
        let (wide, mixed) = (3 * d + config.hidden, d + config.hidden);
        all.push(parameter(&format!("block.{block:02}.in"), &[wide, d], of(d)));
        all.push(parameter(&format!("block.{block:02}.out"), &[d, mixed], of(mixed)));
    }
    all
}

/// Returns names and shapes of the parameters.
pub(crate) fn shapes(config: &NetworkConfig) -> Vec<(String, Vec<usize>)> {
    parameters(config).into_iter().map(|parameter| (parameter.name, parameter.shape)).collect()
}

/// A linear guess of latents from the maps of their patches; the starting point of training.
#[derive(Clone, Debug, PartialEq)]
pub struct FirstGuess {
    /// Matrix `[C, 26 p^2]`, with a column per layout, color or depth channel and pixel of a patch.
    pub matrix: Vec<f32>,
    /// Bias `[C]`.
    pub bias: Vec<f32>,
}

/// Creates the initial parameters.
///
/// # Errors
/// Returns an error if the guess does not fit the configuration, or any error of the tensor library.
pub(crate) fn fresh(
    config: &NetworkConfig,
    guess: &FirstGuess,
    seed: u64,
) -> std::result::Result<BTreeMap<String, Tensor>, NetworkError> {
    let expected = [config.channels() * config.map_numbers(), config.channels()];
    let found = [guess.matrix.len(), guess.bias.len()];
    if found != expected {
        return Err(NetworkError::input(format!("a guess of {expected:?} numbers"), format!("{found:?}")));
    }
    let make = |Parameter { name, shape, spread }| {
        let mut random: ChaCha8Rng = Seeder::from((seed, &name)).into_rng();
        let normal =
            || spread as f32 * <StandardNormal as Distribution<f32>>::sample(&StandardNormal, &mut random);
        let mut values = vec![0.0_f32; shape.iter().product()];
        match name.as_str() {
            "maps.guess" => values.copy_from_slice(&guess.matrix),
            "maps.guess_bias" => values.copy_from_slice(&guess.bias),
            "modulation_bias" => {
                let gates = values.chunks_mut(config.width).skip(2).step_by(3).take(config.blocks.len());
                gates.for_each(|gate| gate.fill(FIRST_GATE));
            }
            _ if spread > 0.0 => values.fill_with(normal),
            _ => {}
        }
        Ok((name, Tensor::from_vec(values, shape, &Device::Cpu)?))
    };
    parameters(config).into_iter().map(make).collect()
}

/// Returns the sinusoidal encoding of noise levels, `[F, 64]`.
fn waves(sigmas: &[f32]) -> Result<Tensor> {
    let wave = |sigma: f32, wave: usize| {
        let angle = sigma * 0.5 * 200.0_f32.powf(wave as f32 / (WAVES - 1) as f32);
        [angle.sin(), angle.cos()]
    };
    let values: Vec<f32> = sigmas.iter().flat_map(|s| (0..WAVES).flat_map(move |w| wave(*s, w))).collect();
    Tensor::from_vec(values, (sigmas.len(), 2 * WAVES), &Device::Cpu)
}

impl Model {
    /// Creates a model that shares the given parameters.
    ///
    /// # Errors
    /// Returns an error if the configuration is inconsistent, or if parameters are missing or have other shapes.
    pub(crate) fn new(
        config: &NetworkConfig,
        statistics: &Statistics,
        parameters: BTreeMap<String, Tensor>,
    ) -> std::result::Result<Self, NetworkError> {
        config.check_with(statistics)?;
        for (name, shape) in shapes(config) {
            let found = parameters.get(&name).map_or(&[][..], Tensor::dims);
            if found != shape {
                return Err(NetworkError::input(format!("{name} of {shape:?}"), format!("{found:?}")));
            }
        }
        Ok(Self { config: config.clone(), priors: statistics.priors.clone(), parameters })
    }

    /// Returns the preconditioning factors for the noise levels of frames.
    pub(crate) fn levels<'a>(&'a self, sigmas: &'a [f32]) -> Levels<'a> {
        Levels::new(sigmas, &self.priors)
    }

    fn parameter(&self, name: &str) -> Result<&Tensor> {
        self.parameters.get(name).ok_or_else(|| candle_core::Error::Msg(format!("no parameter {name}")))
    }

    fn linear(&self, x: &Tensor, name: &str) -> Result<Tensor> {
        x.matmul(&self.parameter(name)?.t()?)
    }

    fn biased(&self, x: &Tensor, name: &str) -> Result<Tensor> {
        self.linear(x, name)?.broadcast_add(self.parameter(&format!("{name}_bias"))?)
    }

    /// Embeds the conditions of windows of `frames` frames each.
    pub(crate) fn take(&self, inputs: &Inputs, windows: usize, frames: usize) -> Result<EmbeddedConditions> {
        let grid = self.config.grid(windows, frames);
        let (d, patches) = (self.config.width, grid.height * grid.width);
        let tokens = (self.linear(&inputs.maps, "maps.in")? + self.linear(&inputs.rays, "rays.in")?)?
            .reshape((windows * frames * grid.views, patches, d))?
            .broadcast_add(self.parameter("place")?)?
            .reshape((windows, frames, grid.image_rows(), d))?
            .broadcast_add(&self.parameter("frame")?.narrow(0, 0, frames)?.reshape((1, frames, 1, d))?)?
            .reshape((grid.rows(), d))?;
        let guess = self.biased(&inputs.maps, "maps.guess")?;
        let ego = self.linear(&self.linear(&inputs.ego, "ego.a")?.silu()?, "ego.b")?;
        Ok(EmbeddedConditions { grid, tokens, guess, ego })
    }

    /// Returns the network's output for noisy latents `[R, C]` with noise `sigmas [B L]`: the error of the linear
    /// estimate, `[R, C]`, in the units of [`Levels`].
    pub(crate) fn answer(
        &self,
        noisy: &Tensor,
        sigmas: &[f32],
        taken: &EmbeddedConditions,
    ) -> Result<Tensor> {
        let (d, blocks) = (self.config.width, self.config.blocks.len());
        let level = self.biased(&waves(sigmas)?, "level.a")?.silu()?;
        let frame = (self.linear(&level, "level.b")? + &taken.ego)?.silu()?;
        let modulation = self.biased(&frame, "modulation")?;
        let part = |first: usize, count: usize| modulation.narrow(1, first * d, count * d)?.contiguous();
        // No gradient through the input: the guess is trained through the target output only.
        let shown = self.levels(sigmas).shown(noisy, &taken.guess.detach())?;
        let mut x = (self.linear(&shown, "latent.in")? + &taken.tokens)?;
        for (block, &attend) in self.config.blocks.iter().enumerate() {
            let normed = ops::norm_modulate(&x, &part(3 * block, 2)?)?;
            let wide = self.linear(&normed, &format!("block.{block:02}.in"))?;
            let mix = AttentionMlp {
                grid: taken.grid,
                attend,
                width: d,
                head: self.config.head,
                hidden: self.config.hidden,
            };
            let mixed = self.linear(&ops::mix(&wide, mix)?, &format!("block.{block:02}.out"))?;
            x = ops::gated_add(&x, &mixed, &part(3 * block + 2, 1)?)?;
        }
        self.linear(&ops::norm_modulate(&x, &part(3 * blocks, 2)?)?, "out")
    }

    /// Returns the velocity, `[R, C]`, of noisy latents `[R, C]` with noise `sigmas [B L]`.
    pub(crate) fn velocity(
        &self,
        noisy: &Tensor,
        sigmas: &[f32],
        taken: &EmbeddedConditions,
    ) -> Result<Tensor> {
        let answer = self.answer(noisy, sigmas, taken)?;
        let levels = self.levels(sigmas);
        levels.velocity(noisy, &levels.clean(noisy, &taken.guess, &answer)?)
    }
}

impl EmbeddedConditions {
    /// First guess of the latents, from the maps of each patch alone, `[R, C]`.
    pub(crate) fn guess(&self) -> &Tensor {
        &self.guess
    }
}
