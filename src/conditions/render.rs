use super::{ColorFilter, ConditionError, ConditionOptions, ImageSize, MapKind, Occlusion, layout, reduce};
use crate::geometry::View;
use crate::raster::{Crop, Instance, Planes, Rasterizer, SplatJob, SplatMaps};
use crate::scene::{ActorState, SceneInstances, SceneState};

/// Maps of one camera, row-major `height * width`; `None` where they were not asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraConditions {
    /// Channel name.
    pub name: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// RGB, black where empty.
    pub color: Option<Vec<[u8; 3]>>,
    /// Camera depth in metres, `f32::INFINITY` where empty.
    pub depth_m: Option<Vec<f32>>,
    /// Coarse class, 0 where empty.
    pub class: Option<Vec<u8>>,
    /// Actor number, 0 where empty and on the background.
    pub instance: Option<Vec<u32>>,
    /// RGB layout of boxes on black.
    pub boxes: Option<Vec<[u8; 3]>>,
    /// Number of the winning geometry point + 1, 0 where empty.
    pub point: Option<Vec<u32>>,
}

impl CameraConditions {
    /// Size of all maps.
    pub fn size(&self) -> ImageSize {
        ImageSize { height: self.height, width: self.width }
    }
}

/// Condition maps of one step, cameras in the step's order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConditionSet {
    /// One entry per camera.
    pub cameras: Vec<CameraConditions>,
}

impl ConditionOptions {
    /// The view as it is drawn: at [`ConditionOptions::size`], intrinsics scaled.
    pub fn drawn_view(&self, view: &View) -> View {
        let camera =
            self.size.map_or_else(|| view.camera.clone(), |s| view.camera.resized(s.height, s.width));
        View { camera, camera_from_world: view.camera_from_world }
    }

    /// Size of a camera's maps as they are written.
    pub fn written_size(&self, view: &View) -> ImageSize {
        self.out_size.or(self.size).unwrap_or_else(|| ImageSize::of(&view.camera))
    }
}

/// Makes the maps of a step: all cameras, cropped to a square of `options.radius_m` around the ego.
///
/// # Errors
/// The rasterizer's.
pub fn render(
    rasterizer: &mut dyn Rasterizer,
    clouds: &SceneInstances,
    state: &SceneState,
    options: &ConditionOptions,
) -> Result<ConditionSet, ConditionError> {
    let center = state.global_from_ego.translation.truncate();
    let crop = Crop { center, radius_m: options.radius_m };
    let mut cameras = Vec::with_capacity(state.cameras.len());
    for camera in &state.cameras {
        let mut maps = render_view(rasterizer, clouds, &camera.view, Some(crop), options)?;
        if options.maps.contains(MapKind::Boxes) {
            maps.boxes = Some(render_boxes(rasterizer, &state.actors, &camera.view, options)?);
        }
        cameras.push(maps);
    }
    Ok(ConditionSet { cameras })
}

/// Makes the maps of one view that come from points, so all but [`MapKind::Boxes`]. Where both clouds are the same,
/// one pass serves them.
///
/// # Errors
/// The rasterizer's.
pub fn render_view(
    rasterizer: &mut dyn Rasterizer,
    clouds: &SceneInstances,
    view: &View,
    crop: Option<Crop>,
    options: &ConditionOptions,
) -> Result<CameraConditions, ConditionError> {
    let to = options.written_size(view);
    let view = options.drawn_view(view);
    let mut splat = |instances: &[Instance], planes: Planes| -> Result<SplatMaps, ConditionError> {
        if planes == Planes::NONE {
            return Ok(SplatMaps::default());
        }
        Ok(rasterizer.splat(&SplatJob { view: &view, schedule: &options.splat, instances, crop, planes })?)
    };
    let planes = WantedPlanes::of(options);
    let one_pass = clouds.color == clouds.geometry;
    let geometry_planes = if one_pass { either(planes.color, planes.geometry) } else { planes.geometry };
    let geometry = splat(&clouds.geometry, geometry_planes)?;
    let color_pass;
    let color = if one_pass {
        &geometry
    } else {
        color_pass = splat(&clouds.color, planes.color)?;
        &color_pass
    };
    let actors_pass;
    let actors = if options.occlusion == Occlusion::Scene {
        &geometry
    } else {
        let actors: Vec<Instance> = clouds.geometry.iter().filter(|i| i.number > 0).copied().collect();
        actors_pass = splat(&actors, planes.actors)?;
        &actors_pass
    };
    let reduction = Reduction { from: ImageSize::of(&view.camera), to, options };
    Ok(CameraConditions {
        name: view.camera.name.clone(),
        width: to.width,
        height: to.height,
        color: reduction.color(color),
        depth_m: reduction.nearest(MapKind::Depth, &geometry.depth_m),
        class: reduction.class(actors),
        instance: reduction.nearest(MapKind::Instance, &actors.instance),
        boxes: None,
        point: reduction.nearest(MapKind::Point, &geometry.point),
    })
}

fn render_boxes(
    rasterizer: &mut dyn Rasterizer,
    actors: &[ActorState],
    view: &View,
    options: &ConditionOptions,
) -> Result<Vec<[u8; 3]>, ConditionError> {
    let to = options.written_size(view);
    let view = options.drawn_view(view);
    let (height, width) = (view.camera.height, view.camera.width);
    let segments = layout::box_segments(actors, &view);
    let image = rasterizer.lines(height, width, &segments, layout::LINE_WIDTH_PX)?;
    Ok(reduce::pil_bilinear(&image, ImageSize { height, width }, to))
}

/// Which planes each pass has to fill.
struct WantedPlanes {
    color: Planes,
    geometry: Planes,
    /// A pass of its own with [`Occlusion::Actors`], else none.
    actors: Planes,
}

impl WantedPlanes {
    fn of(options: &ConditionOptions) -> Self {
        let wants = |kind| options.maps.contains(kind);
        let color = wants(MapKind::Color);
        // The mean over pixels that are not empty has to know which ones are: a black point is not empty.
        let valid = color && options.color_filter == ColorFilter::ValidArea;
        let actors =
            Planes { rgb_class: wants(MapKind::Class), instance: wants(MapKind::Instance), ..Planes::NONE };
        let geometry = Planes { depth: wants(MapKind::Depth), point: wants(MapKind::Point), ..Planes::NONE };
        let color = Planes { rgb_class: color, depth: valid, ..Planes::NONE };
        match options.occlusion {
            Occlusion::Scene => Self { color, geometry: either(geometry, actors), actors: Planes::NONE },
            Occlusion::Actors => Self { color, geometry, actors },
        }
    }
}

fn either(a: Planes, b: Planes) -> Planes {
    Planes {
        point: a.point || b.point,
        depth: a.depth || b.depth,
        rgb_class: a.rgb_class || b.rgb_class,
        instance: a.instance || b.instance,
    }
}

/// From the size that was drawn to the size that is written.
struct Reduction<'a> {
    from: ImageSize,
    to: ImageSize,
    options: &'a ConditionOptions,
}

impl Reduction<'_> {
    fn nearest<T: Copy + Send + Sync>(&self, kind: MapKind, map: &[T]) -> Option<Vec<T>> {
        self.options.maps.contains(kind).then(|| reduce::nearest(map, self.from, self.to))
    }

    fn class(&self, pass: &SplatMaps) -> Option<Vec<u8>> {
        let packed = self.nearest(MapKind::Class, &pass.rgb_class)?;
        Some(packed.into_iter().map(|packed| packed.to_le_bytes()[3]).collect())
    }

    fn color(&self, pass: &SplatMaps) -> Option<Vec<[u8; 3]>> {
        if !self.options.maps.contains(MapKind::Color) {
            return None;
        }
        let rgb = |packed: &u32| {
            let [r, g, b, _] = packed.to_le_bytes();
            [r, g, b]
        };
        let color: Vec<[u8; 3]> = pass.rgb_class.iter().map(rgb).collect();
        if self.from == self.to {
            return Some(color);
        }
        Some(match self.options.color_filter {
            ColorFilter::Bilinear => reduce::bilinear(&color, self.from, self.to),
            ColorFilter::ValidArea => reduce::valid_area(&color, &pass.depth_m, self.from, self.to),
        })
    }
}
