pub(super) mod cache;
pub(super) mod rolling;
pub(super) mod scene;
pub(super) mod session;
pub(super) mod strategy;
pub(super) mod window;

use std::collections::VecDeque;

use pskel_sim::{Committed, Forecast};

use self::rolling::StepInputs;
use super::{Cache, Denoiser, GenerateError, GenerateOptions, Latent, NoiseSource, Sampler};

/// Generates frames one after the other. Frames are numbered from the first reference: the references are
/// `0 .. L-1`, the first generated frame is `L-1`.
pub struct Generator<D: Denoiser, N> {
    denoiser: D,
    noise: N,
    options: GenerateOptions,
    sampler: Sampler,
    cache: Cache,
    /// Conditions of the last L-1 frames.
    shown: VecDeque<Committed<D::Condition>>,
}

impl<D: Denoiser, N: NoiseSource> Generator<D, N> {
    /// Creates a generator from reference latents, oldest first, each with its committed conditions.
    ///
    /// # Errors
    /// Returns an error if the options are inconsistent, if there are not [`GenerateOptions::references`]
    /// references, or if one has another shape.
    pub fn new(
        denoiser: D,
        noise: N,
        options: GenerateOptions,
        references: Vec<(Latent, Committed<D::Condition>)>,
    ) -> Result<Self, GenerateError> {
        options.check()?;
        let (frames, shown): (Vec<_>, Vec<_>) = references.into_iter().unzip();
        let count = options.references();
        let cache = Cache { next: count, frames, references: count, in_place: 0 };
        Self::resume(denoiser, noise, options, cache, shown)
    }

    /// Resumes from a cache and the committed conditions of the last L-1 frames.
    ///
    /// # Errors
    /// Returns the errors of [`Generator::new`], or an error if a generator with these options cannot have
    /// produced the cache.
    pub fn resume(
        denoiser: D,
        noise: N,
        options: GenerateOptions,
        cache: Cache,
        shown: Vec<Committed<D::Condition>>,
    ) -> Result<Self, GenerateError> {
        options.check()?;
        let count = options.references();
        cache.check(&options, denoiser.shape())?;
        if shown.len() != count {
            let expected = format!("the conditions of {count} frames");
            return Err(GenerateError::Options { expected, found: shown.len().to_string() });
        }
        let sampler = Sampler::new(options.sampler, options.steps);
        Ok(Self { denoiser, noise, options, sampler, cache, shown: shown.into() })
    }

    /// State for the next step.
    pub fn cache(&self) -> &Cache {
        &self.cache
    }

    /// Network that the generator calls.
    pub fn denoiser(&self) -> &D {
        &self.denoiser
    }

    /// Generates the next frame. Fewer forecasts than [`GenerateOptions::forecasts`] mean that the conditions
    /// end there: the window then stays in place.
    ///
    /// # Errors
    /// Returns an error if the network fails, or, with [`Strategy::Rolling`](crate::Strategy::Rolling), if
    /// the forecasts end before the last frame of the window. The cache is then unchanged.
    pub fn step(
        &mut self,
        now: Committed<D::Condition>,
        forecasts: &[Forecast<D::Condition>],
    ) -> Result<Latent, GenerateError> {
        let frame = self.cache.next;
        let used = forecasts.len().min(self.options.forecasts());
        rolling::check(&self.options, &self.cache, used)?;
        let mut cache = self.cache.clone();
        let finished = {
            let committed = self.shown.iter().chain([&now]).map(Committed::get);
            let mut known = StepInputs {
                denoiser: &mut self.denoiser,
                noise: &mut self.noise,
                options: &self.options,
                sampler: &self.sampler,
                first: frame - self.shown.len(),
                conditions: committed.chain(forecasts[..used].iter().map(Forecast::get)).collect(),
                forecasts: used,
            };
            rolling::step(&mut known, &mut cache)
        };
        let finished = finished.map_err(|source| GenerateError::Denoiser { frame, source })?;
        self.cache = Cache { next: frame + 1, ..cache };
        self.shown.pop_front();
        self.shown.push_back(now);
        Ok(finished)
    }
}
