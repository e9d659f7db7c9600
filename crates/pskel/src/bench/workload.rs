use std::path::Path;
use std::sync::Arc;

use point_skeleton::cloud::street;
use point_skeleton::cloud::{self, Point, PointFile};
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind};
use point_skeleton::dataset::{LogLocator, Recording};
use point_skeleton::error::FileError;
use point_skeleton::geometry::View;
use point_skeleton::raster::{CloudSet, Crop, FrameJob, Instance, Occlusion};
use point_skeleton::scene::{
    EgoOffset, SceneClouds, SceneInstances, SceneMap, SceneState, SelectionOptions, state_of_frame,
};
use point_skeleton::skeleton::Skeleton;

use super::BenchArgs;
use super::frames::Steps;
use crate::logs;
use crate::numbers::FrameRange;
use crate::render::open_skeleton;
use crate::{tell, warn};

/// Default number of points of the synthetic street.
const DEFAULT_POINTS: usize = 4_000_000;

/// Clouds and frames to render.
pub(super) struct Workload {
    clouds: Clouds,
    /// At least one.
    pub(super) frames: Vec<WorkFrame>,
    /// `true` if the frames come from a recording.
    pub(super) is_drive: bool,
    /// Number of points that are never rendered because they are not finite.
    pub(super) non_finite: usize,
}

enum Clouds {
    One(Vec<Point>),
    /// Skeleton and name of the log.
    Skeleton(Box<Skeleton>, String),
}

/// One frame: placed clouds and rendered cameras.
pub(super) struct WorkFrame {
    pub(super) name: String,
    pub(super) views: Vec<View>,
    clouds: SceneInstances,
    crop: Option<Crop>,
    /// State of a recording's frame.
    state: Option<SceneState>,
}

impl Workload {
    /// Generates or loads the workload that the options select.
    pub(super) fn new(args: &BenchArgs) -> anyhow::Result<Self> {
        let mut work = match (&args.log, &args.skeleton, &args.points, &args.cameras) {
            (Some(log), Some(skeleton), ..) => Self::of_drive(args, log, skeleton)?,
            (.., Some(points), Some(cameras)) => {
                let views = cloud::cameras::read(cameras)?;
                Self::of_cloud(cloud::read(points)?, views)
            }
            _ => {
                let count = args.synthetic.unwrap_or(DEFAULT_POINTS);
                tell(&format!("making a street of {count} points"));
                let points = street::street_cloud(count, args.seed);
                Self::of_cloud(PointFile { points, ..PointFile::default() }, street::street_views())
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
        let frame = WorkFrame { name: "frame".into(), views, clouds, crop: None, state: None };
        Self {
            clouds: Clouds::One(cloud.points),
            frames: vec![frame],
            is_drive: false,
            non_finite: cloud.non_finite,
        }
    }

    fn of_drive(args: &BenchArgs, log: &LogLocator, skeleton: &Path) -> anyhow::Result<Self> {
        let dataset = logs::open(log)?;
        let skeleton = open_skeleton(skeleton, dataset.as_ref())?;
        let log = dataset.log();
        let range = FrameRange::of(args.frames, log.frames.len())?;
        let asked = range.len();
        let with_map = args.maps.contains(MapKind::Map) || args.maps.contains(MapKind::Tensor);
        let map = with_map.then(|| dataset.read_map()).transpose()?.flatten();
        let map = map.map(|map| Arc::new(SceneMap::new(map, log)));
        let frames = frames_of_drive(log, &skeleton, range, map.as_ref())?;
        anyhow::ensure!(
            !frames.is_empty(),
            "expected frames with cameras in log {}, found none among {asked} frames",
            log.shown_name()
        );
        if frames.len() < asked {
            warn(&format!("{} frames have no cameras and are left out", asked - frames.len()));
        }
        let clouds = Clouds::Skeleton(Box::new(skeleton), log.name.clone());
        Ok(Self { clouds, frames, is_drive: true, non_finite: 0 })
    }

    /// Returns all clouds for a rasterizer.
    ///
    /// # Errors
    /// Fails if points of a skeleton do not match their checksum.
    pub(super) fn clouds(&self) -> Result<CloudSet<'_>, FileError> {
        match &self.clouds {
            Clouds::One(points) => Ok(vec![points]),
            Clouds::Skeleton(skeleton, _) => SceneClouds::clouds(skeleton),
        }
    }

    /// Returns the number of points of all clouds.
    pub(super) fn points(&self) -> usize {
        match &self.clouds {
            Clouds::One(points) => points.len(),
            Clouds::Skeleton(skeleton, _) => skeleton.manifest.points(),
        }
    }

    /// Returns the frames as rasterizer jobs.
    pub(super) fn jobs<'a>(&'a self, args: &'a BenchArgs) -> Vec<FrameJob<'a>> {
        let job = |frame: &'a WorkFrame| FrameJob {
            views: &frame.views,
            schedule: &args.splat,
            color: &frame.clouds.color,
            geometry: &frame.clouds.geometry,
            occlusion: Occlusion::default(),
            crop: frame.crop,
            maps: args.maps,
            out_size: args.out_size,
        };
        self.frames.iter().map(job).collect()
    }

    /// Returns the frames as whole steps, if the options ask for them.
    ///
    /// # Errors
    /// Fails if points of the skeleton do not match their checksum.
    pub(super) fn steps<'a>(&'a self, args: &BenchArgs) -> Result<Option<Steps<'a>>, FileError> {
        let Clouds::Skeleton(skeleton, log) = &self.clouds else { return Ok(None) };
        let states = self.frames.iter().filter_map(|frame| frame.state.as_ref()).collect();
        let steps = || Ok(Steps::new(SceneClouds::new(skeleton, log)?, states, args.conditions()));
        args.whole_steps().then(steps).transpose()
    }

    /// Returns the maximum number of cameras in a frame.
    pub(super) fn cameras(&self) -> usize {
        self.frames.iter().map(|frame| frame.views.len()).max().unwrap_or(0)
    }

    /// Returns the distinct rendered sizes of the cameras, `HxW` separated by commas.
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

/// Returns the frames of a recording; frames without cameras are skipped.
fn frames_of_drive(
    log: &Recording,
    skeleton: &Skeleton,
    range: std::ops::Range<usize>,
    map: Option<&Arc<SceneMap>>,
) -> Result<Vec<WorkFrame>, FileError> {
    let (stage, selection) = (SceneClouds::new(skeleton, &log.name)?, SelectionOptions::default());
    let radius_m = ConditionOptions::default().radius_m;
    let frame = |index: usize| {
        let mut state = state_of_frame(log, index, EgoOffset::default())?;
        state.map = map.cloned();
        let clouds = stage.instances(&state, &selection);
        let crop = Some(Crop { center: state.global_from_ego.translation.truncate(), radius_m });
        let views = state.cameras.iter().map(|camera| camera.view.clone()).collect();
        Some(WorkFrame { name: state.name.clone(), views, clouds, crop, state: Some(state) })
    };
    Ok(range.filter_map(frame).filter(|frame: &WorkFrame| !frame.views.is_empty()).collect())
}
