use std::time::Instant as Clock;

use image::RgbImage;
use point_skeleton::Renderer;
use point_skeleton::geometry::{ImageSize, Pose};
use point_skeleton::scene::{GroundTruthError, GroundTruthImages, SceneState};
use pskel_sim::report::images::StepImages;
use pskel_sim::rollout::{AnyError, GenerationTimes, ImageGenerator, lap};
use pskel_sim::{Committed, Forecast};

use crate::{
    Cache, Codec, Conditioner, ConditionerError, Denoiser, DenoiserError, FrameConditions, GaussianNoise,
    GenerateError, GenerateOptions, Generator, Latent, RenderedConditions,
};

/// A network whose type is chosen at run time.
pub type AnyDenoiser = Box<dyn Denoiser<Condition = FrameConditions> + Send>;

/// Components and options of a [`Session`].
pub struct SessionParts<'a> {
    /// Renders the network input.
    pub conditioner: Conditioner,
    /// Source of the reference images and of the ground truth for comparison; `None` if references are given
    /// by [`ImageGenerator::add_reference`].
    pub truth: Option<GroundTruthImages<'a>>,
    /// Whether the ego follows the log in the whole rollout.
    pub ego_follows_log: bool,
    /// Whether the actors follow the log in the whole rollout.
    pub actors_follow_log: bool,
    /// Codec between images and the network's latents.
    pub codec: Box<dyn Codec + Send>,
    /// Size of the images.
    pub size: ImageSize,
    /// Options of the generator.
    pub options: GenerateOptions,
    /// Seed of the noise.
    pub seed: u64,
}

/// A generator that runs with a simulation. At each planning step it generates a frame from the committed and
/// forecast states. The first frames are references: the ground-truth images of the first planning steps.
pub struct Session<'a> {
    parts: SessionParts<'a>,
    state: SessionState,
    /// Ego pose at the previous planning step.
    before: Option<Pose>,
    times: GenerationTimes,
}

enum SessionState {
    /// Collects references.
    Warm { denoiser: AnyDenoiser, retained: Vec<(Latent, Committed<FrameConditions>)> },
    /// Generates frames.
    Going(Box<Generator<AnyDenoiser, GaussianNoise>>),
    /// A step failed, so the state is inconsistent.
    Failed,
}

/// Error of generating a frame in a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// Error of rendering the network input.
    #[error(transparent)]
    Conditions(#[from] ConditionerError),
    /// Error of getting ground-truth images.
    #[error(transparent)]
    Truth(#[from] GroundTruthError),
    /// Error of the codec.
    #[error(transparent)]
    Codec(#[from] DenoiserError),
    /// Error of the generator or the network.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// A previous step failed.
    #[error("the generator failed in an earlier step: resume in a new session")]
    Failed,
    /// References are to be given, and some are missing.
    #[error("expected given references before the first generated frame, found none")]
    NoReferences,
    /// Too many references are given.
    #[error("expected {expected} references, found another one")]
    References {
        /// Number of references.
        expected: usize,
    },
    /// The rollout cannot be resumed because something is missing.
    #[error("cannot resume: expected {expected}, found {found}")]
    Resume {
        /// Needed input.
        expected: String,
        /// Given input.
        found: String,
    },
}

impl<'a> Session<'a> {
    /// Starts a rollout.
    ///
    /// # Errors
    /// Returns an error if the options are inconsistent, or if codec and network differ in latent shape.
    pub fn new(parts: SessionParts<'a>, denoiser: AnyDenoiser) -> Result<Self, SessionError> {
        parts.options.check()?;
        let (takes, gives) = (denoiser.shape(), parts.codec.shape());
        if takes != gives {
            let expected = format!("a codec of latents of {takes}");
            return Err(DenoiserError::Input { expected, found: gives.to_string() }.into());
        }
        let state = SessionState::Warm { denoiser, retained: Vec::new() };
        Ok(Self { parts, state, before: None, times: GenerationTimes::default() })
    }

    /// Resumes a rollout after `frames` planning steps, before the first call of [`Session::step`]. `last`
    /// are the last of these steps, as many as the window has frames or all if there are fewer. `cache` is
    /// the cache after the last step, if frames were generated already.
    ///
    /// # Errors
    /// Returns an error if the number of steps differs, or if the cache is missing or of another frame. Also
    /// returns the errors of [`Session::step`].
    pub fn resume(
        &mut self,
        frames: usize,
        last: &[Committed<SceneState>],
        cache: Option<Cache>,
        renderer: &mut Renderer<'_>,
    ) -> Result<(), SessionError> {
        let wrong = |expected: String, found: String| SessionError::Resume { expected, found };
        let (references, window) = (self.parts.options.references(), self.parts.options.window);
        let needed = frames.min(window);
        if last.len() != needed {
            return Err(wrong(format!("the last {needed} plan steps"), last.len().to_string()));
        }
        let begun = frames > references;
        let first = usize::from(begun);
        self.before = last.first().filter(|_| begun).map(|before| before.get().global_from_ego);
        let mut shown = Vec::new();
        for state in &last[first..] {
            let drawn = self.draw(state.as_ref(), renderer)?;
            if !begun {
                let images = self.truth(drawn.get())?;
                self.keep(&drawn, &images)?;
            }
            shown.push(drawn.map(|drawn| drawn.conditions));
        }
        if !begun {
            return Ok(());
        }
        let cache = cache.ok_or_else(|| wrong("the cache of the generator".to_owned(), "none".to_owned()))?;
        if cache.next != frames {
            let found = format!("one behind frame {}", cache.next);
            return Err(wrong(format!("a cache behind frame {frames}"), found));
        }
        let SessionState::Warm { denoiser, .. } = std::mem::replace(&mut self.state, SessionState::Failed)
        else {
            return Err(SessionError::Failed);
        };
        let noise = GaussianNoise { seed: self.parts.seed };
        let generator = Generator::resume(denoiser, noise, self.parts.options, cache, shown)?;
        self.state = SessionState::Going(Box::new(generator));
        Ok(())
    }

    /// Returns how many of the next planning steps the next frame is generated from, at most: none for a
    /// reference.
    pub fn forecasts(&self) -> usize {
        let SessionParts { options, .. } = &self.parts;
        if self.wants_references() { 0 } else { options.forecasts() }
    }

    /// Generates the frame of a committed planning step; `expected` are forecasts of the next ones.
    ///
    /// # Errors
    /// Returns an error if the device, the files of the log, the codec or the network fail. All further steps
    /// then fail; resume in a new session with [`Session::resume`].
    pub fn step(
        &mut self,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<StepImages, SessionError> {
        if matches!(self.state, SessionState::Failed) {
            return Err(SessionError::Failed);
        }
        let made = self.make(now, expected, renderer);
        if made.is_err() {
            self.state = SessionState::Failed;
        }
        made
    }

    fn make(
        &mut self,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<StepImages, SessionError> {
        let mut clock = Clock::now();
        let mut times = GenerationTimes::default();
        let drawn = self.draw(now.clone(), renderer)?;
        times.conditions_s = lap(&mut clock);
        if self.wants_references() {
            let images = self.truth(drawn.get())?;
            self.keep(&drawn, &images)?;
            times.truth_s = lap(&mut clock);
            self.times = times;
            let truth = self.has_truth().then(|| images.clone());
            return Ok(StepImages { is_reference: true, images, truth, rows: None });
        }
        let truth = self.has_truth().then(|| self.truth(drawn.get())).transpose()?;
        times.truth_s = lap(&mut clock);
        let expected = &expected[..expected.len().min(self.parts.options.forecasts())];
        let forecasts = self.parts.conditioner.forecasts(now, expected, renderer)?;
        times.forecasts_s = lap(&mut clock);
        let conditions = drawn.map(|drawn| drawn.conditions);
        let latent = self.generator()?.step(conditions.clone(), &forecasts)?;
        times.network_s = lap(&mut clock);
        let images = self.parts.codec.decode(&latent, conditions.get())?;
        times.decode_s = lap(&mut clock);
        self.times = times;
        Ok(StepImages { is_reference: false, images, truth, rows: None })
    }

    /// State for the next step, once frames are generated.
    pub fn cache(&self) -> Option<&Cache> {
        match &self.state {
            SessionState::Going(generator) => Some(generator.cache()),
            SessionState::Warm { .. } | SessionState::Failed => None,
        }
    }

    /// Returns whether every step has ground-truth images.
    pub fn has_truth(&self) -> bool {
        let SessionParts { truth, ego_follows_log, actors_follow_log, .. } = &self.parts;
        truth.is_some_and(|truth| truth.are_known(*ego_follows_log, *actors_follow_log))
    }

    fn draw(
        &mut self,
        state: Committed<&SceneState>,
        renderer: &mut Renderer<'_>,
    ) -> Result<Committed<RenderedConditions>, SessionError> {
        let pose = state.get().global_from_ego;
        let drawn = self.parts.conditioner.committed(state, self.before, renderer)?;
        self.before = Some(pose);
        Ok(drawn)
    }

    /// Returns whether references are missing.
    fn wants_references(&self) -> bool {
        let references = self.parts.options.references();
        matches!(&self.state, SessionState::Warm { retained, .. } if retained.len() < references)
    }

    /// Adds a step as a reference.
    fn keep(
        &mut self,
        drawn: &Committed<RenderedConditions>,
        images: &[RgbImage],
    ) -> Result<(), SessionError> {
        let latent = self.parts.codec.encode(images)?;
        if let SessionState::Warm { retained, .. } = &mut self.state {
            retained.push((latent, drawn.clone().map(|drawn| drawn.conditions)));
        }
        Ok(())
    }

    fn truth(&self, drawn: &RenderedConditions) -> Result<Vec<RgbImage>, SessionError> {
        let SessionParts { truth, conditioner, size, actors_follow_log, .. } = &self.parts;
        let view = |view: &point_skeleton::geometry::View| conditioner.options().drawn_view(view);
        let truth = truth.ok_or(SessionError::NoReferences)?;
        Ok(truth.of(&drawn.state, view, *size, *actors_follow_log)?)
    }

    /// Returns the generator; creates it when the references are complete.
    fn generator(&mut self) -> Result<&mut Generator<AnyDenoiser, GaussianNoise>, SessionError> {
        if let SessionState::Warm { .. } = self.state
            && let SessionState::Warm { denoiser, retained } =
                std::mem::replace(&mut self.state, SessionState::Failed)
        {
            let noise = GaussianNoise { seed: self.parts.seed };
            let generator = Generator::new(denoiser, noise, self.parts.options, retained)?;
            self.state = SessionState::Going(Box::new(generator));
        }
        match &mut self.state {
            SessionState::Going(generator) => Ok(generator),
            SessionState::Warm { .. } | SessionState::Failed => Err(SessionError::Failed),
        }
    }
}

impl ImageGenerator for Session<'_> {
    fn forecasts(&self) -> usize {
        self.forecasts()
    }

    fn generate(
        &mut self,
        _frame: usize,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<Option<StepImages>, AnyError> {
        Ok(Some(self.step(now, expected, renderer)?))
    }

    fn add_reference(
        &mut self,
        now: Committed<&SceneState>,
        images: Vec<RgbImage>,
        renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        if !self.wants_references() {
            return Err(SessionError::References { expected: self.parts.options.references() }.into());
        }
        let drawn = self.draw(now, renderer)?;
        Ok(self.keep(&drawn, &images)?)
    }

    fn times(&self) -> GenerationTimes {
        self.times
    }

    fn save(&self) -> Result<Option<Vec<u8>>, AnyError> {
        Ok(self.cache().map(Cache::to_bytes).transpose()?)
    }

    fn resume(
        &mut self,
        frames: usize,
        last: &[Committed<SceneState>],
        saved: Option<&[u8]>,
        renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        let cache = saved.map(Cache::from_bytes).transpose()?;
        Ok(self.resume(frames, last, cache, renderer)?)
    }

    fn window(&self) -> usize {
        self.parts.options.window
    }

    fn has_truth(&self) -> bool {
        self.has_truth()
    }
}

#[cfg(test)]
mod tests;
