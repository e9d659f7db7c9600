//! Lens distortion of condition maps, so that they match recorded images.
//!
//! # How it works
//! Rasterizers render pinhole images. A lens shows other parts of the world, so the pinhole image is
//! enlarged, at the same focal length, until it covers everything that the lens shows. Every pixel of the
//! distorted map then takes the pinhole pixel that its center's ray hits. This is nearest sampling for all
//! maps, because a mean of depths or of instance numbers is meaningless. Reductions follow.
//!
//! A wide lens (MEI, f-theta) may show more than any pinhole image can. Its pixels beyond the largest pinhole
//! image remain empty; [`uncovered`] returns their share.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::{
    CameraConditions, ConditionError, ConditionOptions, ConditionSet, ImageSize, MapKind, MapSet, reduce,
};
use crate::geometry::{Camera, CameraProjection, Lens, View};
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
    /// Returns [`uncovered`] of each camera.
    pub fn uncovered(&self) -> Vec<f64> {
        self.warps.iter().map(|warp| warp.uncovered).collect()
    }

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
    /// See [`uncovered`].
    uncovered: f64,
}

/// Part of the pinhole's image plane, in pixels of the camera's image.
#[derive(Clone, Copy, Debug)]
struct Cover {
    low: DVec2,
    high: DVec2,
}

/// Returns the share of a camera's pixels that show a ray beyond the largest pinhole image: they remain empty
/// in distorted maps. 0 for pinholes, and for Brown–Conrady lenses, which are refused instead.
pub fn uncovered(camera: &Camera) -> f64 {
    if !camera.lens.is_some_and(|lens| lens.prepared().is_wide()) {
        return 0.0;
    }
    let projection = camera.projection();
    let largest = Cover::largest(camera);
    let pixels = camera.width * camera.height;
    let is_uncovered = |pixel: &u32| {
        let ray = projection.ray(center(camera, *pixel));
        ray.is_some_and(|ray| pinhole_pixel(camera, ray).is_none_or(|at| !largest.contains(at)))
    };
    (0..pixels).into_par_iter().filter(is_uncovered).count() as f64 / f64::from(pixels)
}

/// Entry of [`Warp::sources`] for a pixel that no ray reaches.
const NO_SOURCE: u32 = u32::MAX;

impl Warp {
    fn new(camera: &Camera) -> Result<Self, ConditionError> {
        let size = ImageSize::of(camera);
        if camera.lens.is_none() {
            return Ok(Self { pinhole: camera.clone(), size, sources: None, uncovered: 0.0 });
        }
        let projection = camera.projection();
        let mut rays = rays(camera, &projection);
        if projection.lens().is_some_and(Lens::is_wide) {
            let largest = Cover::largest(camera);
            rays.par_iter_mut().for_each(|ray| *ray = ray.filter(|pixel| largest.contains(*pixel)));
        }
        let cover = Cover::of(size, &rays);
        let (low, sides) = (cover.low, cover.high - cover.low);
        let most = most(size);
        if sides.x > most.x || sides.y > most.y {
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
        Ok(Self { pinhole, size, sources, uncovered: uncovered(camera) })
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
    let ray = |pixel: u32| pinhole_pixel(camera, projection.ray(center(camera, pixel))?);
    (0..camera.width * camera.height).into_par_iter().map(ray).collect()
}

/// Returns where a pinhole camera of the same intrinsics sees a ray; `None` beside and behind the camera.
fn pinhole_pixel(camera: &Camera, ray: DVec3) -> Option<DVec2> {
    (ray.z > 0.0).then(|| (camera.intrinsics * (ray / ray.z)).truncate())
}

/// Returns the center of a pixel, numbered in row-major order.
fn center(camera: &Camera, pixel: u32) -> DVec2 {
    let (row, column) = (pixel / camera.width, pixel % camera.width);
    DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5)
}

/// Returns the sides of the largest pinhole image for an image, pixels.
fn most(size: ImageSize) -> DVec2 {
    let side = |side: u32| f64::from((side * MAX_GROWTH).min(Camera::MAX_SIDE));
    DVec2::new(side(size.width), side(size.height))
}

impl Cover {
    /// Returns the part that covers an image and pinhole pixels.
    fn of(size: ImageSize, pixels: &[Option<DVec2>]) -> Self {
        let image =
            Self { low: DVec2::ZERO, high: DVec2::new(f64::from(size.width), f64::from(size.height)) };
        pixels.iter().flatten().fold(image, |cover, pixel| Self {
            low: cover.low.min(pixel.floor()),
            high: cover.high.max(pixel.floor() + 1.0),
        })
    }

    /// Returns the largest part that a pinhole image covers, around the middle of the camera's image.
    fn largest(camera: &Camera) -> Self {
        let size = ImageSize::of(camera);
        let image = DVec2::new(f64::from(size.width), f64::from(size.height));
        let low = -((most(size) - image) / 2.0).floor();
        Self { low, high: low + most(size) }
    }

    fn contains(&self, pixel: DVec2) -> bool {
        pixel.cmpge(self.low).all() && pixel.cmplt(self.high).all()
    }
}
