use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use glam::DAffine3;

use super::{location, street};
use point_skeleton::Log;
use point_skeleton::cloud::{Point, PointFile};
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind, MapSet};
use point_skeleton::dataset::Recording;
use point_skeleton::geometry::View;
use point_skeleton::memory::{MemoryError, Need, reserve};
use point_skeleton::raster::{Crop, FrameJob, Instance, Occlusion};
use point_skeleton::scene::{EgoOffset, SceneInstances, SceneMap, SceneState, Substitutes, state_of_frame};
use point_skeleton::skeleton::Skeleton;

use super::options::BenchError;

/// Clouds and frames to render.
pub struct Workload {
    pub(super) content: Content,
    /// At least one.
    pub(super) frames: Vec<WorkFrame>,
    /// Number of points that are never rendered because they are not finite.
    pub(super) non_finite: usize,
    skipped: usize,
}

/// Points of a workload.
pub(super) enum Content {
    /// A cloud, and its place in the world.
    Cloud(Vec<Point>, SceneInstances),
    /// A location of streets, and its chunks.
    Location(Box<Skeleton>, SceneInstances),
    /// Skeleton, its substitutes, and name of the log.
    Log(Box<(Skeleton, Substitutes)>, String),
}

/// Cameras of one frame.
pub(super) struct WorkFrame {
    pub(super) name: String,
    pub(super) views: Vec<View>,
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
        let placed = SceneInstances { color: vec![instance], geometry: vec![instance] };
        let frame = WorkFrame { name: "frame".into(), views, crop: None, state: None };
        let non_finite = cloud.non_finite;
        let content = Content::Cloud(cloud.points, placed);
        Self { content, frames: vec![frame], non_finite, skipped: 0 }
    }

    /// Opens a location of many streets in a folder, or writes it if there is none: at least `points` points,
    /// 10 million per street. The frames, part of a drive up to 1 km long, are 1 m apart and have the cameras
    /// of the street. `None` is the whole drive.
    ///
    /// # Errors
    /// Fails if the folder has another skeleton or cannot be written, or if the drive has no such frames.
    pub fn location(folder: &Path, points: usize, part: Option<Range<usize>>) -> Result<Self, BenchError> {
        let drive = location::drive(points);
        let (end, frames) = (part.as_ref().map_or(0, |part| part.end), drive.len());
        if end > frames {
            return Err(BenchError::NoFrames { found: end, frames });
        }
        let skeleton = location::open_or_write(folder, points)?;
        let instance = |(cloud, origin)| {
            let world_from_local = DAffine3::from_translation(origin);
            Instance { cloud, world_from_local, number: 0 }
        };
        let chunks: Vec<Instance> = location::origins(&skeleton.manifest).enumerate().map(instance).collect();
        let placed = SceneInstances { color: chunks.clone(), geometry: chunks };
        let part = part.unwrap_or(0..frames);
        let part = drive.into_iter().skip(part.start).take(part.len());
        let frames = part.map(|(name, views)| WorkFrame { name, views, crop: None, state: None }).collect();
        Ok(Self { content: Content::Location(Box::new(skeleton), placed), frames, non_finite: 0, skipped: 0 })
    }

    /// Returns the disk space of a location with some number of points, bytes.
    pub fn location_bytes(points: usize) -> u64 {
        location::disk_bytes(points)
    }

    /// Creates a workload from the frames of a log that have cameras. `skeleton` was built from the log,
    /// `substitutes` supplement its clouds. The HD map is read if the maps need it.
    ///
    /// # Errors
    /// Fails if no frame has cameras, or if the HD map is damaged.
    pub fn log(
        source: &Log,
        skeleton: Skeleton,
        substitutes: Substitutes,
        range: Range<usize>,
        maps: MapSet,
    ) -> Result<Self, BenchError> {
        let (log, count) = (source.recording(), range.len());
        let with_map = maps.contains(MapKind::Map) || maps.contains(MapKind::Tensor);
        let map = if with_map { source.require_map()? } else { None };
        let frames = frames_of_log(log, range, map.as_ref());
        if frames.is_empty() {
            return Err(BenchError::NoCameras { log: log.shown_name().into_owned(), frames: count });
        }
        let skipped = count - frames.len();
        let content = Content::Log(Box::new((skeleton, substitutes)), log.name.clone());
        Ok(Self { content, frames, non_finite: 0, skipped })
    }

    /// Returns the number of frames; at least one.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// Returns how many frames of the log are omitted because they have no cameras.
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

    /// Returns the frames as rasterizer jobs, with the clouds of each frame.
    pub(super) fn jobs<'a>(
        &'a self,
        placed: &'a [SceneInstances],
        options: &'a ConditionOptions,
    ) -> Vec<FrameJob<'a>> {
        let job = |(frame, placed): (&'a WorkFrame, &'a SceneInstances)| FrameJob {
            views: &frame.views,
            schedule: &options.splat,
            color: &placed.color,
            geometry: &placed.geometry,
            occlusion: Occlusion::default(),
            crop: frame.crop,
            maps: options.maps,
            out_size: options.out_size,
        };
        self.frames.iter().zip(placed.iter().cycle()).map(job).collect()
    }

    /// Returns the states of a log's frames.
    pub(super) fn states(&self) -> Vec<&SceneState> {
        self.frames.iter().filter_map(|frame| frame.state.as_ref()).collect()
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

/// Returns the frames of a log; frames without cameras are skipped.
fn frames_of_log(log: &Recording, range: Range<usize>, map: Option<&Arc<SceneMap>>) -> Vec<WorkFrame> {
    let radius_m = ConditionOptions::default().radius_m;
    let frame = |index: usize| {
        let mut state = state_of_frame(log, index, EgoOffset::default())?;
        state.map = map.cloned();
        let crop = Some(Crop { center: state.global_from_ego.translation.truncate(), radius_m });
        let views = state.cameras.iter().map(|camera| camera.view.clone()).collect();
        Some(WorkFrame { name: state.name.clone(), views, crop, state: Some(state) })
    };
    range.filter_map(frame).filter(|frame: &WorkFrame| !frame.views.is_empty()).collect()
}
