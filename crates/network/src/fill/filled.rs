use image::RgbImage;
use point_skeleton::geometry::ImageSize;
use pskel_generate::{Codec, Denoiser, DenoiserError, Frame, FrameConditions, Latent, LatentShape, Recipe};
use rayon::prelude::*;

use crate::inputs::filled_color;

/// A generator without a network: its images are the color maps with their holes filled. The least that a
/// network must surpass.
#[derive(Clone, Debug)]
pub struct FilledColor {
    size: ImageSize,
    cameras: usize,
}

impl FilledColor {
    /// Creates the generator for a number of cameras.
    pub fn new(recipe: &Recipe, cameras: usize) -> Self {
        Self { size: recipe.size, cameras }
    }

    fn latent_shape(&self) -> LatentShape {
        LatentShape { views: self.cameras, channels: 1, height: 1, width: 1 }
    }
}

impl Denoiser for FilledColor {
    type Condition = FrameConditions;

    fn shape(&self) -> LatentShape {
        self.latent_shape()
    }

    fn predict(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<Latent>, DenoiserError> {
        Ok(window.iter().map(|_| Latent::filled(self.latent_shape(), 0.0)).collect())
    }
}

impl Codec for FilledColor {
    fn shape(&self) -> LatentShape {
        self.latent_shape()
    }

    fn encode(&self, _: &[RgbImage]) -> Result<Latent, DenoiserError> {
        Ok(Latent::filled(self.latent_shape(), 0.0))
    }

    fn decode(&self, _: &Latent, conditions: &FrameConditions) -> Result<Vec<RgbImage>, DenoiserError> {
        let ImageSize { height, width } = self.size;
        if (conditions.views(), conditions.size) != (self.cameras, self.size) || !conditions.is_whole() {
            let expected = format!("conditions of {} cameras of {}", self.cameras, self.size);
            let found = format!("{} of {}", conditions.views(), conditions.size);
            return Err(DenoiserError::input(expected, found));
        }
        let image = |view: usize| {
            let byte = |level: f32| (level * 255.0).round() as u8; // saturates
            let color = filled_color(conditions, view);
            RgbImage::from_raw(width, height, color.into_iter().flatten().map(byte).collect())
        };
        Ok((0..self.cameras).into_par_iter().filter_map(image).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pskel_generate::DroppedConditions;

    #[test]
    fn holes_take_the_surrounding_color() {
        let recipe = Recipe { size: ImageSize { height: 2, width: 4 }, ..Recipe::default() };
        let filled = FilledColor::new(&recipe, 2);
        let mut color = vec![[0; 3]; 8];
        color.extend([[255; 3]; 8]);
        color[3] = [51, 102, 153];
        let conditions = FrameConditions {
            size: recipe.size,
            color,
            bins: vec![0; 16],
            depth_bins: recipe.bins,
            boxes: vec![[0; 3]; 16],
            map: vec![[0; 3]; 16],
            dropped: DroppedConditions::default(),
            action: [0.0; 3],
            cameras: vec![[0.5; 16]; 2],
            prompts: Default::default(),
        };
        let latent = filled.encode(&[]).unwrap();
        let images = filled.decode(&latent, &conditions).unwrap();
        assert!(images[0].pixels().all(|pixel| pixel.0 == [51, 102, 153]));
        assert!(images[1].pixels().all(|pixel| pixel.0 == [255; 3]));
        let other = FilledColor::new(&recipe, 1);
        let error = other.decode(&latent, &conditions).unwrap_err().to_string();
        assert!(error.contains("conditions of 1 cameras of 2x4, found 2 of 2x4"), "{error}");
    }
}
