use glam::{DMat3, DVec3};

use std::path::Path;

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::dataset::{Frame, Recording, RigCamera};
use point_skeleton::error::{FileError, with_causes};
use point_skeleton::geometry::{Camera, Pose};
use point_skeleton::raster::{
    self, FrameJob, FrameMaps, RasterError, Rasterizer, RasterizerDesc, RasterizerInfo, RasterizerKind,
    SplatJob, SplatMaps, StageTimes,
};
use point_skeleton::scene::SceneClouds;
use point_skeleton::skeleton::{BuildOptions, BuildReport, Skeleton, SkeletonWriter};

use super::*;
use crate::{Rates, Scenario, SimOptions};

/// Renders some frames, then fails.
struct Failing<'a> {
    drawn: Box<dyn Rasterizer + 'a>,
    left: usize,
}

impl Rasterizer for Failing<'_> {
    fn info(&self) -> RasterizerInfo {
        self.drawn.info()
    }

    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
        self.left = self.left.checked_sub(1).ok_or(RasterError::TooManyPoints { found: 2, max: 1 })?;
        self.drawn.begin(job)
    }

    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
        self.drawn.finish()
    }

    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
        self.drawn.splat(job)
    }

    fn stages(&mut self) -> &mut StageTimes {
        self.drawn.stages()
    }
}

/// Returns a log of one second at 10 frames per second with one camera.
fn log() -> Recording {
    let intrinsics = DMat3::from_cols(DVec3::X * 8.0, DVec3::Y * 8.0, DVec3::new(8.0, 4.0, 1.0));
    let camera = Camera { name: "c".parse().unwrap(), width: 16, height: 8, intrinsics, lens: None };
    let frame = |i: i64| Frame {
        t_us: i * 100_000,
        global_from_ego: Pose::from_yaw(0.0, DVec3::X * i as f64),
        sweeps: Vec::new(),
        images: Vec::new(),
        between_images: Vec::new(),
        boxes: Vec::new(),
    };
    Recording {
        name: "made".into(),
        cameras: vec!["c".parse().unwrap()],
        rig: vec![RigCamera { channel: 0, ego_from_camera: Pose::IDENTITY, camera }],
        frames: (0..=10).map(frame).collect(),
        ..Recording::default()
    }
}

#[test]
fn metrics_cover_only_rendered_steps() {
    let (log, folder) = (log(), tempfile::tempdir().unwrap());
    let path = folder.path().join("sk");
    let nothing = |writer: &mut SkeletonWriter| {
        writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
    };
    SkeletonWriter::write::<FileError>(&path, nothing).unwrap();
    let skeleton = Skeleton::open(&path).unwrap();
    let prompt = PromptParts::default();
    let clouds = SceneClouds::new(&skeleton, &log.name);
    let set = clouds.cloud_set();
    let desc = RasterizerDesc::from(RasterizerKind::Cpu);
    let drawn = raster::create(&desc, set).unwrap();
    let scenario = Scenario { log: &log, map: None, rates: Rates::default() };
    let paths = InputPaths { log: Path::new("log"), skeleton: &path, prompt: None };
    let inputs = RolloutInputs { scenario: &scenario, skeleton: &skeleton, prompt: &prompt, paths };
    let simulation = SimOptions { steps: 9, ..SimOptions::default() };
    let options = RolloutOptions { simulation, ..RolloutOptions::default() };
    let rollout = Rollout::open(inputs, options, None, None).unwrap();
    assert_eq!((rollout.steps_done(), rollout.steps_left()), (0, 10));
    // The first step and three more.
    let mut rendered = Vec::new();
    let mut on_step = |name: &str| rendered.push(name.to_owned());
    let failing = Box::new(Failing { drawn, left: 4 });
    let mut renderer = Renderer::with_rasterizer(clouds, failing, MapOptions::default());
    let run = rollout.run(&mut renderer, None, &mut on_step).unwrap();
    let failure = with_causes(&run.failure.unwrap());
    assert!(failure.contains("step 000004") && failure.contains("found 2"), "{failure}");
    assert_eq!((run.rows.len(), run.metrics.steps, run.ended), (4, 3, None));
    assert!((run.metrics.progress_m - 3.0).abs() < 1e-9, "{}", run.metrics.progress_m);
    assert_eq!(rendered, ["000000", "000001", "000002", "000003"]);
}
