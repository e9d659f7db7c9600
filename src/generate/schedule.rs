use serde::{Deserialize, Serialize};

/// Steps that diffusion is trained on.
pub(super) const TRAIN_STEPS: usize = 1000;

/// Noise levels of flow matching, `x = (1 - sigma) clean + sigma noise`, as the Euler flow-match scheduler of Stable
/// Diffusion 3 has them: spaced evenly in time, then shifted towards the noise. Source: diffusers,
/// `FlowMatchEulerDiscreteScheduler`.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowMatch {
    sigmas: Vec<f32>,
    timesteps: Vec<f32>,
}

impl FlowMatch {
    /// A schedule of some inference steps. `shift` is 3 for Stable Diffusion 3.5, 1 is none.
    pub fn new(steps: usize, shift: f64) -> Self {
        let shifted = |sigma: f64| shift * sigma / (1.0 + (shift - 1.0) * sigma);
        let train = TRAIN_STEPS as f64;
        // From the least noise of training to the most, both shifted, and shifted once more.
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

    /// Share of noise before each step, and 0 after the last: one more than steps.
    pub fn sigmas(&self) -> &[f32] {
        &self.sigmas
    }

    /// The same times 1000, without the 0.
    pub fn timesteps(&self) -> &[f32] {
        &self.timesteps
    }
}

/// What a network of a DDIM schedule predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prediction {
    /// The noise.
    #[default]
    Epsilon,
    /// What is under it.
    Sample,
    /// `sqrt(a) noise - sqrt(1 - a) clean`.
    Velocity,
}

/// Denoising diffusion implicit models without noise of their own (eta 0), on betas whose roots are spaced evenly from
/// 0.00085 to 0.012, as Stable Diffusion has them. Source: diffusers, `DDIMScheduler` with `steps_offset` 1 and
/// `set_alpha_to_one` off.
#[derive(Clone, Debug, PartialEq)]
pub struct Ddim {
    /// By training step.
    alphas: Vec<f64>,
    timesteps: Vec<usize>,
}

impl Ddim {
    const BETAS: [f64; 2] = [0.00085, 0.012];
    const OFFSET: usize = 1;

    /// A schedule of some inference steps, at most 1000.
    pub fn new(steps: usize) -> Self {
        // In single precision where PyTorch is: what is left of noise at the last steps depends on its rounding.
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

    /// Training step that each inference step stands at, falling.
    pub fn timesteps(&self) -> &[usize] {
        &self.timesteps
    }

    /// Share of the clean picture's variance at a training step, the product of `1 - beta`.
    pub fn alpha(&self, timestep: usize) -> f64 {
        self.alphas[timestep.min(TRAIN_STEPS - 1)]
    }

    /// Before an inference step and after it. After the last the first training step's stands.
    fn alphas_of(&self, index: usize) -> [f64; 2] {
        let timestep = self.timesteps[index];
        let after = timestep.saturating_sub(TRAIN_STEPS / self.timesteps.len());
        [self.alpha(timestep), self.alpha(after)]
    }

    /// A value after an inference step.
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
