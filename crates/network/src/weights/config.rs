use point_skeleton::geometry::ImageSize;
use pskel_generate::{LatentShape, Recipe};
use serde::{Deserialize, Serialize};

use crate::kernels::{Attend, Grid, LANES};
use crate::{NetworkError, Statistics};

/// Dimensions of the network. Stored in the header of the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// How its conditions are rendered; images are of `recipe.size`.
    pub recipe: Recipe,
    /// Number of frames in the training windows, L; the network also accepts fewer.
    pub frames: usize,
    /// Channels of the encoder at 1/4, 1/8, 1/16 and 1/32 of the size.
    pub encoder: [usize; 4],
    /// Channels of the decoder at 1/2, 1/4, 1/8 and 1/16 of the size.
    pub decoder: [usize; 4],
    /// Width of the tokens, d.
    pub width: usize,
    /// Width of a head, c.
    pub head: usize,
    /// Width of the hidden layers, m.
    pub hidden: usize,
    /// Attention of each block, in order.
    pub blocks: Vec<Attend>,
}

/// Maximum number of cameras.
pub(crate) const MAX_CAMERAS: usize = 8;
/// Side of the pixels that share a pixel of the size at which latents are denoised.
pub(crate) const WORK: usize = 4;
/// Side of the pixels that share a place of the latents.
pub(crate) const CELL: usize = 16;
/// Channels of the latents.
pub(crate) const LATENT_CHANNELS: usize = 3;
/// Side of the pixels that share a token.
pub(crate) const TOKEN: usize = 32;
/// Maximum of each dimension; rejects mistyped configurations.
const MAX_SIZE: usize = 1 << 14;

impl NetworkConfig {
    /// Latent shape of a frame with some cameras: the mean colors of 16x16 pixels.
    pub fn shape(&self, cameras: usize) -> LatentShape {
        let [height, width] = self.divided(CELL);
        LatentShape { views: cameras, channels: LATENT_CHANNELS, height, width }
    }

    /// Checks a number of cameras.
    ///
    /// # Errors
    /// Returns an error if it is not 1 to 8.
    pub fn check_cameras(cameras: usize) -> Result<(), NetworkError> {
        match cameras {
            1..=MAX_CAMERAS => Ok(()),
            other => Err(NetworkError::input(format!("1 to {MAX_CAMERAS} cameras"), other.to_string())),
        }
    }

    /// Validates the configuration.
    ///
    /// # Errors
    /// Returns an error if a dimension is out of range, if the sides of images are not multiples of 32, or if
    /// the width is not a multiple of the head width.
    pub fn check(&self) -> Result<(), NetworkError> {
        let Self { frames, encoder, decoder, width, head, hidden, .. } = *self;
        let numbers = [&[frames, width, head, hidden, self.blocks.len()][..], &encoder, &decoder].concat();
        if numbers.iter().any(|number| !(1..=MAX_SIZE).contains(number)) {
            let expected = format!("frames, channels, width, head, hidden and blocks of 1 to {MAX_SIZE}");
            return Err(NetworkError::input(expected, format!("{numbers:?}")));
        }
        if frames < 2 {
            return Err(NetworkError::input("a window of 2 frames or more", frames.to_string()));
        }
        self.recipe.check().map_err(|error| NetworkError::input(error.expected, error.found))?;
        let ImageSize { height, width: across } = self.recipe.size;
        if [height, across].iter().any(|side| *side == 0 || !(*side as usize).is_multiple_of(TOKEN)) {
            let expected = format!("images with sides that are multiples of {TOKEN}");
            return Err(NetworkError::input(expected, self.recipe.size.to_string()));
        }
        let lanes = [&[head, hidden][..], &encoder, &decoder].concat();
        if width % head != 0 || lanes.iter().any(|n| n % LANES != 0) {
            let expected = format!("a width of whole heads; head, hidden and channels multiples of {LANES}");
            return Err(NetworkError::input(expected, format!("{width}, {lanes:?}")));
        }
        Ok(())
    }

    /// Validates the configuration and its statistics; see [`NetworkConfig::check`].
    pub(crate) fn check_with(&self, statistics: &Statistics) -> Result<(), NetworkError> {
        self.check()?;
        statistics.check(LATENT_CHANNELS)
    }

    /// Height and width of images, divided by a number of pixels.
    pub(crate) fn divided(&self, by: usize) -> [usize; 2] {
        let ImageSize { height, width } = self.recipe.size;
        [height as usize / by.max(1), width as usize / by.max(1)]
    }

    /// Returns the token grid for this many frames and cameras.
    pub(crate) fn grid(&self, frames: usize, views: usize) -> Grid {
        let [height, width] = self.divided(TOKEN);
        Grid { frames, views, height, width }
    }
}
