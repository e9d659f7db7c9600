//! Inputs of generator runs: synthetic latents, and conditions committed by a simulation.

use pskel_generate::{
    Cache, Condition, Denoiser, GaussianNoise, GenerateOptions, Generator, Guidance, Latent, LatentShape,
    NoiseSource, SamplerOptions, Strategy,
};
use pskel_sim::{Committed, EgoPolicy, Forecast, SimOptions};

use crate::winding_road;

pub const SHAPE: LatentShape = LatentShape { views: 2, channels: 3, height: 2, width: 2 };

/// Wraps conditions as committed by a simulation, the only source of committed conditions.
pub fn committed<C: Clone>(conditions: &[C]) -> Vec<Committed<C>> {
    let log = winding_road::log(8);
    let options = SimOptions { steps: conditions.len(), ego: EgoPolicy::Replay, ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    let mut all = Vec::new();
    while all.len() < conditions.len() {
        all.push(sim.committed().map(|instant| conditions[instant.step].clone()));
        assert!(sim.step().unwrap().is_some());
    }
    all
}

/// Returns a latent generated from a seed.
pub fn made_up(seed: u64, number: usize) -> Latent {
    GaussianNoise { seed }.noise(SHAPE, number, 0)
}

pub fn made_ups(seed: u64, count: usize) -> Vec<Latent> {
    (0..count).map(|number| made_up(seed, number)).collect()
}

pub fn forecasts<C: Clone>(conditions: &[C]) -> Vec<Forecast<C>> {
    conditions.iter().cloned().map(Forecast::new).collect()
}

pub fn options(strategy: Strategy) -> GenerateOptions {
    GenerateOptions {
        window: 4,
        steps: 8,
        clean: 0,
        strategy,
        sampler: SamplerOptions::default(),
        guidance: Guidance::default(),
    }
}

/// Inputs of a generator run.
pub struct GeneratorInputs<C = Latent> {
    pub references: Vec<Latent>,
    pub committed: Vec<Committed<C>>,
    /// Forecasts for each generated frame.
    pub forecasts: Vec<Vec<Forecast<C>>>,
}

impl GeneratorInputs {
    /// References and twelve frames; the last four have no forecasts.
    pub fn new(options: &GenerateOptions) -> Self {
        let count = options.references();
        let mut drive = Self::of(options, made_ups(8, count), &made_ups(7, count + 12));
        for (frame, ahead) in drive.forecasts.iter_mut().enumerate() {
            ahead.truncate(7_usize.saturating_sub(frame));
        }
        drive
    }
}

impl<C: Condition> GeneratorInputs<C> {
    /// Inputs whose forecasts equal the later conditions.
    pub fn of(options: &GenerateOptions, references: Vec<Latent>, conditions: &[C]) -> Self {
        let ahead = |frame: usize| {
            let end = (frame + 1 + options.forecasts()).min(conditions.len());
            forecasts(&conditions[frame + 1..end])
        };
        let forecasts = (references.len()..conditions.len()).map(ahead).collect();
        Self { references, forecasts, committed: committed(conditions) }
    }

    pub fn generator<D: Denoiser<Condition = C>, N: NoiseSource>(
        &self,
        denoiser: D,
        noise: N,
        options: GenerateOptions,
    ) -> Generator<D, N> {
        let references = self.references.iter().cloned().zip(self.committed.iter().cloned()).collect();
        Generator::new(denoiser, noise, options, references).unwrap()
    }

    /// Returns the generated frames, and the cache after each.
    pub fn run<D: Denoiser<Condition = C>, N: NoiseSource>(
        &self,
        generator: &mut Generator<D, N>,
    ) -> (Vec<Latent>, Vec<Cache>) {
        let first = generator.cache().next;
        let step = |frame: usize| {
            let forecasts = &self.forecasts[frame - self.references.len()];
            let latent = generator.step(self.committed[frame].clone(), forecasts).unwrap();
            (latent, generator.cache().clone())
        };
        (first..self.committed.len()).map(step).unzip()
    }
}
