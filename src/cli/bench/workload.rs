use std::path::Path;

use super::BenchArgs;
use crate::cli::numbers::FrameRange;
use crate::cli::render::open_skeleton;
use crate::cloud::{self, Point, PointFile};
use crate::conditions::{ConditionOptions, ImageSize};
use crate::dataset::{Log, LogLocator};
use crate::geometry::View;
use crate::logs;
use crate::raster::{CloudSet, Crop, FrameJob, Instance, Occlusion};
use crate::scene::{EgoOffset, SceneInstances, SelectionOptions, Stage, state_of_frame};
use crate::skeleton::Skeleton;
use crate::town;

/// Points of the synthetic street where nothing is asked for.
const DEFAULT_POINTS: usize = 4_000_000;

/// What is drawn: clouds, and frames of them.
pub(super) struct Workload {
    clouds: Clouds,
    /// At least one.
    pub(super) frames: Vec<WorkFrame>,
    /// The frames come from a drive.
    pub(super) is_drive: bool,
    /// Points that are never drawn since they are not finite.
    pub(super) non_finite: usize,
}

enum Clouds {
    One(Vec<Point>),
    Skeleton(Box<Skeleton>),
}

/// One frame: what stands where, and the cameras as they are drawn.
pub(super) struct WorkFrame {
    pub(super) name: String,
    pub(super) views: Vec<View>,
    clouds: SceneInstances,
    crop: Option<Crop>,
}

impl Workload {
    /// Makes or reads what the options name.
    pub(super) fn new(args: &BenchArgs) -> anyhow::Result<Self> {
        let mut work = match (&args.log, &args.skeleton, &args.points, &args.cameras) {
            (Some(log), Some(skeleton), ..) => Self::of_drive(log, skeleton, args.frames)?,
            (.., Some(points), Some(cameras)) => {
                let views = cloud::cameras::read(cameras)?;
                Self::of_cloud(cloud::read(points)?, views)
            }
            _ => {
                let count = args.synthetic.unwrap_or(DEFAULT_POINTS);
                eprintln!("making a street of {count} points");
                let points = town::street_cloud(count, args.seed);
                Self::of_cloud(PointFile { points, ..PointFile::default() }, town::street_views())
            }
        };
        if let Some(size) = args.size {
            for view in work.frames.iter_mut().flat_map(|frame| &mut frame.views) {
                view.camera = view.camera.resized(size.height, size.width);
            }
        }
        Ok(work)
    }

    fn of_cloud(cloud: PointFile, views: Vec<View>) -> Self {
        let instance = Instance { cloud: 0, world_from_local: cloud.world_from_local(), number: 0 };
        let clouds = SceneInstances { color: vec![instance], geometry: vec![instance] };
        let frame = WorkFrame { name: "frame".into(), views, clouds, crop: None };
        Self {
            clouds: Clouds::One(cloud.points),
            frames: vec![frame],
            is_drive: false,
            non_finite: cloud.non_finite,
        }
    }

    fn of_drive(log: &LogLocator, skeleton: &Path, frames: Option<FrameRange>) -> anyhow::Result<Self> {
        let dataset = logs::open(log)?;
        let skeleton = open_skeleton(skeleton, dataset.as_ref())?;
        let log = dataset.log();
        let range = FrameRange::of(frames, log.frames.len())?;
        let asked = range.len();
        let frames = frames_of_drive(log, &skeleton, range);
        anyhow::ensure!(
            !frames.is_empty(),
            "expected frames with cameras in log {}, found none among {asked} frames",
            log.name
        );
        if frames.len() < asked {
            eprintln!("warning: {} frames have no cameras and are left out", asked - frames.len());
        }
        Ok(Self { clouds: Clouds::Skeleton(Box::new(skeleton)), frames, is_drive: true, non_finite: 0 })
    }

    /// All clouds for a rasterizer.
    pub(super) fn clouds(&self) -> CloudSet<'_> {
        match &self.clouds {
            Clouds::One(points) => vec![points],
            Clouds::Skeleton(skeleton) => Stage::clouds(skeleton),
        }
    }

    /// Points of all clouds.
    pub(super) fn points(&self) -> u64 {
        self.clouds().iter().map(|cloud| cloud.len() as u64).sum()
    }

    /// The frames as a rasterizer takes them.
    pub(super) fn jobs<'a>(&'a self, args: &'a BenchArgs) -> Vec<FrameJob<'a>> {
        let job = |frame: &'a WorkFrame| FrameJob {
            views: &frame.views,
            schedule: &args.splat,
            color: &frame.clouds.color,
            geometry: &frame.clouds.geometry,
            occlusion: Occlusion::default(),
            crop: frame.crop,
            kinds: args.maps,
            out_size: args.out_size,
        };
        self.frames.iter().map(job).collect()
    }

    /// Most cameras in a frame.
    pub(super) fn cameras(&self) -> usize {
        self.frames.iter().map(|frame| frame.views.len()).max().unwrap_or(0)
    }

    /// Sizes at which cameras are drawn, each once, `HxW` with commas.
    pub(super) fn sizes(&self) -> String {
        let mut sizes: Vec<String> = Vec::new();
        for view in self.frames.iter().flat_map(|frame| &frame.views) {
            let size = ImageSize::of(&view.camera).to_string();
            if !sizes.contains(&size) {
                sizes.push(size);
            }
        }
        sizes.join(",")
    }
}

/// Frames without a camera are left out.
fn frames_of_drive(log: &Log, skeleton: &Skeleton, range: std::ops::Range<usize>) -> Vec<WorkFrame> {
    let (stage, selection) = (Stage::new(skeleton, &log.name), SelectionOptions::default());
    let radius_m = ConditionOptions::default().radius_m;
    let frame = |index: usize| {
        let state = state_of_frame(log, index, EgoOffset::default())?;
        let clouds = stage.instances(&state, &selection);
        let crop = Some(Crop { center: state.global_from_ego.translation.truncate(), radius_m });
        let views = state.cameras.into_iter().map(|camera| camera.view).collect();
        Some(WorkFrame { name: state.name, views, clouds, crop })
    };
    range.filter_map(frame).filter(|frame: &WorkFrame| !frame.views.is_empty()).collect()
}
