use super::encoded::Encoded;
use super::images::{Images, Weights3x3};
use super::parameters::{Arrays, Module};
use crate::NetworkConfig;
use crate::inputs::{EGO, RAY};
use crate::kernels::{Attend, AttentionMlp, Grid, Linear, gated_add, norm_modulate, silu};
use crate::weights::config::{CELL, LATENT_CHANNELS};

/// Number of frequencies in the encoding of a noise level.
const WAVES: usize = 32;

/// Denoiser of latents. Rows are places: `[L V h w, C]`.
#[derive(Clone, Debug)]
pub(super) struct Denoiser {
    latent: Linear,
    conditions: Linear,
    tokens_in: Linear,
    tokens_out: Linear,
    rays: Linear,
    /// Embedding of a frame's place in the window, `[L, d]`.
    frame: Vec<f32>,
    level_a: Linear,
    level_b: Linear,
    ego_a: Linear,
    ego_b: Linear,
    first: Residual,
    blocks: Vec<Block>,
    last: Residual,
    out: Linear,
    modulation: Linear,
}

/// Two convolutions after a modulated norm, added with a gate.
#[derive(Clone, Debug)]
struct Residual {
    a: Weights3x3,
    b: Weights3x3,
}

/// Attention and a hidden layer in parallel.
#[derive(Clone, Debug)]
struct Block {
    attend: Attend,
    into: Linear,
    out: Linear,
}

/// Modulation of frames, `[L, columns]`, read from the front.
struct Modulations {
    columns: usize,
    values: Vec<f32>,
    next: usize,
}

impl Modulations {
    /// Returns the next columns of all frames, `[L, count]`.
    fn take(&mut self, count: usize) -> Vec<f32> {
        let first = self.next;
        self.next += count;
        self.values.chunks(self.columns).flat_map(|row| &row[first..first + count]).copied().collect()
    }

    /// Returns shifts and scales `[L, 2 d]`, and gates `[L, d]`.
    fn gated(&mut self, d: usize) -> (Vec<f32>, Vec<f32>) {
        (self.take(2 * d), self.take(d))
    }
}

impl Denoiser {
    pub(super) fn read<A: Arrays>(
        config: &NetworkConfig,
        mut module: Module<'_, A>,
    ) -> Result<Self, A::Error> {
        let NetworkConfig { width: d, hidden, frames, encoder: [_, _, c, _], .. } = *config;
        let mut blocks = Vec::with_capacity(config.blocks.len());
        for (number, attend) in config.blocks.iter().enumerate() {
            let mut block = module.part(&format!("blocks.{number}"));
            let into = block.linear("into", d, 3 * d + hidden)?;
            blocks.push(Block { attend: *attend, into, out: block.linear("out", d + hidden, d)? });
        }
        let mut residual = |name: &str| {
            let mut part = module.part(name);
            Ok(Residual { a: part.convolution("a", c, c)?, b: part.convolution("b", c, c)? })
        };
        let (first, last) = (residual("first")?, residual("last")?);
        let columns = 3 * d * blocks.len() + 8 * c;
        Ok(Self {
            latent: module.linear("latent", LATENT_CHANNELS, c)?,
            conditions: module.linear("conditions", c, c)?,
            tokens_in: module.linear("tokens_in", c, d)?,
            tokens_out: module.linear("tokens_out", d, c)?,
            rays: module.linear("rays", RAY, d)?,
            frame: module.array("frame", &[frames, d])?,
            level_a: module.biased("level_a", 2 * WAVES, d)?,
            level_b: module.linear("level_b", d, d)?,
            ego_a: module.linear("ego_a", EGO, d)?,
            ego_b: module.linear("ego_b", d, d)?,
            first,
            blocks,
            last,
            out: module.linear("out", c, LATENT_CHANNELS)?,
            modulation: module.biased("modulation", d, columns)?,
        })
    }

    /// Embeds the rays of tokens, `[R, 27]`.
    pub(super) fn rays(&self, rays: &[f32]) -> Vec<f32> {
        self.rays.forward(rays)
    }

    /// Embeds the ego motion.
    pub(super) fn ego(&self, ego: &[f32; EGO]) -> Vec<f32> {
        let mut hidden = self.ego_a.forward(ego);
        silu(&mut hidden);
        self.ego_b.forward(&hidden)
    }

    /// Returns the answer to noisy latents, `[L V h w, 3]`: the error of the linear estimate, in the units of
    /// [`Levels`](crate::Levels).
    pub(super) fn answer(
        &self,
        config: &NetworkConfig,
        shown: &[f32],
        sigmas: &[f32],
        frames: &[&Encoded],
    ) -> Vec<f32> {
        let (views, c) = (frames.first().map_or(0, |frame| frame.views), config.encoder[2]);
        let mut modulations = self.modulations(sigmas, frames);
        let features: Vec<f32> =
            frames.iter().flat_map(|frame| &frame.features.at16.values).copied().collect();
        let [height, width] = config.divided(CELL);
        let values = sum(&self.latent.forward(shown), &self.conditions.forward(&features));
        let x = Images { count: frames.len() * views, height, width, channels: c, values };
        let blocks: Vec<_> = self.blocks.iter().map(|_| modulations.gated(config.width)).collect();
        let (first, last) = (modulations.gated(c), modulations.gated(c));
        let x = self.first.of(&x, &first);
        let tokens = self.tokens_in.forward(&x.halved().values);
        let tokens = self.tokens(config, tokens, frames, &blocks);
        let added = Images { height: height / 2, width: width / 2, ..x.clone() };
        let added = added.with(c, self.tokens_out.forward(&tokens)).doubled();
        let x = self.last.of(&x.with(c, sum(&x.values, &added.values)), &last);
        self.out.forward(&norm_modulate(&x.values, &modulations.take(2 * c), c))
    }

    /// Returns the modulations of frames by their noise and ego motion.
    fn modulations(&self, sigmas: &[f32], frames: &[&Encoded]) -> Modulations {
        let mut level = self.level_a.forward(&waves(sigmas));
        silu(&mut level);
        let ego: Vec<f32> = frames.iter().flat_map(|frame| &frame.ego).copied().collect();
        let mut level = sum(&self.level_b.forward(&level), &ego);
        silu(&mut level);
        Modulations { columns: self.modulation.outputs, values: self.modulation.forward(&level), next: 0 }
    }

    /// Returns tokens `[R, d]` after all blocks. A block computes one attention and one hidden layer in
    /// parallel after a shared norm: `x + gate W_out [attention(q, k, v), gelu(hidden)]` with `[q, k, v,
    /// hidden] = W_in norm(x)`.
    fn tokens(
        &self,
        config: &NetworkConfig,
        mut x: Vec<f32>,
        frames: &[&Encoded],
        modulations: &[(Vec<f32>, Vec<f32>)],
    ) -> Vec<f32> {
        let NetworkConfig { width: d, head, hidden, .. } = *config;
        let grid: Grid = config.grid(frames.len(), frames.first().map_or(0, |frame| frame.views));
        for (number, (tokens, frame)) in x.chunks_mut(grid.image_rows() * d).zip(frames).enumerate() {
            let place = &self.frame[number * d..][..d];
            for (i, (value, ray)) in tokens.iter_mut().zip(&frame.rays).enumerate() {
                *value += ray + place[i % d];
            }
        }
        for (block, (modulation, gate)) in self.blocks.iter().zip(modulations) {
            let wide = block.into.forward(&norm_modulate(&x, modulation, d));
            let mixed = AttentionMlp { grid, attend: block.attend, width: d, head, hidden }.forward(&wide);
            x = gated_add(&x, &block.out.forward(&mixed), gate, d);
        }
        x
    }
}

impl Residual {
    fn of(&self, x: &Images, (modulation, gate): &(Vec<f32>, Vec<f32>)) -> Images {
        let normed = x.with(x.channels, norm_modulate(&x.values, modulation, x.channels));
        let added = normed.convolved(&self.a, true).convolved(&self.b, false);
        x.with(x.channels, gated_add(&x.values, &added.values, gate, x.channels))
    }
}

fn sum(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// Returns the sinusoidal encoding of noise levels, `[L, 64]`.
fn waves(sigmas: &[f32]) -> Vec<f32> {
    let wave = |sigma: f32, wave: usize| {
        let angle = sigma * 0.5 * 200.0_f32.powf(wave as f32 / (WAVES - 1) as f32);
        [angle.sin(), angle.cos()]
    };
    sigmas.iter().flat_map(|s| (0..WAVES).flat_map(move |w| wave(*s, w))).collect()
}
