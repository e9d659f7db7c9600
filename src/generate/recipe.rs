use serde::{Deserialize, Serialize};

use crate::conditions::{ColorFilter, ConditionOptions, DepthBins, DepthEmbedding, MapKind, MapSet};
use crate::geometry::ImageSize;
use crate::raster::{SplatSchedule, SplatStep};

/// How the conditions of a network are made. It belongs to the weights: a network that was trained on maps of one kind
/// does not know those of another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Recipe {
    /// Size at which maps are drawn.
    pub drawn: ImageSize,
    /// Size to which they are reduced, that of the images.
    pub size: ImageSize,
    /// Splat radius by depth.
    pub splat: SplatSchedule,
    /// Points farther than this from the ego along the world's x or y are not used, metres.
    pub radius_m: f64,
    /// How color is reduced.
    pub color_filter: ColorFilter,
    /// How depth is cut.
    pub bins: DepthBins,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            drawn: ImageSize { height: 128, width: 224 },
            size: ImageSize { height: 32, width: 56 },
            // Pixels are large: points need not cover more of them than close the gaps between the LiDAR's lines.
            splat: SplatSchedule::new(vec![
                SplatStep { z_max_m: 15.0, radius: 1 },
                SplatStep { z_max_m: 100.0, radius: 0 },
            ])
            .unwrap_or_default(),
            radius_m: 100.0,
            color_filter: ColorFilter::ValidArea,
            bins: DepthBins::default(),
        }
    }
}

impl Recipe {
    /// The options of maps that are made so: all that [`FrameConditions`](super::FrameConditions) and
    /// [`DriveFrame`](super::DriveFrame) take.
    pub fn options(&self, has_map: bool) -> ConditionOptions {
        ConditionOptions {
            maps: MapSet::of(&[MapKind::Tensor]).with_parts(has_map),
            splat: self.splat.clone(),
            radius_m: self.radius_m,
            size: Some(self.drawn),
            out_size: Some(self.size),
            color_filter: self.color_filter,
            depth_bins: self.bins,
            depth_embedding: DepthEmbedding::Both,
            ..ConditionOptions::default()
        }
    }
}
