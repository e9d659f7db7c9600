use std::path::Path;

use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use pskel_generate::{LatentShape, Recipe};
use serde::{Deserialize, Serialize};

use super::kernels::{Attend, Grid, LANES};
use super::{NetworkError, Statistics};

/// Dimensions of the network. Stored in the header of the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// How its conditions are rendered; images are of `recipe.size`.
    pub recipe: Recipe,
    /// Number of cameras, V.
    pub cameras: usize,
    /// Number of frames in the training windows, L; the network also accepts fewer.
    pub frames: usize,
    /// Side of a patch, pixels, p.
    pub patch: usize,
    /// Width of the tokens, d.
    pub width: usize,
    /// Width of a head, c.
    pub head: usize,
    /// Width of the hidden layers, m.
    pub hidden: usize,
    /// Kind of attention of each block, in order.
    pub blocks: Vec<Attend>,
}

impl Default for NetworkConfig {
    /// Configuration with 2.1 million parameters, for six cameras of 32x56 pixels.
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
/// Maximum of each dimension; rejects mistyped configurations.
const MOST: usize = 1 << 14;

impl NetworkConfig {
    /// Reads a configuration from a JSON file. Missing fields have their default.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or if it has an unknown field or a wrong type.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let text = read_table(path)?;
        serde_json::from_slice(&text)
            .map_err(|error| FileError::content("a network's configuration", error.to_string(), path))
    }

    /// Latent shape of a frame: `3 p^2` channels, one row and column per patch.
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

    /// Number of channels of a latent, C.
    pub fn channels(&self) -> usize {
        3 * self.patch * self.patch
    }

    /// Validates the configuration.
    ///
    /// # Errors
    /// Returns an error if a dimension is out of range, if images cannot be divided into whole patches, or if the
    /// width is not a multiple of the head width.
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

    /// Validates the configuration and its statistics; see [`NetworkConfig::check`].
    pub(crate) fn check_with(&self, statistics: &Statistics) -> Result<(), NetworkError> {
        self.check()?;
        statistics.check(self.channels())
    }

    /// Returns the token grid of a number of windows and frames.
    pub(super) fn grid(&self, windows: usize, frames: usize) -> Grid {
        let LatentShape { views, height, width, .. } = self.shape();
        Grid { windows, frames, views, height, width }
    }

    /// Number of values in a patch's maps, and in its latent.
    pub(crate) fn maps_and_channels(&self) -> [usize; 2] {
        [self.map_numbers(), self.channels()]
    }

    /// Number of values in a patch's maps.
    pub(super) fn map_numbers(&self) -> usize {
        MAPS * self.patch * self.patch
    }
}
