use image::{Rgb, RgbImage};

use crate::{Codec, DenoiserError, FrameConditions, Latent, LatentShape};

/// Codec whose latents are the pixels themselves, in patches. Channel `(color * p + row) * p + column` of a
/// location is one pixel of its `p x p` patch, from -1 to 1. The order equals PyTorch's `pixel_unshuffle`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelCodec {
    shape: LatentShape,
    patch: usize,
}

impl PixelCodec {
    /// Creates a codec for latents of a shape.
    ///
    /// # Errors
    /// Returns an error if the number of channels is not 3 times a square.
    pub fn new(shape: LatentShape) -> Result<Self, DenoiserError> {
        let patch = (1..=64).find(|patch| 3 * patch * patch == shape.channels);
        let patch = patch.ok_or_else(|| {
            let expected = "latents of 3, 12, 27, 48 .. channels, the pixels of patches, or `image_size` and \
                a codec of its own";
            DenoiserError::answer(expected, shape.to_string())
        })?;
        Ok(Self { shape, patch })
    }

    /// Height and width of the images, pixels.
    pub fn size(&self) -> [usize; 2] {
        [self.shape.height * self.patch, self.shape.width * self.patch]
    }

    /// Returns the index of a pixel's color value in the latent.
    fn place(&self, view: usize, color: usize, [x, y]: [usize; 2]) -> usize {
        let (LatentShape { channels, height, width, .. }, patch) = (self.shape, self.patch);
        let channel = (color * patch + y % patch) * patch + x % patch;
        ((view * channels + channel) * height + y / patch) * width + x / patch
    }
}

impl Codec for PixelCodec {
    fn shape(&self) -> LatentShape {
        self.shape
    }

    fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError> {
        let [height, width] = self.size();
        if images.len() != self.shape.views {
            let expected = format!("images of {} cameras", self.shape.views);
            return Err(DenoiserError::input(expected, images.len().to_string()));
        }
        let mut latent = Latent::filled(self.shape, 0.0);
        for (view, image) in images.iter().enumerate() {
            if (image.height() as usize, image.width() as usize) != (height, width) {
                let found = format!("{}x{}", image.height(), image.width());
                return Err(DenoiserError::input(format!("images of {height}x{width}"), found));
            }
            for (x, y, pixel) in image.enumerate_pixels() {
                for (color, level) in pixel.0.into_iter().enumerate() {
                    let place = self.place(view, color, [x as usize, y as usize]);
                    latent.values_mut()[place] = f32::from(level) / 127.5 - 1.0;
                }
            }
        }
        Ok(latent)
    }

    fn decode(&self, latent: &Latent, _: &FrameConditions) -> Result<Vec<RgbImage>, DenoiserError> {
        if latent.shape() != self.shape {
            return Err(DenoiserError::input(
                format!("latents of {}", self.shape),
                latent.shape().to_string(),
            ));
        }
        let [height, width] = self.size();
        let image = |view: usize| {
            RgbImage::from_fn(width as u32, height as u32, |x, y| {
                let level = |color: usize| {
                    let value = latent.values()[self.place(view, color, [x as usize, y as usize])];
                    ((value + 1.0) * 127.5).round().clamp(0.0, 255.0) as u8
                };
                Rgb([level(0), level(1), level(2)])
            })
        };
        Ok((0..self.shape.views).map(image).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Conditions, which this codec does not need.
    fn none() -> FrameConditions {
        let size = point_skeleton::geometry::ImageSize { height: 0, width: 0 };
        let (color, bins, boxes, map) = Default::default();
        FrameConditions {
            size,
            color,
            bins,
            depth_bins: point_skeleton::conditions::DepthBins::default(),
            boxes,
            map,
            dropped: crate::DroppedConditions::default(),
            action: [0.0; 3],
            cameras: Vec::new(),
            prompts: Default::default(),
        }
    }

    #[test]
    fn round_trips_in_pixel_unshuffle_order() {
        let shape = LatentShape { views: 2, channels: 12, height: 3, width: 4 };
        let codec = PixelCodec::new(shape).unwrap();
        assert_eq!(codec.size(), [6, 8]);
        let image = |view: u32| {
            RgbImage::from_fn(8, 6, |x, y| Rgb([x as u8 * 9, y as u8 * 20, (view * 100 + x * y) as u8]))
        };
        let images = [image(0), image(1)];
        let latent = codec.encode(&images).unwrap();
        assert_eq!(codec.decode(&latent, &none()).unwrap(), images);
        // Green (1) of row 3, column 5 of camera 1: patch row 1, column 2, inside it row 1, column 1.
        let channel = (2 + 1) * 2 + 1;
        let at = ((12 + channel) * 3 + 1) * 4 + 2;
        assert!((latent.values()[at] - (60.0 / 127.5 - 1.0)).abs() < 1e-6);
    }

    #[test]
    fn rejects_unsupported_shapes_and_images() {
        let shape = |channels| LatentShape { views: 1, channels, height: 2, width: 2 };
        let message = PixelCodec::new(shape(4)).unwrap_err().to_string();
        assert!(message.contains("3, 12, 27, 48") && message.contains("4"), "{message}");
        let codec = PixelCodec::new(shape(3)).unwrap();
        assert!(codec.encode(&[]).unwrap_err().to_string().contains("1 cameras"));
        let message = codec.encode(&[RgbImage::new(3, 2)]).unwrap_err().to_string();
        assert!(message.contains("2x2") && message.contains("2x3"), "{message}");
        assert!(codec.decode(&Latent::filled(shape(12), 0.0), &none()).is_err());
    }
}
