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
    /// A step failed half-way: what is here is neither as before it nor as behind it.
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
    /// What the device, the files of the log or the network do wrong. After that no step is made any more: a new session
    /// goes on, by [`Session::resume`].
    pub fn step(
        &mut self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Option<Made>, SessionError> {
        if matches!(self.stage, Stage::Failed) {
            return Err(SessionError::Failed);
        }
        if !simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan()) {
            return Ok(None);
        }
        let made = self.make(simulation, rasterizer);
        if made.is_err() {
            self.stage = Stage::Failed;
        }
        made.map(Some)
    }

    fn make(
        &mut self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Made, SessionError> {
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
            return Ok(Made { is_reference: true, images, truth });
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
        Ok(Made { is_reference: false, images, truth })
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

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::path::{Path, PathBuf};

    use glam::{DMat3, DVec3};

    use super::*;
    use crate::dataset::{
        Dataset, DatasetError, Frame as LogFrame, ImageRecord, Log, LogFormat, RigCamera, Sweep, SweepRecord,
    };
    use crate::error::FileError;
    use crate::generate::{Frame, Guidance, LatentShape, PixelCodec, Recipe, SamplerOptions, Strategy};
    use crate::geometry::Camera;
    use crate::raster::{self, RasterizerDesc, RasterizerKind};
    use crate::scene::Stage as Clouds;
    use crate::sim::{Scenario, SimOptions};
    use crate::skeleton::{BuildOptions, BuildReport, Skeleton, SkeletonWriter};

    const SIZE: ImageSize = ImageSize { height: 4, width: 8 };
    const SHAPE: LatentShape = LatentShape { views: 1, channels: 12, height: 2, width: 4 };

    /// A second at 10 frames a second, grey.
    struct Grey(Log);

    impl Grey {
        fn new() -> Self {
            let intrinsics = DMat3::from_cols(DVec3::X * 8.0, DVec3::Y * 8.0, DVec3::new(8.0, 4.0, 1.0));
            let camera =
                Camera { name: "c".parse().unwrap(), width: 16, height: 8, intrinsics, distortion: None };
            let frame = |i: i64| {
                let (t_us, global_from_ego) = (i * 100_000, Pose::from_yaw(0.0, DVec3::X * i as f64));
                let image = ImageRecord {
                    channel: 0,
                    path: PathBuf::new(),
                    t_us,
                    global_from_ego,
                    ego_from_camera: Pose::IDENTITY,
                    camera: camera.clone(),
                };
                let (sweeps, between_images, boxes) = Default::default();
                LogFrame { t_us, global_from_ego, sweeps, images: vec![image], between_images, boxes }
            };
            let frames: Vec<LogFrame> = (0..=10).map(frame).collect();
            let rig = RigCamera::first_used(&frames);
            Self(Log {
                name: "grey".into(),
                cameras: vec!["c".parse().unwrap()],
                rig,
                frames,
                ..Log::default()
            })
        }
    }

    impl Dataset for Grey {
        fn log(&self) -> &Log {
            &self.0
        }

        fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
            Ok(Sweep::default())
        }

        fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
            Ok(RgbImage::from_pixel(record.camera.width, record.camera.height, image::Rgb([128; 3])))
        }
    }

    /// Leaves frames as they are.
    struct Still;

    impl Denoiser for Still {
        type Condition = FrameConditions;

        fn shape(&self) -> LatentShape {
            SHAPE
        }

        fn predict(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<Latent>, DenoiserError> {
            Ok(vec![Latent::filled(SHAPE, 0.0); window.len()])
        }
    }

    /// Fails once.
    struct FailsOnce {
        codec: PixelCodec,
        calls_before: Cell<Option<usize>>,
    }

    impl FailsOnce {
        fn call(&self) -> Result<(), DenoiserError> {
            let left = self.calls_before.get();
            self.calls_before.set(left.and_then(|left| left.checked_sub(1)));
            if left == Some(0) { Err(DenoiserError::answer("images", "none")) } else { Ok(()) }
        }
    }

    impl Codec for FailsOnce {
        fn shape(&self) -> LatentShape {
            self.codec.shape()
        }

        fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError> {
            self.call().and_then(|()| self.codec.encode(images))
        }

        fn decode(&self, latent: &Latent) -> Result<Vec<RgbImage>, DenoiserError> {
            self.call().and_then(|()| self.codec.decode(latent))
        }
    }

    fn nothing(path: &Path) -> Skeleton {
        let fill = |writer: &mut SkeletonWriter| {
            writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
        };
        SkeletonWriter::write::<FileError>(path, fill).unwrap();
        Skeleton::open(path).unwrap()
    }

    fn parts<'a>(drive: &'a Grey, stage: &'a Clouds<'a>, calls_before: Option<usize>) -> SessionParts<'a> {
        let recipe = Recipe { drawn: ImageSize { height: 8, width: 16 }, size: SIZE, ..Recipe::default() };
        let codec = PixelCodec::new(SHAPE).unwrap();
        SessionParts {
            conditioner: Conditioner::new(&drive.0, None, stage, &recipe, ""),
            truth: TrueImages::Logged(drive),
            ego_follows_log: true,
            actors_follow_log: true,
            codec: Box::new(FailsOnce { codec, calls_before: Cell::new(calls_before) }),
            size: SIZE,
            options: GenerateOptions {
                window: 2,
                steps: 2,
                clean: 0,
                strategy: Strategy::ResetAndRoll,
                sampler: SamplerOptions::default(),
                guidance: Guidance::default(),
            },
            seed: 0,
        }
    }

    /// Also where the next attempt would do: it would be of another frame, or of an ego that stands.
    #[test]
    fn a_session_that_failed_makes_no_step() {
        let (drive, folder) = (Grey::new(), tempfile::tempdir().unwrap());
        let skeleton = nothing(&folder.path().join("sk"));
        let stage = Clouds::new(&skeleton, "grey").unwrap();
        let desc = RasterizerDesc { kind: RasterizerKind::Cpu, device: None, memory_bytes: None };
        let mut rasterizer = raster::create(&desc, stage.cloud_set()).unwrap();
        // The reference is encoded, all frames behind it are decoded.
        for (calls_before, made_before) in [(None, 5), (Some(0), 0), (Some(1), 1), (Some(2), 2)] {
            let scenario = Scenario::new(&drive.0, None, LogFormat::Town);
            let options = SimOptions { steps: 9, ..SimOptions::default() };
            let mut simulation = Simulation::new(&scenario, options).unwrap();
            let mut session = Session::new(parts(&drive, &stage, calls_before), Box::new(Still)).unwrap();
            let (mut made, mut errors) = (0, Vec::new());
            loop {
                for _attempt in 0..2 {
                    match session.step(&simulation, rasterizer.as_mut()) {
                        Ok(frame) => {
                            made += usize::from(frame.is_some());
                            break;
                        }
                        Err(error) => errors.push(error),
                    }
                }
                if simulation.step().unwrap().is_none() {
                    break;
                }
            }
            assert_eq!((made, errors.is_empty()), (made_before, calls_before.is_none()));
            if let Some((first, others)) = errors.split_first() {
                assert!(matches!(first, SessionError::Codec(_)), "{first}");
                assert!(others.iter().all(|error| matches!(error, SessionError::Failed)), "{others:?}");
                assert!(others.len() > 2 && session.cache().is_none());
            }
        }
    }
}
