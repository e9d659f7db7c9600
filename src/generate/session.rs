use std::time::Instant as Clock;

use image::RgbImage;

use super::{
    Cache, Codec, Conditioner, ConditionerError, Denoiser, DenoiserError, Drawn, FrameConditions,
    GaussianNoise, GenerateError, GenerateOptions, Generator, Latent, TrueImages, TrueImagesError,
};
use crate::geometry::{ImageSize, Pose};
use crate::raster::Rasterizer;
use crate::sim::{Committed, Instant, Simulation};

/// A network whose kind is known when the program runs.
pub type AnyDenoiser = Box<dyn Denoiser<Condition = FrameConditions>>;

/// What a [`Session`] is made of.
pub struct SessionParts<'a> {
    /// Draws what the network is fed.
    pub conditioner: Conditioner<'a>,
    /// Where the first images come from, and those to compare with.
    pub truth: TrueImages<'a>,
    /// Whether the ego follows the log all along.
    pub ego_follows_log: bool,
    /// Whether the actors do.
    pub actors_follow_log: bool,
    /// Between images and the network's latents.
    pub codec: Box<dyn Codec>,
    /// Size of the images.
    pub size: ImageSize,
    /// How frames are generated.
    pub options: GenerateOptions,
    /// What noise follows from.
    pub seed: u64,
}

/// The generator in a simulation: at each plan step it makes a frame of what was committed and what is expected. Its first
/// frames are references, the true images of the plan steps of the warm-up.
pub struct Session<'a> {
    parts: SessionParts<'a>,
    stage: Stage,
    /// Where the ego was at the plan step before.
    before: Option<Pose>,
    times: SessionTimes,
}

/// What the last frame took, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SessionTimes {
    /// Drawing what was committed, for the network.
    pub conditions_s: f64,
    /// Drawing what is expected.
    pub forecasts_s: f64,
    /// True images.
    pub truth_s: f64,
    /// The network's calls and what is between them.
    pub network_s: f64,
    /// Images of the latent.
    pub decode_s: f64,
}

enum Stage {
    /// References are collected.
    Warm { denoiser: AnyDenoiser, kept: Vec<(Latent, Committed<FrameConditions>)> },
    /// Frames are made.
    Going(Box<Generator<AnyDenoiser, GaussianNoise>>),
    /// A step failed half-way; a new session goes on.
    Failed,
}

/// Images of a plan step, a camera after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// Whether the images are the true ones, which the generator begins with.
    pub is_reference: bool,
    /// What the step looks like.
    pub images: Vec<RgbImage>,
    /// What it truly looks like, where that is known.
    pub truth: Option<Vec<RgbImage>>,
}

/// Why a session makes no frame.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// Drawing what the network is fed.
    #[error(transparent)]
    Conditions(#[from] ConditionerError),
    /// True images.
    #[error(transparent)]
    Truth(#[from] TrueImagesError),
    /// The codec.
    #[error(transparent)]
    Codec(#[from] DenoiserError),
    /// The loop or the network.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// A step before has failed.
    #[error("expected a generator that works, found one that has failed")]
    Failed,
    /// A rollout to go on with that lacks something.
    #[error("expected {expected} to go on with, found {found}")]
    Resume {
        /// What is needed.
        expected: String,
        /// What there is.
        found: String,
    },
}

impl SessionTimes {
    /// What a frame costs: all but the true images, which serve comparison alone.
    pub fn total_s(&self) -> f64 {
        self.conditions_s + self.forecasts_s + self.network_s + self.decode_s
    }
}

impl<'a> Session<'a> {
    /// Begins a rollout.
    ///
    /// # Errors
    /// Options that do not go together, or a codec whose latents the network does not take.
    pub fn new(parts: SessionParts<'a>, denoiser: AnyDenoiser) -> Result<Self, SessionError> {
        parts.options.check()?;
        let (takes, gives) = (denoiser.shape(), parts.codec.shape());
        if takes != gives {
            let expected = format!("a codec of latents of {takes}");
            return Err(DenoiserError::Input { expected, found: gives.to_string() }.into());
        }
        let stage = Stage::Warm { denoiser, kept: Vec::new() };
        Ok(Self { parts, stage, before: None, times: SessionTimes::default() })
    }

    /// Goes on with a rollout in which `frames` plan steps were made. `last` are the last of them, as many as the window has
    /// frames or all there are; the cache is what was left behind the last one, if the generator had begun.
    ///
    /// # Errors
    /// Another number of steps; a cache that is missing or of another frame; what [`Session::step`] may find.
    pub fn resume(
        mut self,
        frames: usize,
        last: &[Committed<Instant>],
        cache: Option<Cache>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Self, SessionError> {
        let wrong = |expected: String, found: String| SessionError::Resume { expected, found };
        let (references, window) = (self.parts.options.references(), self.parts.options.window);
        let needed = frames.min(window);
        if last.len() != needed {
            return Err(wrong(format!("the last {needed} plan steps"), last.len().to_string()));
        }
        let begun = frames > references;
        let first = usize::from(begun);
        self.before = last.first().filter(|_| begun).map(|before| before.get().ego.pose);
        let mut shown = Vec::new();
        for instant in &last[first..] {
            let drawn = self.draw(instant.as_ref(), rasterizer)?;
            if !begun {
                self.keep(&drawn)?;
            }
            shown.push(drawn.map(|drawn| drawn.conditions));
        }
        if !begun {
            return Ok(self);
        }
        let cache = cache.ok_or_else(|| wrong("the cache of the generator".to_owned(), "none".to_owned()))?;
        if cache.next != frames {
            let found = format!("one behind frame {}", cache.next);
            return Err(wrong(format!("a cache behind frame {frames}"), found));
        }
        let Stage::Warm { denoiser, .. } = std::mem::replace(&mut self.stage, Stage::Failed) else {
            return Err(SessionError::Failed);
        };
        let noise = GaussianNoise { seed: self.parts.seed };
        let generator = Generator::resume(denoiser, noise, self.parts.options, cache, shown)?;
        self.stage = Stage::Going(Box::new(generator));
        Ok(self)
    }

    /// Makes the frame of what was committed last; `None` between plan steps.
    ///
    /// # Errors
    /// What the device, the files of the log or the network do wrong.
    pub fn step(
        &mut self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Option<Made>, SessionError> {
        if !simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan()) {
            return Ok(None);
        }
        let mut clock = Clock::now();
        let mut times = SessionTimes::default();
        let drawn = self.draw(simulation.committed(), rasterizer)?;
        times.conditions_s = lap(&mut clock);
        let references = self.parts.options.references();
        if matches!(&self.stage, Stage::Warm { kept, .. } if kept.len() < references) {
            let images = self.keep(&drawn)?;
            times.truth_s = lap(&mut clock);
            self.times = times;
            let truth = self.has_truth().then(|| images.clone());
            return Ok(Some(Made { is_reference: true, images, truth }));
        }
        let truth = self.has_truth().then(|| self.truth(drawn.get())).transpose()?;
        times.truth_s = lap(&mut clock);
        let count = self.parts.options.forecasts();
        let forecasts = self.parts.conditioner.forecasts(simulation, count, rasterizer)?;
        times.forecasts_s = lap(&mut clock);
        let latent = self.generator()?.step(drawn.map(|drawn| drawn.conditions), &forecasts)?;
        times.network_s = lap(&mut clock);
        let images = self.parts.codec.decode(&latent)?;
        times.decode_s = lap(&mut clock);
        self.times = times;
        Ok(Some(Made { is_reference: false, images, truth }))
    }

    /// What the last frame took.
    pub fn times(&self) -> SessionTimes {
        self.times
    }

    /// What goes on to the next step, once frames are made.
    pub fn cache(&self) -> Option<&Cache> {
        match &self.stage {
            Stage::Going(generator) => Some(generator.cache()),
            Stage::Warm { .. } | Stage::Failed => None,
        }
    }

    /// Size of the images.
    pub fn size(&self) -> ImageSize {
        self.parts.size
    }

    /// Whether there are true images of every step.
    pub fn has_truth(&self) -> bool {
        let SessionParts { truth, ego_follows_log, actors_follow_log, .. } = &self.parts;
        truth.are_known(*ego_follows_log, *actors_follow_log)
    }

    fn draw(
        &mut self,
        instant: Committed<&Instant>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Committed<Drawn>, SessionError> {
        let pose = instant.get().ego.pose;
        let drawn = self.parts.conditioner.committed(instant, self.before, rasterizer)?;
        self.before = Some(pose);
        Ok(drawn)
    }

    /// Takes a step as a reference.
    fn keep(&mut self, drawn: &Committed<Drawn>) -> Result<Vec<RgbImage>, SessionError> {
        let images = self.truth(drawn.get())?;
        let latent = self.parts.codec.encode(&images)?;
        if let Stage::Warm { kept, .. } = &mut self.stage {
            kept.push((latent, drawn.clone().map(|drawn| drawn.conditions)));
        }
        Ok(images)
    }

    fn truth(&self, drawn: &Drawn) -> Result<Vec<RgbImage>, SessionError> {
        let SessionParts { truth, conditioner, size, actors_follow_log, .. } = &self.parts;
        let view = |view: &crate::geometry::View| conditioner.options().drawn_view(view);
        Ok(truth.of(&drawn.state, view, *size, *actors_follow_log)?)
    }

    /// The generator, which begins when the references are complete.
    fn generator(&mut self) -> Result<&mut Generator<AnyDenoiser, GaussianNoise>, SessionError> {
        if let Stage::Warm { .. } = self.stage
            && let Stage::Warm { denoiser, kept } = std::mem::replace(&mut self.stage, Stage::Failed)
        {
            let noise = GaussianNoise { seed: self.parts.seed };
            let generator = Generator::new(denoiser, noise, self.parts.options, kept)?;
            self.stage = Stage::Going(Box::new(generator));
        }
        match &mut self.stage {
            Stage::Going(generator) => Ok(generator),
            Stage::Warm { .. } | Stage::Failed => Err(SessionError::Failed),
        }
    }
}

/// Seconds since a moment; the moment becomes now.
fn lap(since: &mut Clock) -> f64 {
    let now = Clock::now();
    (now - std::mem::replace(since, now)).as_secs_f64()
}
