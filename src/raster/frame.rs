use serde::Serialize;

use super::{Crop, Instance, Plane, Planes, RasterError, SplatJob, SplatMaps, SplatSchedule, reduce};
use crate::geometry::{ImageSize, View};

/// Which points occlude an actor in the class and instance maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Occlusion {
    /// All points in front of it.
    #[default]
    Scene,
    /// Only points of other actors.
    Actors,
}

/// Maps of a frame to render.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)]
pub struct FrameKinds {
    /// Color of the nearest point of the color cloud.
    pub color: bool,
    /// Camera depth of the nearest point of the geometry cloud.
    pub depth: bool,
    /// Class of that point (see [`Occlusion`]).
    pub class: bool,
    /// Instance number of that point (see [`Occlusion`]).
    pub instance: bool,
    /// Point number of that point.
    pub point: bool,
}

impl FrameKinds {
    /// All maps.
    pub const ALL: Self = Self { color: true, depth: true, class: true, instance: true, point: true };
}

/// Input of a frame: two clouds in all cameras of one instant.
#[derive(Clone, Copy, Debug)]
pub struct FrameJob<'a> {
    /// Cameras to render.
    pub views: &'a [View],
    /// Splat radius by depth.
    pub schedule: &'a SplatSchedule,
    /// Cloud for the color map. Earlier instances win depth ties.
    pub color: &'a [Instance],
    /// Cloud for all other maps; point numbers are consecutive across it. Instances that both clouds share at the
    /// same position of their order are splatted once.
    pub geometry: &'a [Instance],
    /// Occlusion of actors (instances of the geometry cloud with a number above 0).
    pub occlusion: Occlusion,
    /// Crop of the points; `None` for all points.
    pub crop: Option<Crop>,
    /// Maps to render.
    pub kinds: FrameKinds,
    /// Size that all maps are reduced to: color as OpenCV's INTER_LINEAR, all others as its INTER_NEAREST. `None`
    /// for the size of each view.
    pub out_size: Option<ImageSize>,
}

impl FrameJob<'_> {
    /// Returns the size of a view's maps.
    pub fn size_of(&self, view: &View) -> ImageSize {
        self.out_size.unwrap_or_else(|| ImageSize::of(&view.camera))
    }
}

/// Maps of one view, row-major `height * width`; a map that was not requested has length 0. Borrows the memory that
/// the device wrote where possible.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewMaps<'a> {
    /// Size of all maps.
    pub size: ImageSize,
    /// `r | g << 8 | b << 16 | class << 24`; zero where empty, and in the bytes of a map that was not requested.
    /// Length 0 if neither color nor class is requested.
    pub rgb_class: Plane<'a, u32>,
    /// Camera depth in meters, `f32::INFINITY` where empty.
    pub depth_m: Plane<'a, f32>,
    /// [`Instance::number`] of the winning point, 0 where empty.
    pub instance: Plane<'a, u32>,
    /// Number of the winning point + 1, 0 where empty. Points are numbered across the geometry instances in order.
    pub point: Plane<'a, u32>,
}

/// Maps of a frame, one entry per view of the job.
pub type FrameMaps<'a> = Vec<ViewMaps<'a>>;

/// Renders a frame view by view and cloud by cloud, and reduces on the host. Used by rasterizers that
/// implement only `splat`.
pub(super) fn frame_by_views(
    job: &FrameJob<'_>,
    splat: &mut dyn FnMut(&SplatJob<'_>) -> Result<SplatMaps, RasterError>,
) -> Result<FrameMaps<'static>, RasterError> {
    job.views.iter().map(|view| view_of_frame(job, view, splat)).collect()
}

fn view_of_frame(
    job: &FrameJob<'_>,
    view: &View,
    splat: &mut dyn FnMut(&SplatJob<'_>) -> Result<SplatMaps, RasterError>,
) -> Result<ViewMaps<'static>, RasterError> {
    let (schedule, crop) = (job.schedule, job.crop);
    let mut splat = |instances: &[Instance], planes: Planes| -> Result<SplatMaps, RasterError> {
        if planes == Planes::NONE {
            return Ok(SplatMaps::default());
        }
        splat(&SplatJob { view, schedule, instances, crop, planes })
    };
    let kinds = job.kinds;
    let color_planes = Planes { rgb_class: kinds.color, ..Planes::NONE };
    let actor_planes = Planes { rgb_class: kinds.class, instance: kinds.instance, ..Planes::NONE };
    let mut geometry_planes = Planes { depth: kinds.depth, point: kinds.point, ..Planes::NONE };
    if job.occlusion == Occlusion::Scene {
        geometry_planes = geometry_planes.and(actor_planes);
    }
    let one_pass = job.color == job.geometry;
    let geometry =
        splat(job.geometry, if one_pass { geometry_planes.and(color_planes) } else { geometry_planes })?;
    let color_pass;
    let color = if one_pass {
        &geometry
    } else {
        color_pass = splat(job.color, color_planes)?;
        &color_pass
    };
    let actors_pass;
    let actors = if job.occlusion == Occlusion::Scene {
        &geometry
    } else {
        let actors: Vec<Instance> = job.geometry.iter().filter(|i| i.number > 0).copied().collect();
        actors_pass = splat(&actors, actor_planes)?;
        &actors_pass
    };
    let (from, to) = (ImageSize::of(&view.camera), job.size_of(view));
    let words = |wanted: bool, map: &[u32]| -> Plane<'static, u32> {
        if wanted { reduce::nearest(map, from, to).into() } else { Vec::new().into() }
    };
    let depth_m = if kinds.depth { reduce::nearest(&geometry.depth_m, from, to) } else { Vec::new() };
    Ok(ViewMaps {
        size: to,
        rgb_class: rgb_class(kinds, color, actors, from, to).into(),
        depth_m: depth_m.into(),
        instance: words(kinds.instance, &actors.instance),
        point: words(kinds.point, &geometry.point),
    })
}

/// Combines the color of one pass with the class of another, both reduced.
fn rgb_class(
    kinds: FrameKinds,
    color: &SplatMaps,
    actors: &SplatMaps,
    from: ImageSize,
    to: ImageSize,
) -> Vec<u32> {
    let mut packed = Vec::new();
    if kinds.color {
        let rgb: Vec<[u8; 3]> = color.rgb_class.iter().map(|p| rgb_of(*p)).collect();
        let rgb = if from == to { rgb } else { reduce::bilinear(&rgb, from, to) };
        packed = rgb.into_iter().map(|[r, g, b]| u32::from_le_bytes([r, g, b, 0])).collect();
    }
    if kinds.class {
        let class = reduce::nearest(&actors.rgb_class, from, to);
        packed.resize(to.pixels(), 0);
        packed.iter_mut().zip(class).for_each(|(packed, class)| *packed |= class & 0xff00_0000);
    }
    packed
}

/// Returns the color of a packed pixel.
pub fn rgb_of(rgb_class: u32) -> [u8; 3] {
    let [r, g, b, _] = rgb_class.to_le_bytes();
    [r, g, b]
}

/// Returns the class of a packed pixel.
pub fn class_of(rgb_class: u32) -> u8 {
    rgb_class.to_le_bytes()[3]
}
