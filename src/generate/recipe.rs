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

/// A recipe by which no maps are made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct RecipeError {
    /// What would do.
    pub expected: String,
    /// What stands there.
    pub found: String,
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
    /// Whether maps can be made so.
    ///
    /// # Errors
    /// Fewer than 2 bins; distances that are not above 0; maps that are drawn smaller than the images.
    pub fn check(&self) -> Result<(), RecipeError> {
        let Self { drawn, size, radius_m, bins, .. } = self;
        let wrong = |expected: &str, found: String| Err(RecipeError { expected: expected.to_owned(), found });
        if bins.count < 2 {
            return wrong("2 bins of depth or more", bins.count.to_string());
        }
        let distances = [*radius_m, f64::from(bins.far_m), f64::from(bins.gamma)];
        if let Some(other) = distances.iter().find(|number| !(number.is_finite() && **number > 0.0)) {
            return wrong("a radius, a farthest depth and a gamma above 0", other.to_string());
        }
        if drawn.height < size.height || drawn.width < size.width {
            return wrong(&format!("maps drawn at {size} or larger"), drawn.to_string());
        }
        Ok(())
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipes_of_which_no_maps_are_made_are_refused() {
        let good = Recipe::default();
        good.check().unwrap();
        let bins = |count, far_m| DepthBins { count, far_m, ..good.bins };
        for (recipe, said) in [
            (Recipe { bins: bins(1, 100.0), ..good.clone() }, "2 bins of depth or more, found 1"),
            (Recipe { bins: bins(256, 0.0), ..good.clone() }, "above 0, found 0"),
            (Recipe { radius_m: f64::NAN, ..good.clone() }, "above 0, found NaN"),
            (
                Recipe { size: ImageSize { height: 256, width: 56 }, ..good.clone() },
                "drawn at 256x56 or larger",
            ),
        ] {
            let error = recipe.check().unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        let text = r#"{"bins": {"count": 64}}"#;
        let read: Recipe = serde_json::from_str(text).unwrap();
        assert_eq!((read.bins.count, read.bins.far_m), (64, 100.0));
        assert!(serde_json::from_str::<Recipe>(&text.replace("count", "counts")).is_err());
    }
}
