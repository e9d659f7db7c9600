use std::ops::Range;
use std::sync::Arc;

use point_skeleton::cloud::street;
use point_skeleton::cloud::{Point, PointFile};
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind, MapSet};
use point_skeleton::dataset::{Dataset, Recording};
use point_skeleton::error::FileError;
use point_skeleton::geometry::View;
use point_skeleton::memory::{MemoryError, Need, reserve};
use point_skeleton::raster::{CloudSet, Crop, FrameJob, Instance, Occlusion};
use point_skeleton::scene::{
    EgoOffset, SceneClouds, SceneInstances, SceneMap, SceneState, SelectionOptions, Substitutes,
    state_of_frame,
};
use point_skeleton::skeleton::Skeleton;

use super::frames::Steps;
use super::options::{BenchError, BenchOptions};

/// Clouds and frames to render.
pub struct Workload {
    clouds: Clouds,
    /// At least one.
    pub(super) frames: Vec<WorkFrame>,
    /// Number of points that are never rendered because they are not finite.
    pub(super) non_finite: usize,
    skipped: usize,
}

enum Clouds {
    One(Vec<Point>),
    /// Skeleton, its substitutes, and name of the log.
    Skeleton(Box<(Skeleton, Substitutes)>, String),
}

/// One frame: placed clouds and rendered cameras.
pub(super) struct WorkFrame {
    pub(super) name: String,
    pub(super) views: Vec<View>,
    clouds: SceneInstances,
    crop: Option<Crop>,
    /// State of a log's frame.
    state: Option<SceneState>,
}

impl Workload {
    /// Generates a synthetic street with six cameras of 900x1600.
    ///
    /// # Errors
    /// Fails if the points do not fit into memory.
    pub fn street(points: usize, seed: u64) -> Result<Self, MemoryError> {
        let bytes = street::POINT_BYTES.saturating_mul(points as u64);
        let what = || format!("a street of {points} points");
        let _points =
            reserve(bytes, || Need { what: what(), bytes, advice: "fewer points (--synthetic) need less" })?;
        let points = street::street_cloud(points, seed);
        Ok(Self::cloud(PointFile { points, ..PointFile::default() }, street::street_views()))
    }

    /// Creates a workload of one frame: a cloud and cameras.
    pub fn cloud(cloud: PointFile, views: Vec<View>) -> Self {
        let instance = Instance { cloud: 0, world_from_local: cloud.world_from_local(), number: 0 };
        let clouds = SceneInstances { color: vec![instance], geometry: vec![instance] };
        let frame = WorkFrame { name: "frame".into(), views, clouds, crop: None, state: None };
        let non_finite = cloud.non_finite;
        Self { clouds: Clouds::One(cloud.points), frames: vec![frame], non_finite, skipped: 0 }
    }

    /// Creates a workload of the frames of a log that have cameras. `skeleton` was built from the log, `substitutes`
    /// supplement its clouds. The HD map is read if the maps need it.
    ///
    /// # Errors
    /// Fails if no frame has cameras, if the HD map is damaged, or if points of the skeleton do not match their
    /// checksum.
    pub fn log(
        dataset: &dyn Dataset,
        skeleton: Skeleton,
        substitutes: Substitutes,
        range: Range<usize>,
        maps: MapSet,
    ) -> Result<Self, BenchError> {
        let (log, count) = (dataset.log(), range.len());
        let with_map = maps.contains(MapKind::Map) || maps.contains(MapKind::Tensor);
        let map = if with_map { SceneMap::read(dataset)? } else { None };
        let content = Box::new((skeleton, substitutes));
        let frames = frames_of_log(log, &scene_clouds(&content, &log.name)?, range, map.as_ref());
        if frames.is_empty() {
            return Err(BenchError::NoCameras { log: log.shown_name().into_owned(), frames: count });
        }
        let skipped = count - frames.len();
        let clouds = Clouds::Skeleton(content, log.name.clone());
        Ok(Self { clouds, frames, non_finite: 0, skipped })
    }

    /// Returns the number of frames; at least one.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// Returns the number of frames of the log that are omitted because they have no cameras.
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// Returns the workload with cameras of another size; `None` keeps their size.
    pub(super) fn resized(mut self, size: Option<ImageSize>) -> Self {
        if let Some(size) = size {
            for view in self.frames.iter_mut().flat_map(|frame| &mut frame.views) {
                view.camera = view.camera.resized(size.height, size.width);
            }
        }
        self
    }

    /// Returns all clouds for a rasterizer.
    ///
    /// # Errors
    /// Fails if points of a skeleton do not match their checksum.
    pub(super) fn clouds(&self) -> Result<CloudSet<'_>, FileError> {
        match &self.clouds {
            Clouds::One(points) => Ok(vec![points]),
            Clouds::Skeleton(skeleton, log) => Ok(scene_clouds(skeleton, log)?.cloud_set()),
        }
    }

    /// Returns the frames as rasterizer jobs.
    pub(super) fn jobs<'a>(&'a self, options: &'a ConditionOptions) -> Vec<FrameJob<'a>> {
        let job = |frame: &'a WorkFrame| FrameJob {
            views: &frame.views,
            schedule: &options.splat,
            color: &frame.clouds.color,
            geometry: &frame.clouds.geometry,
            occlusion: Occlusion::default(),
            crop: frame.crop,
            maps: options.maps,
            out_size: options.out_size,
        };
        self.frames.iter().map(job).collect()
    }

    /// Returns the frames as whole steps, if the options ask for them.
    ///
    /// # Errors
    /// Fails if points of the skeleton do not match their checksum.
    pub(super) fn steps<'a>(&'a self, options: &ConditionOptions) -> Result<Option<Steps<'a>>, FileError> {
        let Clouds::Skeleton(skeleton, log) = &self.clouds else { return Ok(None) };
        let states = self.frames.iter().filter_map(|frame| frame.state.as_ref()).collect();
        let steps = || Ok(Steps::new(scene_clouds(skeleton, log)?, states, options.clone()));
        BenchOptions::has_whole_steps(options.maps).then(steps).transpose()
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

fn scene_clouds<'a>(
    (skeleton, substitutes): &'a (Skeleton, Substitutes),
    log: &str,
) -> Result<SceneClouds<'a>, FileError> {
    SceneClouds::with(skeleton, log, substitutes)
}

/// Returns the frames of a log; frames without cameras are skipped.
fn frames_of_log(
    log: &Recording,
    scene_clouds: &SceneClouds<'_>,
    range: Range<usize>,
    map: Option<&Arc<SceneMap>>,
) -> Vec<WorkFrame> {
    let selection = SelectionOptions::default();
    let radius_m = ConditionOptions::default().radius_m;
    let frame = |index: usize| {
        let mut state = state_of_frame(log, index, EgoOffset::default())?;
        state.map = map.cloned();
        let clouds = scene_clouds.instances(&state, &selection);
        let crop = Some(Crop { center: state.global_from_ego.translation.truncate(), radius_m });
        let views = state.cameras.iter().map(|camera| camera.view.clone()).collect();
        Some(WorkFrame { name: state.name.clone(), views, clouds, crop, state: Some(state) })
    };
    range.filter_map(frame).filter(|frame: &WorkFrame| !frame.views.is_empty()).collect()
}
