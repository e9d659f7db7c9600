use std::sync::Arc;

use image::{Rgb, RgbImage};
use point_skeleton::geometry::ImageSize;
use pskel_sim::peer::ProtocolError;

use super::call::read_values;
use super::connection::Shared;
use super::hello::DenoiserOutputs;
use super::message::{Answer, Tensor, message};
use crate::{Codec, DenoiserError, FrameConditions, Latent, LatentShape};

/// Codec of a network in another process, which encodes and decodes images on request.
pub(super) struct ProcessCodec {
    pub(super) shared: Arc<Shared>,
    pub(super) given: DenoiserOutputs,
    /// Size of the images.
    pub(super) size: ImageSize,
}

const IMAGES: &str = "images";
const LATENTS: &str = "latents";

impl ProcessCodec {
    /// Shape of the image tensor, `[V, 3, H, W]`.
    fn image_sizes(&self) -> [usize; 4] {
        [self.given.shape.views, 3, self.size.height as usize, self.size.width as usize]
    }

    fn ask<T>(
        &self,
        what: &str,
        (name, shape, values): (&'static str, [usize; 4], &[f32]),
        read: impl FnOnce(&Answer<'_>) -> Result<T, ProtocolError>,
    ) -> Result<T, DenoiserError> {
        let tensor = (name, Tensor::of_f32(shape.to_vec(), values.iter().copied()));
        let request = message([("ask", what.to_owned())], [tensor])?;
        self.shared.ask(request, |answer| read(&Answer::read(answer)?))
    }

    fn check(&self, images: &[RgbImage]) -> Result<(), DenoiserError> {
        let (views, size) = (self.given.shape.views, self.size);
        if images.len() != views {
            return Err(DenoiserError::input(format!("images of {views} cameras"), images.len().to_string()));
        }
        match images.iter().find(|image| image.dimensions() != (size.width, size.height)) {
            Some(image) => {
                let found = format!("{}x{}", image.height(), image.width());
                Err(DenoiserError::input(format!("images of {size}"), found))
            }
            None => Ok(()),
        }
    }
}

impl Codec for ProcessCodec {
    fn shape(&self) -> LatentShape {
        self.given.shape
    }

    fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError> {
        self.check(images)?;
        let planes = images.iter().flat_map(|image| {
            (0..3).flat_map(move |color| image.pixels().map(move |pixel| f32::from(pixel.0[color]) / 255.0))
        });
        let (values, shape) = (planes.collect::<Vec<f32>>(), self.given.shape);
        self.ask("encode", (IMAGES, self.image_sizes(), &values), |answer| {
            let values = read_values(answer, LATENTS, self.given.precision, &shape.to_array())?;
            finite(&values, LATENTS)?;
            Latent::new(shape, values)
                .ok_or_else(|| ProtocolError::new(format!("latents of {shape}"), "others"))
        })
    }

    fn decode(&self, latent: &Latent, _: &FrameConditions) -> Result<Vec<RgbImage>, DenoiserError> {
        if latent.shape() != self.given.shape {
            let expected = format!("latents of {}", self.given.shape);
            return Err(DenoiserError::input(expected, latent.shape().to_string()));
        }
        let (sizes, ImageSize { height, width }) = (self.image_sizes(), self.size);
        let values =
            self.ask("decode", (LATENTS, self.given.shape.to_array(), latent.values()), |answer| {
                let values = read_values(answer, IMAGES, self.given.precision, &sizes)?;
                finite(&values, IMAGES).map(|()| values)
            })?;
        let pixels = self.size.pixels();
        let image = |planes: &[f32]| {
            RgbImage::from_fn(width, height, |x, y| {
                let at = (y * width + x) as usize;
                Rgb([0, 1, 2]
                    .map(|color| (planes[color * pixels + at] * 255.0).round().clamp(0.0, 255.0) as u8))
            })
        };
        Ok(values.chunks(3 * pixels).map(image).collect())
    }
}

fn finite(values: &[f32], name: &str) -> Result<(), ProtocolError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(ProtocolError::new(format!("finite values in `{name}`"), value.to_string())),
        None => Ok(()),
    }
}
