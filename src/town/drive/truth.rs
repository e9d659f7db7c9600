//! What cameras see, pixel by pixel: images, and the true maps.

use image::RgbImage;

use super::{Town, TownError};
use crate::dataset::ImageRecord;
use crate::geometry::Cuboid;

/// Somebody where a state has him.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueActor<'a> {
    /// Track id.
    pub track: &'a str,
    /// Global.
    pub cuboid: Cuboid,
}

/// What draws.
pub(super) struct Film;

impl Town {
    /// One flat color.
    pub(super) fn image(&self, record: &ImageRecord) -> Result<RgbImage, TownError> {
        let _ = &self.film;
        let camera = &record.camera;
        Ok(RgbImage::from_pixel(camera.width, camera.height, image::Rgb([120, 130, 140])))
    }
}
