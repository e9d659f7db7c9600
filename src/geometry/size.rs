use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Camera;

/// Error of an option value that cannot be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found:?}")]
pub struct ParseOptionError {
    /// Accepted form.
    pub expected: &'static str,
    /// Given text.
    pub found: String,
}

/// Height and width in pixels, 1 to [`Camera::MAX_SIDE`] each. Text form `HxW`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize {
    /// Pixels.
    pub height: u32,
    /// Pixels.
    pub width: u32,
}

impl ImageSize {
    /// Returns the image size of a camera.
    pub fn of(camera: &Camera) -> Self {
        Self { height: camera.height, width: camera.width }
    }

    /// Returns the number of pixels.
    pub fn pixels(self) -> usize {
        self.height as usize * self.width as usize
    }
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.height, self.width)
    }
}

impl FromStr for ImageSize {
    type Err = ParseOptionError;

    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let bad = || ParseOptionError {
            expected: "a size HxW of 1 to 16384 pixels, like 256x448",
            found: text.to_owned(),
        };
        let (height, width) = text.split_once(['x', 'X']).ok_or_else(bad)?;
        let side = |side: &str| {
            let side: u32 = side.trim().parse().map_err(|_| bad())?;
            if (1..=Camera::MAX_SIDE).contains(&side) { Ok(side) } else { Err(bad()) }
        };
        Ok(Self { height: side(height)?, width: side(width)? })
    }
}

impl Serialize for ImageSize {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for ImageSize {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}
