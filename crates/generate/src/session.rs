use std::time::Instant as Clock;

use image::RgbImage;
use point_skeleton::geometry::{ImageSize, Pose};
use point_skeleton::raster::Rasterizer;
use pskel_sim::report::images::StepImages;
use pskel_sim::{Committed, Instant, Simulation};

use super::{
    Cache, Codec, Conditioner, ConditionerError, Denoiser, DenoiserError, FrameConditions, GaussianNoise,
    GenerateError, GenerateOptions, Generator, GroundTruthImages, Latent, RenderedConditions,
    TrueImagesError,
};

/// A network whose type is chosen at run time.
pub type AnyDenoiser = Box<dyn Denoiser<Condition = FrameConditions>>;

/// Components and options of a [`Session`].
pub struct SessionParts<'a> {
    /// Renders the network input.
    pub conditioner: Conditioner<'a>,
    /// Source of the reference images and of the ground truth for comparison.
    pub truth: GroundTruthImages<'a>,
    /// Whether the ego follows the log in the whole rollout.
    pub ego_follows_log: bool,
    /// Whether the actors follow the log in the whole rollout.
    pub actors_follow_log: bool,
    /// Codec between images and the network's latents.
    pub codec: Box<dyn Codec>,
    /// Size of the images.
    pub size: ImageSize,
    /// Options of the generator.
    pub options: GenerateOptions,
    /// Seed of the noise.
    pub seed: u64,
}

/// A generator that runs with a simulation. At each planning step it generates a frame from the committed and
/// forecast instants. The first frames are references: the ground-truth images of the planning steps in the
/// warm-up.
pub struct Session<'a> {
    parts: SessionParts<'a>,
    stage: SessionState,
    /// Ego pose at the previous planning step.
    before: Option<Pose>,
    times: SessionTimes,
}

/// Durations of the parts of the last frame, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SessionTimes {
    /// Rendering the committed instant as network input.
    pub conditions_s: f64,
    /// Rendering the forecasts.
    pub forecasts_s: f64,
    /// Getting the ground-truth images.
    pub truth_s: f64,
    /// The generator step with all its network calls.
    pub network_s: f64,
    /// Decoding the latent into images.
    pub decode_s: f64,
}

enum SessionState {
    /// Collects references.
    Warm { denoiser: AnyDenoiser, kept: Vec<(Latent, Committed<FrameConditions>)> },
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
    Truth(#[from] TrueImagesError),
    /// Error of the codec.
    #[error(transparent)]
    Codec(#[from] DenoiserError),
    /// Error of the generator or the network.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// A previous step failed.
    #[error("expected a generator that works, found one that has failed")]
    Failed,
    /// The rollout cannot be resumed because something is missing.
    #[error("expected {expected} to go on with, found {found}")]
    Resume {
        /// Needed input.
        expected: String,
        /// Given input.
        found: String,
    },
}

impl SessionTimes {
    /// Cost of a frame: all parts except the ground-truth images, which only serve for comparison.
    pub fn total_s(&self) -> f64 {
        self.conditions_s + self.forecasts_s + self.network_s + self.decode_s
    }
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
        let stage = SessionState::Warm { denoiser, kept: Vec::new() };
        Ok(Self { parts, stage, before: None, times: SessionTimes::default() })
    }

    /// Resumes a rollout after `frames` planning steps. `last` are the last of these steps, as many as the window
    /// has frames or all if there are fewer. `cache` is the cache after the last step, if frames were generated
    /// already.
    ///
    /// # Errors
    /// Returns an error if the number of steps differs, or if the cache is missing or of another frame. Also
    /// returns the errors of [`Session::step`].
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
        let SessionState::Warm { denoiser, .. } = std::mem::replace(&mut self.stage, SessionState::Failed)
        else {
            return Err(SessionError::Failed);
        };
        let noise = GaussianNoise { seed: self.parts.seed };
        let generator = Generator::resume(denoiser, noise, self.parts.options, cache, shown)?;
        self.stage = SessionState::Going(Box::new(generator));
        Ok(self)
    }

    /// Generates the frame of the last committed instant; `None` between planning steps.
    ///
    /// # Errors
    /// Returns an error if the device, the files of the log, the codec or the network fail. All further steps then
    /// fail; resume in a new session with [`Session::resume`].
    pub fn step(
        &mut self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Option<StepImages>, SessionError> {
        if matches!(self.stage, SessionState::Failed) {
            return Err(SessionError::Failed);
        }
        if !simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan()) {
            return Ok(None);
        }
        let made = self.make(simulation, rasterizer);
        if made.is_err() {
            self.stage = SessionState::Failed;
        }
        made.map(Some)
    }

    fn make(
        &mut self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<StepImages, SessionError> {
        let mut clock = Clock::now();
        let mut times = SessionTimes::default();
        let drawn = self.draw(simulation.committed(), rasterizer)?;
        times.conditions_s = lap(&mut clock);
        let references = self.parts.options.references();
        if matches!(&self.stage, SessionState::Warm { kept, .. } if kept.len() < references) {
            let images = self.keep(&drawn)?;
            times.truth_s = lap(&mut clock);
            self.times = times;
            let truth = self.has_truth().then(|| images.clone());
            return Ok(StepImages { is_reference: true, images, truth });
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
        Ok(StepImages { is_reference: false, images, truth })
    }

    /// Durations of the last frame.
    pub fn times(&self) -> SessionTimes {
        self.times
    }

    /// State for the next step, once frames are generated.
    pub fn cache(&self) -> Option<&Cache> {
        match &self.stage {
            SessionState::Going(generator) => Some(generator.cache()),
            SessionState::Warm { .. } | SessionState::Failed => None,
        }
    }

    /// Returns whether every step has ground-truth images.
    pub fn has_truth(&self) -> bool {
        let SessionParts { truth, ego_follows_log, actors_follow_log, .. } = &self.parts;
        truth.are_known(*ego_follows_log, *actors_follow_log)
    }

    fn draw(
        &mut self,
        instant: Committed<&Instant>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Committed<RenderedConditions>, SessionError> {
        let pose = instant.get().ego.pose;
        let drawn = self.parts.conditioner.committed(instant, self.before, rasterizer)?;
        self.before = Some(pose);
        Ok(drawn)
    }

    /// Adds a step as a reference.
    fn keep(&mut self, drawn: &Committed<RenderedConditions>) -> Result<Vec<RgbImage>, SessionError> {
        let images = self.truth(drawn.get())?;
        let latent = self.parts.codec.encode(&images)?;
        if let SessionState::Warm { kept, .. } = &mut self.stage {
            kept.push((latent, drawn.clone().map(|drawn| drawn.conditions)));
        }
        Ok(images)
    }

    fn truth(&self, drawn: &RenderedConditions) -> Result<Vec<RgbImage>, SessionError> {
        let SessionParts { truth, conditioner, size, actors_follow_log, .. } = &self.parts;
        let view = |view: &point_skeleton::geometry::View| conditioner.options().drawn_view(view);
        Ok(truth.of(&drawn.state, view, *size, *actors_follow_log)?)
    }

    /// Returns the generator; creates it when the references are complete.
    fn generator(&mut self) -> Result<&mut Generator<AnyDenoiser, GaussianNoise>, SessionError> {
        if let SessionState::Warm { .. } = self.stage
            && let SessionState::Warm { denoiser, kept } =
                std::mem::replace(&mut self.stage, SessionState::Failed)
        {
            let noise = GaussianNoise { seed: self.parts.seed };
            let generator = Generator::new(denoiser, noise, self.parts.options, kept)?;
            self.stage = SessionState::Going(Box::new(generator));
        }
        match &mut self.stage {
            SessionState::Going(generator) => Ok(generator),
            SessionState::Warm { .. } | SessionState::Failed => Err(SessionError::Failed),
        }
    }
}

/// Returns the seconds since `since`, and sets it to now.
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
    use crate::{Frame, Guidance, LatentShape, PixelCodec, Recipe, SamplerOptions, Strategy};
    use point_skeleton::dataset::{
        Dataset, DatasetError, Frame as LogFrame, ImageRecord, Log, LogFormat, RigCamera, Sweep, SweepRecord,
    };
    use point_skeleton::error::FileError;
    use point_skeleton::geometry::Camera;
    use point_skeleton::raster::{self, RasterizerDesc, RasterizerKind};
    use point_skeleton::scene::SceneClouds as Clouds;
    use point_skeleton::skeleton::{BuildOptions, BuildReport, Skeleton, SkeletonWriter};
    use pskel_sim::{Scenario, SimOptions};

    const SIZE: ImageSize = ImageSize { height: 4, width: 8 };
    const SHAPE: LatentShape = LatentShape { views: 1, channels: 12, height: 2, width: 4 };

    /// Log of one second at 10 frames per second, with gray images.
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

    /// Denoiser that leaves frames unchanged.
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

    /// Codec that fails once, after `calls_before` calls.
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
            truth: GroundTruthImages::new(drive),
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

    /// It stays failed even if a retry could succeed: the retry would be of another frame, or without ego motion.
    #[test]
    fn a_session_that_failed_makes_no_step() {
        let (drive, folder) = (Grey::new(), tempfile::tempdir().unwrap());
        let skeleton = nothing(&folder.path().join("sk"));
        let stage = Clouds::new(&skeleton, "grey").unwrap();
        let desc = RasterizerDesc { kind: RasterizerKind::Cpu, device: None, memory_bytes: None };
        let mut rasterizer = raster::create(&desc, stage.cloud_set()).unwrap();
        // The reference is encoded, all later frames are decoded.
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
