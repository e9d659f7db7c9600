use super::maps::reduce;
use super::{Crop, Instance, MapKind, MapSet, Plane, RasterError, SplatJob, SplatMaps, SplatSchedule};
use crate::geometry::{ImageSize, View};
use crate::{named, named_in_files};

/// Which points occlude an actor in the class and instance maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Occlusion {
    /// All points in front of it.
    #[default]
    Scene,
    /// Only points of other actors.
    Actors,
}

named!(Occlusion, "occlusion" {
    Scene => "scene", "All points in front of it";
    Actors => "actors", "Only points of other actors";
});
named_in_files!(Occlusion);

/// Input of a frame: two clouds in all cameras of one instant.
#[derive(Clone, Copy, Debug)]
pub struct FrameJob<'a> {
    /// Cameras to render.
    pub views: &'a [View],
    /// Splat radius by depth.
    pub schedule: &'a SplatSchedule,
    /// Cloud for the color map. Earlier instances win depth ties.
    pub color: &'a [Instance],
    /// Cloud for all other maps; point numbers are consecutive across it. Instances that both clouds share at
    /// the same position of their order are splatted once.
    pub geometry: &'a [Instance],
    /// Occlusion of actors (instances of the geometry cloud with a number above 0).
    pub occlusion: Occlusion,
    /// Crop of the points; `None` for all points.
    pub crop: Option<Crop>,
    /// Maps to render; only maps in [`MapSet::SPLATTED`] count.
    pub maps: MapSet,
    /// Size that all maps are reduced to: color as OpenCV's INTER_LINEAR, all others as its INTER_NEAREST.
    /// `None` for the size of each view.
    pub out_size: Option<ImageSize>,
}

impl FrameJob<'_> {
    /// Returns the size of a view's maps.
    pub fn size_of(&self, view: &View) -> ImageSize {
        self.out_size.unwrap_or_else(|| ImageSize::of(&view.camera))
    }
}

/// Maps of one view, row-major `height * width`; a map that was not requested has length 0. Borrows the
/// memory that the device wrote where possible.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewMaps<'a> {
    /// Size of all maps.
    pub size: ImageSize,
    /// `r | g << 8 | b << 16 | class << 24`; zero where empty, and in the bytes of a map that was not
    /// requested. Length 0 if neither color nor class is requested.
    pub rgb_class: Plane<'a, u32>,
    /// Camera depth in meters, `f32::INFINITY` where empty.
    pub depth_m: Plane<'a, f32>,
    /// [`Instance::number`] of the winning point, 0 where empty.
    pub instance: Plane<'a, u32>,
    /// Number of the winning point + 1, 0 where empty. Points are numbered across the geometry instances in
    /// order.
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
    let mut splat = |instances: &[Instance], maps: MapSet| -> Result<SplatMaps, RasterError> {
        if maps == MapSet::NONE {
            return Ok(SplatMaps::default());
        }
        splat(&SplatJob { view, schedule, instances, crop, maps })
    };
    let one_pass = job.color == job.geometry;
    let actor_maps = job.maps & MapSet::ACTORS;
    let mut geometry_maps = job.maps & MapSet::GEOMETRY;
    if job.occlusion == Occlusion::Scene {
        geometry_maps = geometry_maps | actor_maps;
    }
    if one_pass {
        geometry_maps = geometry_maps | job.maps & MapSet::COLOR;
    }
    let geometry = splat(job.geometry, geometry_maps)?;
    let color_pass;
    let color = if one_pass {
        &geometry
    } else {
        color_pass = splat(job.color, job.maps & MapSet::COLOR)?;
        &color_pass
    };
    let actors_pass;
    let actors = if job.occlusion == Occlusion::Scene {
        &geometry
    } else {
        let actors: Vec<Instance> = job.geometry.iter().filter(|i| i.number > 0).copied().collect();
        actors_pass = splat(&actors, actor_maps)?;
        &actors_pass
    };
    let (from, to) = (ImageSize::of(&view.camera), job.size_of(view));
    let words = |kind: MapKind, map: &[u32]| -> Plane<'static, u32> {
        if job.maps.contains(kind) { reduce::nearest(map, from, to).into() } else { Vec::new().into() }
    };
    let wants_depth = job.maps.contains(MapKind::Depth);
    let depth_m = if wants_depth { reduce::nearest(&geometry.depth_m, from, to) } else { Vec::new() };
    Ok(ViewMaps {
        size: to,
        rgb_class: rgb_class(job.maps, color, actors, from, to).into(),
        depth_m: depth_m.into(),
        instance: words(MapKind::Instance, &actors.instance),
        point: words(MapKind::Point, &geometry.point),
    })
}

/// Combines the color of one pass with the class of another, both reduced.
fn rgb_class(
    maps: MapSet,
    color: &SplatMaps,
    actors: &SplatMaps,
    from: ImageSize,
    to: ImageSize,
) -> Vec<u32> {
    let mut packed = Vec::new();
    if maps.contains(MapKind::Color) {
        let rgb: Vec<[u8; 3]> = color.rgb_class.iter().map(|p| rgb_of(*p)).collect();
        let rgb = if from == to { rgb } else { reduce::bilinear(&rgb, from, to) };
        packed = rgb.into_iter().map(|[r, g, b]| u32::from_le_bytes([r, g, b, 0])).collect();
    }
    if maps.contains(MapKind::Class) {
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
