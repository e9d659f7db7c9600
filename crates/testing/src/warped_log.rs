//! A recording with the images of other lenses, warped from its own.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use image::imageops::interpolate_bilinear;
use image::{Rgb, RgbImage};
use point_skeleton::dataset::{DatasetError, ImageRecord, LogReader, Recording, Sweep, SweepRecord};
use point_skeleton::geometry::{Camera, LensModel};

/// Log with other cameras.
pub struct WarpedLog {
    log: Arc<dyn LogReader>,
    recording: Recording,
    /// Cameras of images, each with the original.
    cameras: Vec<(Camera, Camera)>,
}

impl WarpedLog {
    /// Replaces the cameras of a log by those that `warped` returns.
    pub fn new(log: Arc<dyn LogReader>, warped: impl Fn(&Camera) -> Camera) -> Self {
        let mut recording = log.recording().clone();
        let mut cameras: Vec<(Camera, Camera)> = Vec::new();
        let images =
            recording.frames.iter_mut().flat_map(|f| f.images.iter_mut().chain(&mut f.between_images));
        let images = images.map(|image| Arc::make_mut(&mut image.camera));
        for camera in recording.rig.iter_mut().map(|rig| &mut rig.camera).chain(images) {
            let known = cameras.iter().find(|(_, original)| original == camera).map(|(new, _)| new.clone());
            let new = known.unwrap_or_else(|| warped(camera));
            let original = std::mem::replace(camera, new.clone());
            if !cameras.iter().any(|(other, _)| *other == new) {
                cameras.push((new, original));
            }
        }
        Self { log, recording, cameras }
    }
}

impl LogReader for WarpedLog {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        self.log.read_sweep(record)
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        // A test may state a wrong lens for an image.
        let is_same = |new: &Camera| Camera { lens: new.lens, ..Camera::clone(&record.camera) } == *new;
        let (new, original) = self.cameras.iter().find(|(new, _)| is_same(new)).unwrap();
        let image =
            self.log.read_image(&ImageRecord { camera: original.clone().into(), ..record.clone() })?;
        Ok(warp(&image, original, new))
    }

    fn check_image(&self, record: &ImageRecord) -> Result<(), DatasetError> {
        self.read_image(record).map(|_| ())
    }
}

/// Returns a camera of the same size with a lens, as wide as the image of a pinhole covers it: no pixel shows
/// a ray outside that image. The lens bends rays outward the more, the farther they are from the axis.
pub fn covered(pinhole: &Camera, lens: LensModel) -> Camera {
    let (width, height) = (f64::from(pinhole.width), f64::from(pinhole.height));
    let plane_from_image = pinhole.intrinsics.inverse();
    let shrinks = |[x, y]: [f64; 2]| {
        let ideal = (plane_from_image * DVec3::new(x, y, 1.0)).truncate();
        ideal.length() / lens.prepared().project(ideal.extend(1.0)).unwrap().length()
    };
    let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
    let scale = corners.map(shrinks).into_iter().fold(1.0, f64::max);
    let mut camera = Camera { lens: Some(lens), ..pinhole.clone() };
    camera.intrinsics.x_axis *= scale;
    camera.intrinsics.y_axis *= scale;
    camera
}

/// Resamples an image bilinearly between pixel centers.
fn warp(image: &RgbImage, from: &Camera, to: &Camera) -> RgbImage {
    let (from, to) = (from.projection(), to.projection());
    let ends = DVec2::new(f64::from(image.width()) - 1.0, f64::from(image.height()) - 1.0);
    let pixel = |x: u32, y: u32| {
        let ray = to.ray(DVec2::new(f64::from(x), f64::from(y)) + 0.5)?;
        let at = (from.pixel(ray)? - 0.5).clamp(DVec2::ZERO, ends);
        interpolate_bilinear(image, at.x as f32, at.y as f32)
    };
    RgbImage::from_fn(image.width(), image.height(), |x, y| pixel(x, y).unwrap_or(Rgb([0; 3])))
}
