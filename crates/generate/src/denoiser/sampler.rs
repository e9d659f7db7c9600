use serde::{Deserialize, Serialize};

use point_skeleton::named::Named;

use super::schedule::{Ddim, FlowMatch, Prediction, TRAIN_STEPS};
use crate::Latent;

/// Noise schedule and denoising update.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SamplerOptions {
    /// Euler steps along the velocity `noise - clean`.
    FlowMatch {
        /// Shift towards the noise: 3 for Stable Diffusion 3.5, 1 for evenly spaced levels.
        shift: f64,
    },
    /// DDIM, see [`Ddim`].
    Ddim {
        /// Quantity that the network predicts.
        prediction: Prediction,
    },
}

/// Noise level of a frame, as passed to a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Timestep, 0 (clean) to 1000.
    pub timestep: f32,
    /// Standard deviation of the noise in the frame, 0 to 1.
    pub sigma: f32,
}

/// Noise schedule for a number of inference steps, with its denoising update.
#[derive(Clone, Debug)]
pub struct Sampler {
    steps: usize,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    FlowMatch(FlowMatch),
    Ddim(Ddim, Prediction),
}

impl Default for SamplerOptions {
    /// Flow matching with the shift of Stable Diffusion 3.5's scheduler.
    fn default() -> Self {
        Self::FlowMatch { shift: 3.0 }
    }
}

impl Named for SamplerOptions {
    const KIND: &'static str = "sampler";
    const ALL: &'static [Self] = &[
        Self::FlowMatch { shift: 3.0 },
        Self::Ddim { prediction: Prediction::Epsilon },
        Self::Ddim { prediction: Prediction::Sample },
        Self::Ddim { prediction: Prediction::Velocity },
    ];

    fn name(self) -> &'static str {
        match self {
            Self::FlowMatch { .. } => "flow_match",
            Self::Ddim { prediction: Prediction::Epsilon } => "ddim_epsilon",
            Self::Ddim { prediction: Prediction::Sample } => "ddim_sample",
            Self::Ddim { prediction: Prediction::Velocity } => "ddim_velocity",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::FlowMatch { .. } => "Velocities of flow matching, shift 3",
            Self::Ddim { prediction: Prediction::Epsilon } => "Noise, with DDIM",
            Self::Ddim { prediction: Prediction::Sample } => "Clean frames, with DDIM",
            Self::Ddim { prediction: Prediction::Velocity } => "Velocities, with DDIM",
        }
    }
}

impl Sampler {
    /// Creates a schedule of `steps` inference steps, 1 to 1000.
    pub fn new(options: SamplerOptions, steps: usize) -> Self {
        let kind = match options {
            SamplerOptions::FlowMatch { shift } => Kind::FlowMatch(FlowMatch::new(steps, shift)),
            SamplerOptions::Ddim { prediction } => Kind::Ddim(Ddim::new(steps), prediction),
        };
        Self { steps, kind }
    }

    /// Number of inference steps, T.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Returns the noise level before inference step `index`.
    pub fn level(&self, index: usize) -> Level {
        match &self.kind {
            Kind::FlowMatch(table) => {
                Level { timestep: table.timesteps()[index], sigma: table.sigmas()[index] }
            }
            Kind::Ddim(table, _) => {
                let timestep = table.timesteps()[index];
                Level { timestep: timestep as f32, sigma: (1.0 - table.alpha(timestep)).sqrt() as f32 }
            }
        }
    }

    /// Returns the noise level at a training timestep, out of 1000.
    pub fn level_at(&self, timestep: usize) -> Level {
        let sigma = match &self.kind {
            Kind::FlowMatch(_) => timestep as f64 / TRAIN_STEPS as f64,
            Kind::Ddim(table, _) => (1.0 - table.alpha(timestep)).sqrt(),
        };
        Level { timestep: timestep as f32, sigma: sigma as f32 }
    }

    /// Adds noise to a clean frame.
    pub fn noised(&self, clean: &Latent, noise: &Latent, level: Level) -> Latent {
        let sigma = level.sigma;
        let share = match self.kind {
            Kind::FlowMatch(_) => 1.0 - sigma,
            Kind::Ddim(..) => (1.0 - sigma * sigma).max(0.0).sqrt(),
        };
        clean.zip(noise, |clean, noise| share * clean + sigma * noise)
    }

    /// Returns the frame after inference step `index`.
    pub fn step(&self, index: usize, x: &Latent, prediction: &Latent) -> Latent {
        match &self.kind {
            Kind::FlowMatch(table) => {
                let change = table.sigmas()[index + 1] - table.sigmas()[index];
                x.zip(prediction, |x, v| x + change * v)
            }
            Kind::Ddim(table, kind) => {
                x.zip(prediction, |x, model| table.step(*kind, index, f64::from(x), f64::from(model)) as f32)
            }
        }
    }
}
