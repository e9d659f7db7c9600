use std::cell::Cell;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::*;
use crate::{Frame, Guidance, LatentShape, PixelCodec, Recipe, SamplerOptions, Strategy};
use point_skeleton::dataset::{
    DatasetError, Frame as LogFrame, ImageRecord, LogReader, Recording, RigCamera, Sweep, SweepRecord,
};
use point_skeleton::error::FileError;
use point_skeleton::geometry::Camera;
use point_skeleton::raster::{RasterizerDesc, RasterizerKind};
use point_skeleton::skeleton::{BuildOptions, BuildReport, Skeleton, SkeletonWriter};
use point_skeleton::{RenderOptions, Renderer};
use pskel_sim::{Instant, Rates, Scenario, SimOptions, Simulation, scene_state};

const SIZE: ImageSize = ImageSize { height: 4, width: 8 };
const SHAPE: LatentShape = LatentShape { views: 1, channels: 12, height: 2, width: 4 };

/// Log of one second at 10 frames per second, with gray images.
struct Grey(Recording);

impl Grey {
    fn new() -> Self {
        let intrinsics = DMat3::from_cols(DVec3::X * 8.0, DVec3::Y * 8.0, DVec3::new(8.0, 4.0, 1.0));
        let camera = Camera { name: "c".parse().unwrap(), width: 16, height: 8, intrinsics, lens: None };
        let frame = |i: i64| {
            let (t_us, global_from_ego) = (i * 100_000, Pose::from_yaw(0.0, DVec3::X * i as f64));
            let image = ImageRecord {
                token: "i".into(),
                channel: 0,
                path: PathBuf::new(),
                row: None,
                t_us,
                global_from_ego,
                ego_from_camera: Pose::IDENTITY,
                camera: camera.clone().into(),
            };
            let (sweeps, between_images, boxes) = Default::default();
            LogFrame { t_us, global_from_ego, sweeps, images: vec![image], between_images, boxes }
        };
        let frames: Vec<LogFrame> = (0..=10).map(frame).collect();
        let rig = RigCamera::first_used(&frames);
        Self(Recording {
            name: "grey".into(),
            cameras: vec!["c".parse().unwrap()],
            rig,
            frames,
            ..Recording::default()
        })
    }
}

impl LogReader for Grey {
    fn recording(&self) -> &Recording {
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

    fn decode(&self, latent: &Latent, conditions: &FrameConditions) -> Result<Vec<RgbImage>, DenoiserError> {
        self.call().and_then(|()| self.codec.decode(latent, conditions))
    }
}

fn nothing(path: &Path) -> Skeleton {
    let fill = |writer: &mut SkeletonWriter| {
        writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
    };
    SkeletonWriter::write::<FileError>(path, fill).unwrap();
    Skeleton::open(path).unwrap()
}

fn parts(drive: &Grey, calls_before: Option<usize>) -> SessionParts<'_> {
    let recipe = Recipe { drawn: ImageSize { height: 8, width: 16 }, size: SIZE, ..Recipe::default() };
    let codec = PixelCodec::new(SHAPE).unwrap();
    SessionParts {
        conditioner: Conditioner::new(&recipe, false, ""),
        truth: Some(GroundTruthImages::new(drive)),
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
fn failed_sessions_reject_further_steps() {
    let (drive, folder) = (Grey::new(), tempfile::tempdir().unwrap());
    let skeleton = nothing(&folder.path().join("sk"));
    let rasterizer = RasterizerDesc::from(RasterizerKind::Cpu);
    let render = RenderOptions { rasterizer, log: Some("grey"), ..RenderOptions::default() };
    let mut renderer = Renderer::new(&skeleton, render).unwrap();
    // The reference is encoded, all later frames are decoded.
    for (calls_before, made_before) in [(None, 5), (Some(0), 0), (Some(1), 1), (Some(2), 2)] {
        let scenario = Scenario { log: &drive.0, map: None, rates: Rates::default() };
        let options = SimOptions { steps: 9, ..SimOptions::default() };
        let mut simulation = Simulation::new(&scenario, options).unwrap();
        let mut session = Session::new(parts(&drive, calls_before), Box::new(Still)).unwrap();
        let (mut made, mut errors) = (0, Vec::new());
        loop {
            for _attempt in 0..2 {
                if !simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan()) {
                    break;
                }
                let state = |instant: &Instant| scene_state(&drive.0, instant, None);
                let expected = simulation.forecast(session.forecasts()).into_iter();
                let expected: Vec<_> = expected.map(|next| next.map(|next| state(&next))).collect();
                let now = simulation.committed().map(state);
                match session.step(now.as_ref(), &expected, &mut renderer) {
                    Ok(_) => {
                        made += 1;
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
