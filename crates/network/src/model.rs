use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor};

use super::kernels::{AttentionMlp, Convolution, Grid, LANES, Resize};
use super::{Inputs, Levels, NetworkConfig, NetworkError, Statistics, ops, threads};
use crate::weights::config::LATENT_CHANNELS;
use crate::weights::parameters::{Modulations, WAVES, shapes};

/// The network. A convolutional encoder turns the conditions of a frame into features at four sizes, once per
/// frame. The denoiser works on latents at a quarter of the size, with attention within images, across
/// cameras and over time at an eighth. The decoder turns a finished latent and the features of its frame into
/// images. Rows of tensors are pixels: `[N H W, C]`. Sources: Ronneberger et al., "U-Net", 2015; Peebles and
/// Xie, "Scalable Diffusion Models with Transformers", 2023; Chen et al., "Diffusion Forcing", 2024 (a noise
/// level per frame).
#[derive(Clone, Debug)]
pub(crate) struct Model {
    config: NetworkConfig,
    statistics: Statistics,
    parameters: BTreeMap<String, Tensor>,
}

/// Encoded conditions of frames.
#[derive(Clone, Debug)]
pub(crate) struct EncodedConditions {
    /// What the denoiser takes.
    pub(crate) window: WindowConditions,
    /// Filled color, -0.5 to 0.5, `[F V H W, 3]`.
    color: Tensor,
    /// Features at the full size and at a half of it, for the decoder.
    full: Tensor,
    half: Tensor,
}

/// Encoded conditions of frames without those that only the decoder takes.
#[derive(Clone, Debug)]
pub(crate) struct WindowConditions {
    /// Number of cameras, V.
    views: usize,
    /// Features at a quarter of the size, `[F V h w, C]`.
    features: Tensor,
    /// First guess of the latents: the filled color, `[F V h w, 3]`.
    guess: Tensor,
    /// Embedded rays of tokens, `[F V R, d]`.
    rays: Tensor,
    /// Embedded ego motion, `[F, d]`.
    ego: Tensor,
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
    /// Returns an error if the configuration is inconsistent, or if parameters are missing or have other
    /// shapes.
    pub(crate) fn new(
        config: &NetworkConfig,
        statistics: &Statistics,
        parameters: BTreeMap<String, Tensor>,
    ) -> std::result::Result<Self, NetworkError> {
        config.check_with(statistics)?;
        threads::start()?;
        for (name, shape) in shapes(config) {
            let found = parameters.get(&name).map_or(&[][..], Tensor::dims);
            if found != shape {
                return Err(NetworkError::input(format!("{name} of {shape:?}"), format!("{found:?}")));
            }
        }
        Ok(Self { config: config.clone(), statistics: statistics.clone(), parameters })
    }

    /// Returns the preconditioning factors for the noise levels of frames.
    pub(crate) fn levels<'a>(&'a self, sigmas: &'a [f32]) -> Levels<'a> {
        Levels::new(sigmas, &self.statistics.priors)
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

    /// Convolution of images whose sides are divided by a number.
    fn convolve(&self, x: &Tensor, name: &str, by: usize, rectified: bool) -> Result<Tensor> {
        let ([height, width], weights) = (self.config.divided(by), self.parameter(name)?);
        let (channels, outputs) = (x.dims2()?.1, weights.dims2()?.1);
        let shape = Convolution { height, width, channels, outputs, rectified };
        ops::convolve(x, weights, self.parameter(&format!("{name}_bias"))?, shape)
    }

    /// Two rectified convolutions.
    fn stage(&self, x: &Tensor, name: &str, by: usize) -> Result<Tensor> {
        self.convolve(&self.convolve(x, &format!("{name}.a"), by, true)?, &format!("{name}.b"), by, true)
    }

    /// Halves images whose sides are divided by a number.
    fn downsample(&self, x: &Tensor, by: usize) -> Result<Tensor> {
        let [height, width] = self.config.divided(by);
        ops::downsample(x, Resize { height, width, channels: x.dims2()?.1 })
    }

    /// Doubles images to sides that are divided by a number.
    fn upsample(&self, x: &Tensor, by: usize) -> Result<Tensor> {
        let [height, width] = self.config.divided(by);
        ops::upsample(x, Resize { height, width, channels: x.dims2()?.1 })
    }

    /// Encodes the conditions of frames.
    pub(crate) fn encode(&self, inputs: &Inputs) -> Result<EncodedConditions> {
        let full = self.stage(&inputs.pixels, "encode.full", 1)?;
        let half = self.stage(&self.downsample(&full, 1)?, "encode.half", 2)?;
        let quarter = self.stage(&self.downsample(&half, 2)?, "encode.quarter", 4)?;
        let eighth = self.stage(&self.downsample(&quarter, 4)?, "encode.eighth", 8)?;
        let quarter =
            self.stage(&Tensor::cat(&[&self.upsample(&eighth, 4)?, &quarter], 1)?, "encode.up", 4)?;
        let of = |values: &[f32]| Tensor::from_slice(values, (1, LATENT_CHANNELS), &Device::Cpu);
        let centered = inputs.colors.broadcast_sub(&of(&self.statistics.means)?)?;
        let window = WindowConditions {
            views: inputs.views,
            features: quarter,
            guess: centered.broadcast_div(&of(&self.statistics.scales)?)?,
            rays: self.linear(&inputs.rays, "rays.in")?,
            ego: self.linear(&self.linear(&inputs.ego, "ego.a")?.silu()?, "ego.b")?,
        };
        Ok(EncodedConditions { window, color: inputs.pixels.narrow(1, 0, 3)?.contiguous()?, full, half })
    }

    /// Returns the images of finished latents `[F V h w, 3]`: colors from 0 to 1, slightly beyond at times,
    /// `[F V H W, 3]`.
    pub(crate) fn decode(&self, latents: &Tensor, encoded: &EncodedConditions) -> Result<Tensor> {
        let EncodedConditions { window, color, full, half } = encoded;
        let none =
            Tensor::zeros((latents.dims2()?.0, LANES - LATENT_CHANNELS), latents.dtype(), &Device::Cpu)?;
        let x = self.stage(&Tensor::cat(&[&window.features, latents, &none], 1)?, "decode.quarter", 4)?;
        let x = self.stage(&Tensor::cat(&[&self.upsample(&x, 2)?, half], 1)?, "decode.half", 2)?;
        let x = self.stage(&Tensor::cat(&[&self.upsample(&x, 1)?, full], 1)?, "decode.full", 1)?;
        (self.biased(&x, "decode.out")? + color)? + 0.5
    }

    /// Returns the network's output for noisy latents `[B L V h w, 3]` with noise `sigmas [B L]`: the error
    /// of the linear estimate, in the units of [`Levels`]. `encoded` has the frame conditions of `windows`
    /// windows.
    pub(crate) fn answer(
        &self,
        noisy: &Tensor,
        sigmas: &[f32],
        encoded: &WindowConditions,
        windows: usize,
    ) -> Result<Tensor> {
        let (frames, columns) = (sigmas.len() / windows, Modulations::new(&self.config));
        let level = self.biased(&waves(sigmas)?, "level.a")?.silu()?;
        let modulation = (self.linear(&level, "level.b")? + &encoded.ego)?.silu()?;
        let modulation = self.biased(&modulation, "modulation")?;
        let part = |first: usize, count: usize| modulation.narrow(1, first, count)?.contiguous();
        let quarter = self.config.channels[2];
        let residual = |x: &Tensor, name: &str, which: usize| {
            let first = columns.residual(which);
            let normed = ops::norm_modulate(x, &part(first, 2 * quarter)?)?;
            let hidden = self.convolve(&normed, &format!("{name}.a"), 4, true)?;
            let added = self.convolve(&hidden, &format!("{name}.b"), 4, false)?;
            ops::gated_add(x, &added, &part(first + 2 * quarter, quarter)?)
        };
        let shown = self.levels(sigmas).shown(noisy, &encoded.guess)?;
        let x = (self.linear(&shown, "latent.in")? + self.linear(&encoded.features, "conditions.in")?)?;
        let x = residual(&x, "denoise.first", 0)?;
        let grid = self.config.grid(windows, frames, encoded.views);
        let tokens = self.tokens(&self.downsample(&x, 4)?, encoded, grid, &part)?;
        let x = (&x + self.upsample(&self.linear(&tokens, "tokens.out")?, 4)?)?;
        let x = residual(&x, "denoise.last", 1)?;
        self.linear(&ops::norm_modulate(&x, &part(columns.output(), 2 * quarter)?)?, "out")
    }

    /// Returns tokens `[R, d]` after all blocks. A block computes one attention and one hidden layer in
    /// parallel after a shared norm: `x + gate W_out [attention(q, k, v), gelu(hidden)]` with `[q, k, v,
    /// hidden] = W_in norm(x)`.
    fn tokens(
        &self,
        x: &Tensor,
        encoded: &WindowConditions,
        grid: Grid,
        part: &impl Fn(usize, usize) -> Result<Tensor>,
    ) -> Result<Tensor> {
        let (d, columns) = (self.config.width, Modulations::new(&self.config));
        let frame = self.parameter("frame")?.narrow(0, 0, grid.frames)?.reshape((1, grid.frames, 1, d))?;
        let mut x = (self.linear(x, "tokens.in")? + &encoded.rays)?
            .reshape((grid.windows, grid.frames, grid.image_rows(), d))?
            .broadcast_add(&frame)?
            .reshape((grid.rows(), d))?;
        for (block, &attend) in self.config.blocks.iter().enumerate() {
            let first = columns.block(block);
            let normed = ops::norm_modulate(&x, &part(first, 2 * d)?)?;
            let wide = self.linear(&normed, &format!("block.{block:02}.in"))?;
            let (head, hidden) = (self.config.head, self.config.hidden);
            let mixed = ops::mix(&wide, AttentionMlp { grid, attend, width: d, head, hidden })?;
            let mixed = self.linear(&mixed, &format!("block.{block:02}.out"))?;
            x = ops::gated_add(&x, &mixed, &part(first + 2 * d, d)?)?;
        }
        Ok(x)
    }

    /// Returns the velocity of noisy latents of a window, `[L V h w, 3]`, with noise `sigmas [L]`.
    pub(crate) fn velocity(
        &self,
        noisy: &Tensor,
        sigmas: &[f32],
        encoded: &WindowConditions,
    ) -> Result<Tensor> {
        let answer = self.answer(noisy, sigmas, encoded, 1)?;
        let levels = self.levels(sigmas);
        levels.velocity(noisy, &levels.clean(noisy, &encoded.guess, &answer)?)
    }
}

impl WindowConditions {
    /// First guess of the latents, `[F V h w, 3]`.
    pub(crate) fn guess(&self) -> &Tensor {
        &self.guess
    }

    /// Joins the conditions of frames with the same number of cameras.
    pub(crate) fn joined(frames: &[&Self]) -> Result<Self> {
        let join = |of: fn(&Self) -> &Tensor| {
            Tensor::cat(&frames.iter().map(|frame| of(frame)).collect::<Vec<_>>(), 0)
        };
        Ok(Self {
            views: frames.first().map_or(0, |frame| frame.views),
            features: join(|frame| &frame.features)?,
            guess: join(|frame| &frame.guess)?,
            rays: join(|frame| &frame.rays)?,
            ego: join(|frame| &frame.ego)?,
        })
    }
}

impl EncodedConditions {
    /// Returns the conditions of one frame in `frames`.
    pub(crate) fn frame(&self, frame: usize, frames: usize) -> Result<Self> {
        let part = |all: &Tensor| {
            let rows = all.dims2()?.0 / frames;
            all.narrow(0, frame * rows, rows)
        };
        let WindowConditions { views, features, guess, rays, ego } = &self.window;
        let (features, guess) = (part(features)?, part(guess)?);
        let window = WindowConditions { views: *views, features, guess, rays: part(rays)?, ego: part(ego)? };
        Ok(Self { window, color: part(&self.color)?, full: part(&self.full)?, half: part(&self.half)? })
    }
}
