//! Generated images of a simulation, made in a thread with a renderer of its own.
//!
//! # How it works
//! A simulation that begins with a generator starts a session: every `every` steps the committed state and
//! its forecasts go to the thread, which answers with the images of all cameras through the inputs of the
//! engine. In lockstep the simulation waits for the answer; beside it, a step that falls due while the thread
//! works is skipped and counted. The reference images at the beginning are always waited for, and until they
//! are there the log drives.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};
use std::time::Instant as Clock;

use point_skeleton::error::with_causes;
use point_skeleton::scene::{SceneState, SubstituteOptions};
use point_skeleton::{RenderOptions, Renderer};
use pskel_sim::rollout::{AnyError, ImageGenerator};
use pskel_sim::{Committed, Forecast, Instant, Simulation};

use crate::generated::{Generated, GeneratedHeader, Made, Mode};
use crate::hub::{Hub, Input};
use crate::inputs::{Inputs, LiveGenerator};
use crate::options::DriveOptions;

/// State that is to be generated.
pub(super) struct Job {
    session: u64,
    /// Number of frames before this one.
    frame: usize,
    step: usize,
    now: Committed<SceneState>,
    expected: Vec<Forecast<SceneState>>,
    substitutes: SubstituteOptions,
    actors_follow_log: bool,
}

/// The generator as the engine sees it.
pub(super) struct Generation<'a> {
    generator: Option<&'a LiveGenerator>,
    jobs: Sender<Job>,
    pub(super) mode: Mode,
    session: u64,
    /// Steps of the simulation from one frame to the next.
    every: usize,
    /// Number of frames that were asked for, with references.
    asked: usize,
    /// Number of frames that were answered.
    answered: usize,
    skipped: usize,
    latest: Option<Arc<Generated>>,
    failure: Option<String>,
}

impl<'a> Generation<'a> {
    pub(super) fn new(generator: Option<&'a LiveGenerator>, jobs: Sender<Job>) -> Self {
        Self {
            generator,
            jobs,
            mode: Mode::Off,
            session: 0,
            every: 1,
            asked: 0,
            answered: 0,
            skipped: 0,
            latest: None,
            failure: None,
        }
    }

    /// Returns the generator if images are generated.
    pub(super) fn running(&self) -> Option<&'a LiveGenerator> {
        self.generator.filter(|_| self.mode != Mode::Off)
    }

    /// Starts a session for a simulation of `hz` steps per second that begins.
    pub(super) fn restart(&mut self, hz: f64) {
        let every = self.generator.map_or(1.0, |generator| (hz / generator.hz).round().max(1.0));
        *self = Self {
            mode: self.mode,
            session: self.session + 1,
            every: every as usize,
            ..Self::new(self.generator, self.jobs.clone())
        };
    }

    /// Returns the number of the last session.
    pub(super) fn session(&self) -> u64 {
        self.session
    }

    /// Begins after the last session of another engine, whose answers may still come.
    pub(super) fn continue_after(&mut self, session: u64, mode: Mode) {
        (self.session, self.mode) = (session, mode);
    }

    /// Returns the number of steps from one frame to the next.
    pub(super) fn every(&self) -> usize {
        self.every
    }

    /// Returns the number of steps that plans reach ahead.
    pub(super) fn horizon(&self) -> usize {
        self.running().map_or(1, |generator| generator.window.max(generator.forecasts) * self.every)
    }

    /// Returns whether the log may give the wheel away at a step: a rollout of the same drive begins with all
    /// references, and its policy takes over at a planning step.
    pub(super) fn allows_takeover(&self, step: usize) -> bool {
        self.running().is_none_or(|generator| {
            step.is_multiple_of(self.every) && step >= (generator.window - 1) * self.every
        })
    }

    /// Returns the number of references that are still missing.
    pub(super) fn missing_references(&self) -> usize {
        self.running().map_or(0, |generator| (generator.window - 1).saturating_sub(self.answered))
    }

    /// Returns whether the simulation waits for a frame.
    pub(super) fn waits(&self) -> bool {
        let is_needed = self.mode == Mode::Lockstep || self.missing_references() > 0;
        self.running().is_some() && self.failure.is_none() && self.asked > self.answered && is_needed
    }

    /// Asks for the frame of the committed state, if one is due.
    pub(super) fn ask(
        &mut self,
        simulation: &Simulation<'_>,
        substitutes: impl FnOnce() -> SubstituteOptions,
        shown: impl Fn(&Instant) -> SceneState,
        actors_follow_log: bool,
    ) {
        let step = simulation.committed().get().step;
        let Some(generator) = self.running().filter(|_| self.failure.is_none()) else { return };
        if !step.is_multiple_of(self.every) {
            return;
        }
        if self.asked > self.answered {
            self.skipped += 1;
            return;
        }
        let expected = simulation.forecast_every(self.every, generator.forecasts).into_iter();
        let job = Job {
            session: self.session,
            frame: self.asked,
            step,
            now: simulation.committed().map(&shown),
            expected: expected.map(|next| next.map(|next| shown(&next))).collect(),
            substitutes: substitutes(),
            actors_follow_log,
        };
        self.asked += 1;
        if self.jobs.send(job).is_err() {
            self.failure = Some("the thread of the generator has ended".to_owned());
        }
    }

    /// Takes an answer. Returns whether it is of the rollout that runs.
    pub(super) fn take(&mut self, made: Made) -> bool {
        if made.session != self.session {
            return false;
        }
        self.answered += 1;
        match made.result {
            Ok(generated) => self.latest = Some(Arc::new(generated)),
            Err(text) => self.failure = Some(text),
        }
        true
    }

    /// Returns the newest images.
    pub(super) fn latest(&self) -> Option<Arc<Generated>> {
        self.running().and(self.latest.clone())
    }

    /// Returns what the page shows at a time, absolute microseconds.
    pub(super) fn header(&self, t_us: i64, first_us: i64) -> Option<GeneratedHeader> {
        let generator = self.running()?;
        let (latest, references) = (self.latest.as_deref(), generator.window - 1);
        Some(GeneratedHeader {
            mode: self.mode,
            step: latest.map(|latest| latest.step),
            t_s: latest.map(|latest| (latest.t_us - first_us) as f64 / 1e6),
            behind_s: latest.map(|latest| (t_us - latest.t_us) as f64 / 1e6),
            is_reference: latest.is_some_and(|latest| latest.images.is_reference),
            references: self.answered.min(references),
            count: self.answered.saturating_sub(references),
            skipped: self.skipped,
            network_s: latest.map(|latest| latest.seconds),
            is_waiting: self.waits(),
            failure: self.failure.clone(),
        })
    }
}

/// Generates until no more jobs can come; answers are inputs of the engine.
pub(super) fn work(inputs: &Inputs, options: &DriveOptions, jobs: &Receiver<Job>, hub: &Hub) {
    let Some(generator) = &inputs.generator else { return };
    let answer = |session: u64, result| hub.input(Input::Generated(Made { session, result }));
    let mut next = jobs.recv().ok();
    while let Some(job) = next.take() {
        let wanted = job.substitutes.clone();
        let made = wanted.make(&inputs.skeleton, inputs.log.name());
        let (substitutes, _) = match made {
            Ok(made) => made,
            Err(error) => {
                answer(job.session, Err(with_causes(&error)));
                next = jobs.recv().ok();
                continue;
            }
        };
        let render = RenderOptions {
            rasterizer: options.rasterizer.clone(),
            substitutes: &substitutes,
            log: Some(inputs.log.name()),
            ..RenderOptions::default()
        };
        let mut renderer = match Renderer::new(&inputs.skeleton, render) {
            Ok(renderer) => renderer,
            Err(error) => {
                answer(job.session, Err(with_causes(&error)));
                next = jobs.recv().ok();
                continue;
            }
        };
        let mut session = None;
        next = Some(job);
        while let Some(job) = next.take_if(|job| job.substitutes == wanted) {
            answer(job.session, generate(generator, inputs, &mut session, &job, &mut renderer));
            next = jobs.recv().ok();
        }
    }
}

/// Generates the frame of a job; opens its session first.
fn generate<'a>(
    generator: &LiveGenerator,
    inputs: &'a Inputs,
    session: &mut Option<(u64, Box<dyn ImageGenerator + 'a>)>,
    job: &Job,
    renderer: &mut Renderer<'_>,
) -> Result<Generated, String> {
    let start = Clock::now();
    let failed = |error: AnyError| with_causes(&*error);
    if session.as_ref().is_none_or(|(number, _)| *number != job.session) {
        *session = None; // ends its process first
        let opened = (generator.open)(inputs, job.actors_follow_log).map_err(failed)?;
        *session = Some((job.session, opened));
    }
    let Some((_, opened)) = session else { return Err("no session is open".to_owned()) };
    let now = job.now.as_ref();
    let images = opened.generate(job.frame, now, &job.expected, renderer).map_err(failed)?;
    let images = images.ok_or_else(|| format!("frame {} has no images", job.frame))?;
    Ok(Generated { step: job.step, t_us: job.now.get().t_us, images, seconds: start.elapsed().as_secs_f64() })
}
