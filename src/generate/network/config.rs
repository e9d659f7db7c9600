use serde::{Deserialize, Serialize};

use super::kernels::{Attend, Grid, LANES};
use super::{NetworkError, Statistics};
use crate::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use crate::generate::{LatentShape, Recipe};

/// Size and shape of the network. It stands in the weights' header.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// How its conditions are made; images are of `recipe.size`.
    pub recipe: Recipe,
    /// Cameras, V.
    pub cameras: usize,
    /// Frames of the window that it is trained for, L; it takes fewer, too.
    pub frames: usize,
    /// Side of a patch, pixels.
    pub patch: usize,
    /// Width of the tokens, d.
    pub width: usize,
    /// Width of a head, c.
    pub head: usize,
    /// Width of the hidden layers, m.
    pub hidden: usize,
    /// The blocks' attentions, one after the other.
    pub blocks: Vec<Attend>,
}

impl Default for NetworkConfig {
    /// 2.1 million parameters: six cameras of 32x56 pixels.
    fn default() -> Self {
        use Attend::{Space, Time, Views};
        Self {
            recipe: Recipe::default(),
            cameras: 6,
            frames: 4,
            patch: 4,
            width: 128,
            head: 32,
            hidden: 512,
            blocks: vec![Space, Views, Time, Space, Views, Time, Space, Space],
        }
    }
}

/// Channels of the maps of a camera: layout (6), color (3), depth (1 + 8 + 8).
pub(super) const MAPS: usize = LAYOUT_CHANNELS + POINT_CHANNELS;
/// What is larger is a mistake, not a configuration.
const MOST: usize = 1 << 14;

impl NetworkConfig {
    /// Size of a frame's latents: `3 p^2` channels, one row and column per patch.
    pub fn shape(&self) -> LatentShape {
        let size = self.recipe.size;
        let patches = |side: u32| side as usize / self.patch.max(1);
        LatentShape {
            views: self.cameras,
            channels: self.channels(),
            height: patches(size.height),
            width: patches(size.width),
        }
    }

    /// Channels of a latent, C.
    pub fn channels(&self) -> usize {
        3 * self.patch * self.patch
    }

    /// Whether all of it goes together.
    ///
    /// # Errors
    /// Sizes of zero, images that are no whole patches, widths that are no whole heads.
    pub fn check(&self) -> Result<(), NetworkError> {
        let Self { cameras, frames, patch, width, head, hidden, .. } = *self;
        let numbers = [cameras, frames, patch, width, head, hidden, self.blocks.len()];
        if numbers.iter().any(|number| !(1..=MOST).contains(number)) {
            let expected = format!("cameras, frames, patch, width, head, hidden and blocks of 1 to {MOST}");
            return Err(NetworkError::input(expected, format!("{numbers:?}")));
        }
        if frames < 2 {
            return Err(NetworkError::input("a window of 2 frames or more", frames.to_string()));
        }
        self.recipe.check().map_err(|error| NetworkError::input(error.expected, error.found))?;
        let size = self.recipe.size;
        let sides = [size.height, size.width].map(|side| side as usize);
        if sides.iter().any(|side| *side == 0 || side % patch != 0) {
            return Err(NetworkError::input(format!("images in whole patches of {patch}"), size.to_string()));
        }
        if width % head != 0 || head % LANES != 0 || hidden % LANES != 0 {
            let expected = format!("a width of whole heads, head and hidden multiples of {LANES}");
            return Err(NetworkError::input(expected, format!("{width}, {head} and {hidden}")));
        }
        Ok(())
    }

    /// As [`NetworkConfig::check`], with what was measured.
    pub(in crate::generate) fn check_with(&self, statistics: &Statistics) -> Result<(), NetworkError> {
        self.check()?;
        statistics.check(self.channels())
    }

    /// Tokens of some windows of some frames.
    pub(super) fn grid(&self, windows: usize, frames: usize) -> Grid {
        let LatentShape { views, height, width, .. } = self.shape();
        Grid { windows, frames, views, height, width }
    }

    /// Numbers of a patch's maps, and of its latent.
    pub(in crate::generate) fn maps_and_channels(&self) -> [usize; 2] {
        [self.map_numbers(), self.channels()]
    }

    /// Numbers of a patch's maps.
    pub(super) fn map_numbers(&self) -> usize {
        MAPS * self.patch * self.patch
    }
}
