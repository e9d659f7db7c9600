//! Sizes and splat radii.

use clap::Args;
use point_skeleton::conditions::{ConditionOptions, ImageSize};
use point_skeleton::raster::SplatSchedule;

/// Sizes of the maps, and splat radii, shared by all commands that rasterize points.
#[derive(Clone, Debug, Args)]
pub(crate) struct SizeArgs {
    /// Render at this size; scales the intrinsics [default: the size of the cameras]
    #[arg(long, value_name = "HxW")]
    pub(crate) size: Option<ImageSize>,
    /// Reduce the maps to this size after rendering [default: no reduction]
    #[arg(long, value_name = "HxW")]
    pub(crate) out_size: Option<ImageSize>,
    /// Splat radius by depth: up to Z meters a point covers (2R+1) x (2R+1) pixels; points beyond the last Z
    /// are culled
    #[arg(long, value_name = "Z:R,..", default_value_t)]
    pub(crate) splat: SplatSchedule,
}

impl SizeArgs {
    /// Returns options of conditions with these sizes and radii.
    pub(crate) fn conditions(&self) -> ConditionOptions {
        ConditionOptions {
            splat: self.splat.clone(),
            size: self.size,
            out_size: self.out_size,
            ..ConditionOptions::default()
        }
    }
}
