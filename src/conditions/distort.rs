//! Lens distortion of condition maps, so that they match recorded images.
//!
//! # How it works
//! Rasterizers render pinhole images. A lens shows other parts of the world, so the pinhole image is
//! enlarged, at the same focal length, until it covers everything that the lens shows. Every pixel of the
//! distorted map then takes the pinhole pixel that its center's ray hits. This is nearest sampling for all
//! maps, because a mean of depths or of instance numbers is meaningless. Reductions follow.

use std::sync::Arc;

use glam::DVec2;
use rayon::prelude::*;

use super::{
    CameraConditions, ConditionError, ConditionOptions, ConditionSet, ImageSize, MapKind, MapSet, reduce,
};
use crate::geometry::{Camera, CameraProjection, View};
use crate::memory::{Need, reserve};
use crate::scene::SceneState;

/// Maximum ratio between a side of the pinhole image and the same side of the camera's image.
const MAX_GROWTH: u32 = 4;

/// Memory per pixel while a warp is computed: its ray, and its entry in the table.
const RAY_BYTES: u64 = (size_of::<Option<DVec2>>() + size_of::<u32>()) as u64;

/// Distorts the maps of consecutive steps; a camera's warp is computed once and reused while the cameras stay
/// the same.
#[derive(Clone, Debug)]
pub struct Distorter {
    options: ConditionOptions,
    /// Cameras as rendered, with their warps.
    known: Vec<(Camera, Arc<Warp>)>,
}

/// Step to render so that its maps can be distorted.
#[derive(Clone, Debug)]
pub struct PinholeStep {
    /// The state with pinhole cameras that cover everything that the lenses show.
    pub state: SceneState,
    /// Options for rendering that state: maps at full size.
    pub options: ConditionOptions,
    asked: ConditionOptions,
    warps: Vec<Arc<Warp>>,
}

impl Distorter {
    /// Creates a distorter for maps rendered with these options.
    ///
    /// # Errors
    /// Returns an error for a color filter that needs to know which pixels are empty.
    pub fn new(options: &ConditionOptions) -> Result<Self, ConditionError> {
        if options.color_filter.needs_depth() {
            return Err(ConditionError::DistortedArea);
        }
        Ok(Self { options: options.clone(), known: Vec::new() })
    }

    /// Returns the step to render in place of `state` for these maps.
    ///
    /// # Errors
    /// Returns an error if a lens shows more than a pinhole image of reasonable size can cover.
    pub fn pinholes(&mut self, state: &SceneState, maps: MapSet) -> Result<PinholeStep, ConditionError> {
        let mut state = state.clone();
        let mut warps = Vec::with_capacity(state.cameras.len());
        // Pinhole images are drawn at the scale of the recorded ones, and are larger where the lens shows
        // more.
        let line_scales = state.cameras.iter().map(|camera| self.options.line_scale(&camera.view)).collect();
        for camera in &mut state.cameras {
            let drawn = self.options.drawn_view(&camera.view).camera;
            let warp = self.warp(&drawn)?;
            camera.view = View { camera: warp.pinhole.clone(), ..camera.view };
            warps.push(warp);
        }
        // The cache would grow without bound on a log whose calibration changes from frame to frame.
        self.known.retain(|(_, known)| warps.iter().any(|warp| Arc::ptr_eq(warp, known)));
        let asked = ConditionOptions { maps, ..self.options.clone() };
        // Model tensors are encoded from the distorted maps.
        let maps = asked.maps.with_parts(state.map.is_some()).without(MapKind::Tensor);
        let line_scales = Some(line_scales);
        let options = ConditionOptions { maps, size: None, out_size: None, line_scales, ..asked.clone() };
        Ok(PinholeStep { state, options, asked, warps })
    }

    fn warp(&mut self, camera: &Camera) -> Result<Arc<Warp>, ConditionError> {
        if let Some((_, warp)) = self.known.iter().find(|(known, _)| known == camera) {
            return Ok(Arc::clone(warp));
        }
        let size = ImageSize::of(camera);
        let bytes = size.pixels() as u64 * RAY_BYTES;
        let _rays = reserve(bytes, || Need {
            what: format!("the lens distortion of an image of {size} pixels"),
            bytes,
            advice: "smaller cameras and --size need less",
        })?;
        let warp = Arc::new(Warp::new(camera)?);
        self.known.push((camera.clone(), Arc::clone(&warp)));
        Ok(warp)
    }
}

impl PinholeStep {
    /// Distorts and reduces the maps rendered from [`PinholeStep::state`].
    pub fn distort(&self, set: ConditionSet) -> ConditionSet {
        let camera = |(camera, warp): (CameraConditions, &Arc<Warp>)| {
            let to = self.asked.out_size.unwrap_or(warp.size);
            warp.resample(camera, to)
        };
        let mut set =
            ConditionSet { cameras: set.cameras.into_iter().zip(&self.warps).map(camera).collect() };
        set.make_tensors(&self.asked);
        set
    }
}

/// Lookup table from a distorted image to its pinhole image.
#[derive(Clone, Debug)]
struct Warp {
    pinhole: Camera,
    /// Size of the distorted image.
    size: ImageSize,
    /// For each pixel of the distorted image, the index of the pinhole pixel; `None` if the images are the
    /// same.
    sources: Option<Vec<u32>>,
}

/// Entry of [`Warp::sources`] for a pixel that no ray reaches.
const NO_SOURCE: u32 = u32::MAX;

impl Warp {
    fn new(camera: &Camera) -> Result<Self, ConditionError> {
        let size = ImageSize::of(camera);
        if camera.lens.is_none() {
            return Ok(Self { pinhole: camera.clone(), size, sources: None });
        }
        let rays = rays(camera, &camera.projection());
        let (mut low, mut high) = (DVec2::ZERO, DVec2::new(f64::from(size.width), f64::from(size.height)));
        for pixel in rays.iter().flatten() {
            (low, high) = (low.min(pixel.floor()), high.max(pixel.floor() + 1.0));
        }
        let sides = high - low;
        let most = |side: u32| f64::from((side * MAX_GROWTH).min(Camera::MAX_SIDE));
        if sides.x > most(size.width) || sides.y > most(size.height) {
            let (camera, growth) = (camera.name.to_string(), MAX_GROWTH);
            return Err(ConditionError::Lens { camera, size, height: sides.y, width: sides.x, growth });
        }
        let width = sides.x as u32;
        let mut pinhole = Camera { width, height: sides.y as u32, lens: None, ..camera.clone() };
        pinhole.intrinsics.z_axis -= low.extend(0.0);
        let source = |ray: &Option<DVec2>| {
            let Some(pixel) = ray else { return NO_SOURCE };
            let at = pixel.floor() - low;
            at.y as u32 * width + at.x as u32
        };
        let sources = Some(rays.iter().map(source).collect());
        Ok(Self { pinhole, size, sources })
    }

    fn resample(&self, maps: CameraConditions, to: ImageSize) -> CameraConditions {
        let CameraConditions { name, color, depth_m, class, instance, boxes, map, point, .. } = maps;
        CameraConditions {
            name,
            width: to.width,
            height: to.height,
            color: color.map(|map| reduce::bilinear(&self.pick(map, [0; 3]), self.size, to)),
            depth_m: depth_m.map(|map| self.reduced(map, f32::INFINITY, to)),
            class: class.map(|map| self.reduced(map, 0, to)),
            instance: instance.map(|map| self.reduced(map, 0, to)),
            boxes: boxes.map(|map| reduce::pil_bilinear(&self.pick(map, [0; 3]), self.size, to)),
            map: map.map(|map| reduce::pil_bilinear(&self.pick(map, [0; 3]), self.size, to)),
            point: point.map(|map| self.reduced(map, 0, to)),
            tensor: None,
        }
    }

    /// Distorts a map and reduces it by nearest sampling.
    fn reduced<T: Copy + Send + Sync>(&self, map: Vec<T>, empty: T, to: ImageSize) -> Vec<T> {
        let picked = self.pick(map, empty);
        if self.size == to { picked } else { reduce::nearest(&picked, self.size, to) }
    }

    /// Returns the distorted map.
    fn pick<T: Copy + Send + Sync>(&self, map: Vec<T>, empty: T) -> Vec<T> {
        let Some(sources) = &self.sources else { return map };
        let pixel = |source: &u32| map.get(*source as usize).copied().unwrap_or(empty);
        sources.par_iter().map(pixel).collect()
    }
}

/// Returns, for the center of every pixel in row-major order, where a pinhole camera of the same intrinsics
/// sees the point that the lens shows; `None` if the lens shows nothing there.
fn rays(camera: &Camera, projection: &CameraProjection) -> Vec<Option<DVec2>> {
    let ray = |pixel: u32| {
        let (row, column) = (pixel / camera.width, pixel % camera.width);
        let center = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = projection.ray(center).filter(|ray| ray.z > 0.0)?;
        Some((camera.intrinsics * (ray / ray.z)).truncate())
    };
    (0..camera.width * camera.height).into_par_iter().map(ray).collect()
}
