use serde::Serialize;

use super::{Crop, Instance, Plane, Planes, RasterError, SplatJob, SplatMaps, SplatSchedule, reduce};
use crate::geometry::{ImageSize, View};

/// What hides an actor in the class and instance maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Occlusion {
    /// Whatever is in front of it.
    #[default]
    Scene,
    /// Only other actors.
    Actors,
}

/// Which maps a frame has.
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
    /// Number of that point.
    pub point: bool,
}

impl FrameKinds {
    /// All of them.
    pub const ALL: Self = Self { color: true, depth: true, class: true, instance: true, point: true };
}

/// What a frame shows: two clouds in all cameras of one instant.
#[derive(Clone, Copy, Debug)]
pub struct FrameJob<'a> {
    /// The cameras as they are drawn.
    pub views: &'a [View],
    /// Radius by depth.
    pub schedule: &'a SplatSchedule,
    /// The cloud that gives color. Earlier instances win ties of depth.
    pub color: &'a [Instance],
    /// The cloud that gives all else; point numbers run through it. What both clouds have in common at the same place
    /// of their order is splatted once.
    pub geometry: &'a [Instance],
    /// What hides actors (instances of the geometry cloud with a number above 0).
    pub occlusion: Occlusion,
    /// Which points are used at all; `None` for all.
    pub crop: Option<Crop>,
    /// Which maps are wanted.
    pub kinds: FrameKinds,
    /// All maps are reduced to this size: color as OpenCV's INTER_LINEAR, all else as its INTER_NEAREST. `None` for the
    /// size of each view.
    pub out_size: Option<ImageSize>,
}

impl FrameJob<'_> {
    /// Size of a view's maps.
    pub fn size_of(&self, view: &View) -> ImageSize {
        self.out_size.unwrap_or_else(|| ImageSize::of(&view.camera))
    }
}

/// Maps of one view, row-major `height * width`; a map that was not asked for has length 0. Borrowed from the memory
/// that the device wrote them to where that is possible.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewMaps<'a> {
    /// Of all maps.
    pub size: ImageSize,
    /// `r | g << 8 | b << 16 | class << 24`; zero where empty, and in the bytes of what was not asked for. Length 0 if
    /// neither color nor class is wanted.
    pub rgb_class: Plane<'a, u32>,
    /// Camera depth in metres, `f32::INFINITY` where empty.
    pub depth_m: Plane<'a, f32>,
    /// [`Instance::number`] of the winning point, 0 where empty.
    pub instance: Plane<'a, u32>,
    /// Number of the winning point + 1, 0 where empty. Points are numbered through the geometry instances in order.
    pub point: Plane<'a, u32>,
}

/// Maps of a frame, one entry per view of the job.
pub type FrameMaps<'a> = Vec<ViewMaps<'a>>;

/// Draws a frame view by view and cloud by cloud, and reduces on the host: how a rasterizer that knows only `splat`
/// makes frames.
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

/// Color of one pass and class of another, reduced.
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

/// The color of a packed pixel.
pub fn rgb_of(rgb_class: u32) -> [u8; 3] {
    let [r, g, b, _] = rgb_class.to_le_bytes();
    [r, g, b]
}

/// The class of a packed pixel.
pub fn class_of(rgb_class: u32) -> u8 {
    rgb_class.to_le_bytes()[3]
}
