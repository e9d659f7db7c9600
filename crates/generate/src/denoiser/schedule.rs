use serde::{Deserialize, Serialize};

/// Number of timesteps in diffusion training.
pub(crate) const TRAIN_STEPS: usize = 1000;

/// Noise levels of flow matching, `x = (1 - sigma) clean + sigma noise`: evenly spaced in time, then shifted
/// towards the noise, as in the Euler flow-match scheduler of Stable Diffusion 3. Source: diffusers,
/// `FlowMatchEulerDiscreteScheduler`.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowMatch {
    sigmas: Vec<f32>,
    timesteps: Vec<f32>,
}

impl FlowMatch {
    /// Creates a schedule of `steps` inference steps. `shift` is 3 for Stable Diffusion 3.5; 1 means no
    /// shift.
    pub fn new(steps: usize, shift: f64) -> Self {
        let shifted = |sigma: f64| shift * sigma / (1.0 + (shift - 1.0) * sigma);
        let train = TRAIN_STEPS as f64;
        // As in diffusers, the range from the highest to the lowest training sigma is shifted, and every
        // level again.
        let [first, last] = [1.0, shifted(1.0 / train)].map(|sigma| sigma * train);
        let sigma = |i: usize| {
            let time = first + (last - first) * i as f64 / (steps.max(2) - 1) as f64;
            shifted(time / train) as f32
        };
        let mut sigmas: Vec<f32> = (0..steps).map(sigma).collect();
        let timesteps = sigmas.iter().map(|sigma| sigma * TRAIN_STEPS as f32).collect();
        sigmas.push(0.0);
        Self { sigmas, timesteps }
    }

    /// Share of noise before each step, then 0 after the last: `steps + 1` values.
    pub fn sigmas(&self) -> &[f32] {
        &self.sigmas
    }

    /// Timesteps of the steps: `sigmas` times 1000, without the final 0.
    pub fn timesteps(&self) -> &[f32] {
        &self.timesteps
    }
}

/// Quantity predicted by a network with a DDIM schedule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prediction {
    /// The noise.
    #[default]
    Epsilon,
    /// The clean latent.
    Sample,
    /// `sqrt(a) noise - sqrt(1 - a) clean`.
    Velocity,
}

/// Deterministic denoising diffusion implicit models (DDIM, eta 0). The square roots of the betas are evenly
/// spaced from 0.00085 to 0.012, as in Stable Diffusion. Source: diffusers, `DDIMScheduler` with
/// `steps_offset` 1 and `set_alpha_to_one` off.
#[derive(Clone, Debug, PartialEq)]
pub struct Ddim {
    /// Cumulative products of `1 - beta`, by training timestep.
    alphas: Vec<f64>,
    timesteps: Vec<usize>,
}

impl Ddim {
    const BETAS: [f64; 2] = [0.00085, 0.012];
    const OFFSET: usize = 1;

    /// Creates a schedule of `steps` inference steps, at most 1000.
    pub fn new(steps: usize) -> Self {
        // Single precision where PyTorch uses it: the residual noise of the last steps depends on its
        // rounding.
        let [low, high] = Self::BETAS.map(|beta| beta.sqrt() as f32);
        let step = (high - low) / (TRAIN_STEPS - 1) as f32;
        let root = |i: usize| match i < TRAIN_STEPS / 2 {
            true => low + step * i as f32,
            false => high - step * (TRAIN_STEPS - 1 - i) as f32,
        };
        let product = |all: &mut f64, i: usize| {
            *all *= f64::from(1.0 - root(i) * root(i));
            Some(f64::from(*all as f32))
        };
        let alphas: Vec<f64> = (0..TRAIN_STEPS).scan(1.0, product).collect();
        let ratio = TRAIN_STEPS / steps.max(1);
        let timestep = |i: usize| (i * ratio + Self::OFFSET).min(TRAIN_STEPS - 1);
        Self { alphas, timesteps: (0..steps).rev().map(timestep).collect() }
    }

    /// Training timestep of each inference step, descending.
    pub fn timesteps(&self) -> &[usize] {
        &self.timesteps
    }

    /// Share of the clean image's variance at a training timestep, the cumulative product of `1 - beta`.
    pub fn alpha(&self, timestep: usize) -> f64 {
        self.alphas[timestep.min(TRAIN_STEPS - 1)]
    }

    /// Returns alpha before and after an inference step. After the last step, the first training timestep
    /// applies.
    fn alphas_of(&self, index: usize) -> [f64; 2] {
        let timestep = self.timesteps[index];
        let after = timestep.saturating_sub(TRAIN_STEPS / self.timesteps.len());
        [self.alpha(timestep), self.alpha(after)]
    }

    /// Returns a value after an inference step.
    pub fn step(&self, prediction: Prediction, index: usize, x: f64, model: f64) -> f64 {
        let [before, after] = self.alphas_of(index);
        let (a, b) = (before.sqrt(), (1.0 - before).sqrt());
        let (clean, noise) = match prediction {
            Prediction::Epsilon => ((x - b * model) / a, model),
            Prediction::Sample => (model, (x - a * model) / b),
            Prediction::Velocity => (a * x - b * model, a * model + b * x),
        };
        after.sqrt() * clean + (1.0 - after).sqrt() * noise
    }
}
