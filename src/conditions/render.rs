use std::time::Instant;

use rayon::prelude::*;

use super::layout::{self, Layouts};
use super::memory;
use super::reduce::hidden::without_hidden;
use super::{
    CameraConditions, ColorFilter, ConditionError, ConditionOptions, ConditionSet, ImageSize, reduce,
};
use crate::geometry::View;
use crate::memory::Reservation;
use crate::raster::{Crop, FrameJob, MapKind, MapSet, Rasterizer, SplatJob, ViewMaps, class_of, rgb_of};
use crate::scene::{ActorState, SceneInstances, SceneMap, SceneState};

/// Renders the maps of a step for all cameras, with clouds cropped to a square of `options.radius_m` around
/// the ego.
///
/// # Errors
/// Returns an error if the rasterizer fails, or if [`MapKind::Map`] is requested and the state has no HD map.
pub fn render(
    rasterizer: &mut dyn Rasterizer,
    clouds: &SceneInstances,
    state: &SceneState,
    options: &ConditionOptions,
) -> Result<ConditionSet, ConditionError> {
    StepInFlight::new(rasterizer, clouds, state, options)?.finish(rasterizer)
}

/// Renders the maps of some views that come from points: all except [`MapKind::Boxes`], [`MapKind::Map`] and
/// [`MapKind::Tensor`].
///
/// # Errors
/// Returns an error if the rasterizer fails.
pub fn render_views(
    rasterizer: &mut dyn Rasterizer,
    clouds: &SceneInstances,
    views: &[View],
    crop: Option<Crop>,
    options: &ConditionOptions,
) -> Result<Vec<CameraConditions>, ConditionError> {
    let _memory = memory::reserve_step(views, options)?;
    Points::begin(rasterizer, clouds, views, crop, options)?.finish(rasterizer)
}

/// Draws the layouts of a step ([`MapKind::Boxes`] and [`MapKind::Map`], as far as `options` requests them),
/// without a rasterizer. Other maps are `None`.
///
/// # Errors
/// Returns an error if [`MapKind::Map`] is requested and the state has no HD map.
pub fn draw_layouts(state: &SceneState, options: &ConditionOptions) -> Result<ConditionSet, ConditionError> {
    let views: Vec<View> = state.cameras.iter().map(|camera| camera.view.clone()).collect();
    let _memory = memory::reserve_step(&views, options)?;
    let mut cameras: Vec<CameraConditions> = views.iter().map(|view| blank(view, options)).collect();
    let LayoutInputs { boxes, map } = LayoutInputs::of(state, options.maps)?;
    add_layouts(&mut cameras, layout::draw(boxes, map, &views, options));
    Ok(ConditionSet { cameras })
}

/// Content of the requested layouts.
struct LayoutInputs<'a> {
    boxes: Option<&'a [ActorState]>,
    map: Option<&'a SceneMap>,
}

impl<'a> LayoutInputs<'a> {
    fn of(state: &'a SceneState, maps: MapSet) -> Result<Self, ConditionError> {
        let no_map = || ConditionError::NoMap { step: state.name.clone() };
        let map = maps.contains(MapKind::Map).then(|| state.map.as_deref().ok_or_else(no_map));
        let boxes = maps.contains(MapKind::Boxes).then_some(state.actors.as_slice());
        Ok(Self { boxes, map: map.transpose()? })
    }
}

/// Returns a camera of the written size without maps.
fn blank(view: &View, options: &ConditionOptions) -> CameraConditions {
    let ImageSize { height, width } = options.written_size(view);
    CameraConditions { name: view.camera.name.clone(), width, height, ..CameraConditions::default() }
}

fn add_layouts(cameras: &mut [CameraConditions], layouts: Layouts) {
    for (camera, layout) in cameras.iter_mut().zip(layouts.boxes.into_iter().flatten()) {
        camera.boxes = Some(layout);
    }
    for (camera, layout) in cameras.iter_mut().zip(layouts.map.into_iter().flatten()) {
        camera.map = Some(layout);
    }
}

/// Step in flight on the rasterizer. Steps finish in the order they were started, with at most
/// [`FRAMES_IN_FLIGHT`](crate::raster::FRAMES_IN_FLIGHT) at a time.
#[derive(Debug)]
pub struct StepInFlight {
    points: Points,
    layouts: Layouts,
    /// Options as requested; more maps are rendered for the model tensor.
    asked: ConditionOptions,
    /// Memory of the maps.
    _memory: Reservation,
}

impl StepInFlight {
    /// Starts rendering the maps of a step, as [`render`] does.
    ///
    /// # Errors
    /// Returns any error of [`render`].
    pub fn new(
        rasterizer: &mut dyn Rasterizer,
        clouds: &SceneInstances,
        state: &SceneState,
        options: &ConditionOptions,
    ) -> Result<Self, ConditionError> {
        let asked = options.clone();
        let maps = asked.maps.with_parts(state.map.is_some());
        let options = &ConditionOptions { maps, ..options.clone() };
        let LayoutInputs { boxes, map } = LayoutInputs::of(state, options.maps)?;
        let center = state.global_from_ego.translation.truncate();
        let crop = Crop { center, radius_m: options.radius_m };
        let views: Vec<View> = state.cameras.iter().map(|camera| camera.view.clone()).collect();
        let memory = memory::reserve_step(&views, options)?;
        let points = Points::begin(rasterizer, clouds, &views, Some(crop), options)?;
        // The device processes the points meanwhile.
        let start = Instant::now();
        let layouts = layout::draw(boxes, map, &views, options);
        if boxes.is_some() || map.is_some() {
            rasterizer.stages().add("layouts", start.elapsed());
        }
        Ok(Self { points, layouts, asked, _memory: memory })
    }

    /// Waits for the maps. `rasterizer` must be the one that the step was started with.
    ///
    /// # Errors
    /// Returns an error if the rasterizer fails.
    pub fn finish(self, rasterizer: &mut dyn Rasterizer) -> Result<ConditionSet, ConditionError> {
        let mut cameras = self.points.finish(rasterizer)?;
        add_layouts(&mut cameras, self.layouts);
        let mut set = ConditionSet { cameras };
        set.make_tensors(&self.asked);
        Ok(set)
    }
}

/// Point-based maps of a step, in flight.
#[derive(Debug)]
struct Points {
    blank: Vec<CameraConditions>,
    options: ConditionOptions,
    /// Color of each view, if the rasterizer cannot reduce it.
    color: Option<Vec<Vec<[u8; 3]>>>,
    /// Whether a frame was submitted to the rasterizer.
    in_flight: bool,
}

impl Points {
    fn begin(
        rasterizer: &mut dyn Rasterizer,
        clouds: &SceneInstances,
        views: &[View],
        crop: Option<Crop>,
        options: &ConditionOptions,
    ) -> Result<Self, ConditionError> {
        let blank: Vec<CameraConditions> = views.iter().map(|view| blank(view, options)).collect();
        let views: Vec<View> = views.iter().map(|view| options.drawn_view(view)).collect();
        let by_area = options.color_filter.needs_depth() && options.out_size.is_some();
        let by_area = by_area && options.maps.contains(MapKind::Color);
        let maps = if by_area { options.maps.without(MapKind::Color) } else { options.maps };
        let job = FrameJob {
            views: &views,
            schedule: &options.splat,
            color: &clouds.color,
            geometry: &clouds.geometry,
            occlusion: options.occlusion,
            crop,
            maps,
            out_size: options.out_size,
        };
        let mut color = |(view, to): (&View, &CameraConditions)| {
            mean_color(rasterizer, &job, view, to.size(), options.color_filter)
        };
        let color = by_area
            .then(|| views.iter().zip(&blank).map(&mut color).collect::<Result<_, _>>())
            .transpose()?;
        let in_flight = maps.intersects(MapSet::SPLATTED) && !views.is_empty();
        if in_flight {
            rasterizer.begin(&job)?;
        }
        Ok(Self { blank, options: options.clone(), color, in_flight })
    }

    fn finish(self, rasterizer: &mut dyn Rasterizer) -> Result<Vec<CameraConditions>, ConditionError> {
        let mut cameras = self.blank;
        if self.in_flight {
            let maps = rasterizer.finish()?;
            let start = Instant::now();
            cameras.par_iter_mut().zip(maps).for_each(|(camera, maps)| fill(camera, maps, &self.options));
            rasterizer.stages().add("convert", start.elapsed());
        }
        for (camera, color) in cameras.iter_mut().zip(self.color.into_iter().flatten()) {
            camera.color = Some(color);
        }
        Ok(cameras)
    }
}

/// Converts the rasterizer's maps to the maps of the contract.
fn fill(camera: &mut CameraConditions, maps: ViewMaps<'_>, options: &ConditionOptions) {
    let wants = |kind| options.maps.contains(kind);
    camera.color = wants(MapKind::Color).then(|| maps.rgb_class.iter().map(|p| rgb_of(*p)).collect());
    camera.class = wants(MapKind::Class).then(|| maps.rgb_class.iter().map(|p| class_of(*p)).collect());
    camera.depth_m = wants(MapKind::Depth).then(|| maps.depth_m.into_owned());
    camera.instance = wants(MapKind::Instance).then(|| maps.instance.into_owned());
    camera.point = wants(MapKind::Point).then(|| maps.point.into_owned());
}

/// Renders color reduced to the mean of the pixels that are not empty, or of those that are visible. The
/// filter needs all pixels, so the map is rendered at full size and reduced here. Depth identifies empty
/// pixels, since a point can be black.
fn mean_color(
    rasterizer: &mut dyn Rasterizer,
    job: &FrameJob<'_>,
    view: &View,
    to: ImageSize,
    filter: ColorFilter,
) -> Result<Vec<[u8; 3]>, ConditionError> {
    let maps = MapSet::of(&[MapKind::Color, MapKind::Depth]);
    let (schedule, instances, crop) = (job.schedule, job.color, job.crop);
    let maps = rasterizer.splat(&SplatJob { view, schedule, instances, crop, maps })?;
    let color: Vec<[u8; 3]> = maps.rgb_class.iter().map(|p| rgb_of(*p)).collect();
    let from = ImageSize::of(&view.camera);
    if filter == ColorFilter::ValidArea {
        return Ok(reduce::valid_area(&color, &maps.depth_m, from, to));
    }
    // Surfaces reach over gaps up to one result pixel to each side, and two up and down.
    let radius = from.height.div_ceil(to.height).max(from.width.div_ceil(to.width));
    Ok(reduce::valid_area(&color, &without_hidden(&maps.depth_m, from, radius as usize), from, to))
}
