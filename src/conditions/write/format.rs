use std::path::Path;

#[cfg(feature = "exr")]
use super::exr;
use super::{npz, png, safetensors};
use crate::conditions::{ConditionError, ConditionOptions, ConditionSet};
use crate::{named, named_in_files};

/// File format of the maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapFormat {
    /// One PNG per map, `CAMERA/MAP.png`; depth as 16-bit bins.
    #[default]
    Png,
    /// One OpenEXR file per map, `CAMERA/MAP.exr`; depth in meters.
    #[cfg(feature = "exr")]
    Exr,
    /// One NumPy archive, `maps.npz`; depth in meters.
    Npz,
    /// One safetensors file, `conditions.safetensors`; depth in meters.
    Safetensors,
}

named!(MapFormat, "map format" {
    Png => "png", "A PNG per map";
    #[cfg(feature = "exr")]
    Exr => "exr", "An OpenEXR file per map";
    Npz => "npz", "One NumPy archive per frame";
    Safetensors => "safetensors", "One safetensors file per frame";
});
named_in_files!(MapFormat);

impl MapFormat {
    /// Writes the maps of a step into its folder.
    ///
    /// # Errors
    /// Returns an error if a file cannot be written, if a number does not fit into the format, or if the
    /// cameras differ in size and the format stores them in one array.
    pub fn write(
        self,
        folder: &Path,
        set: &ConditionSet,
        t_us: i64,
        options: &ConditionOptions,
    ) -> Result<(), ConditionError> {
        match self {
            Self::Png => png::write(folder, set, &options.depth_bins),
            #[cfg(feature = "exr")]
            Self::Exr => Ok(exr::write(folder, set)?),
            Self::Npz => npz::write(&folder.join("maps.npz"), set),
            Self::Safetensors => {
                safetensors::write(&folder.join("conditions.safetensors"), set, t_us, options)
            }
        }
    }
}
