use std::path::Path;

use point_skeleton::conditions::{
    ColorFilter, ConditionOptions, DepthBins, DepthEmbedding, LayoutLayers, LayoutStyle, LineWidth, MapKind,
    MapSet,
};
use point_skeleton::error::FileError;
use point_skeleton::files::json;
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{SplatSchedule, SplatStep};
use point_skeleton::scene::{SelectionOptions, TemplateFit};
use serde::{Deserialize, Serialize};

/// How the conditions of a network are rendered. It belongs to the weights: a network only understands maps
/// rendered in the way that it was trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Recipe {
    /// Size at which maps are rendered.
    pub drawn: ImageSize,
    /// Size to which maps are reduced; also the size of the images.
    pub size: ImageSize,
    /// Splat radius by depth.
    pub splat: SplatSchedule,
    /// Points farther than this from the ego along the world's x or y are culled, meters.
    pub radius_m: f64,
    /// Filter that reduces color.
    pub color_filter: ColorFilter,
    /// Quantization of depth.
    pub bins: DepthBins,
    /// See [`SelectionOptions::min_actor_points`].
    pub min_actor_points: usize,
    /// See [`SelectionOptions::template_fit`].
    pub template_fit: TemplateFit,
    /// Line width of layouts.
    pub line_width: LineWidth,
    /// Outlines of the HD map in its layout.
    pub map_layers: LayoutLayers,
}

/// Invalid recipe.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct RecipeError {
    /// Accepted values.
    pub expected: String,
    /// Value in the recipe.
    pub found: String,
}

impl Default for Recipe {
    fn default() -> Self {
        let SelectionOptions { min_actor_points, template_fit } = SelectionOptions::default();
        Self {
            // Four times the size of the images: surfaces behind each other share fewer pixels than at twice
            // the size.
            drawn: ImageSize { height: 256, width: 448 },
            size: ImageSize { height: 64, width: 112 },
            // Pixels are large: splats only need to close the gaps between LiDAR scan lines.
            splat: SplatSchedule::new(vec![
                SplatStep { z_max_m: 15.0, radius: 1 },
                SplatStep { z_max_m: 100.0, radius: 0 },
            ])
            .unwrap_or_default(),
            radius_m: 100.0,
            color_filter: ColorFilter::VisibleArea,
            bins: DepthBins::default(),
            min_actor_points,
            template_fit,
            // As in the training of the included weights.
            line_width: LineWidth::Fixed,
            map_layers: LayoutLayers::Lanes,
        }
    }
}

impl Recipe {
    /// Reads a recipe from a JSON file, in which missing keys have their defaults.
    ///
    /// # Errors
    /// Fails if the file cannot be read or is no recipe.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let recipe: Self = json::read(path, "a recipe of conditions")?;
        recipe.check().map_err(|error| FileError::content(error.expected, error.found, path))?;
        Ok(recipe)
    }

    /// Validates the recipe.
    ///
    /// # Errors
    /// Returns an error if there are fewer than 2 bins, if a distance or gamma is not above 0, or if maps are
    /// rendered smaller than the images.
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

    /// Returns how the clouds of actors are chosen.
    pub fn selection(&self) -> SelectionOptions {
        SelectionOptions { min_actor_points: self.min_actor_points, template_fit: self.template_fit }
    }

    /// Returns the rendering options, with all maps that [`FrameConditions`](crate::FrameConditions) need.
    pub fn options(&self, has_map: bool) -> ConditionOptions {
        ConditionOptions {
            maps: MapSet::of(&[MapKind::Tensor]).with_parts(has_map).without(MapKind::Tensor),
            splat: self.splat.clone(),
            radius_m: self.radius_m,
            size: Some(self.drawn),
            out_size: Some(self.size),
            color_filter: self.color_filter,
            depth_bins: self.bins,
            depth_embedding: DepthEmbedding::Both,
            layout: LayoutStyle { line_width: self.line_width, map_layers: self.map_layers },
            ..ConditionOptions::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_invalid_recipes() {
        let good = Recipe::default();
        good.check().unwrap();
        let bins = |count, far_m| DepthBins { count, far_m, ..good.bins };
        for (recipe, said) in [
            (Recipe { bins: bins(1, 100.0), ..good.clone() }, "2 bins of depth or more, found 1"),
            (Recipe { bins: bins(256, 0.0), ..good.clone() }, "above 0, found 0"),
            (Recipe { radius_m: f64::NAN, ..good.clone() }, "above 0, found NaN"),
            (
                Recipe { size: ImageSize { height: 512, width: 56 }, ..good.clone() },
                "drawn at 512x56 or larger",
            ),
        ] {
            let error = recipe.check().unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        let text = r#"{"bins": {"count": 64}, "min_actor_points": 0, "template_fit": "none"}"#;
        let read: Recipe = serde_json::from_str(text).unwrap();
        assert_eq!((read.bins.count, read.bins.far_m), (64, 100.0));
        assert_eq!(
            read.selection(),
            SelectionOptions { min_actor_points: 0, template_fit: TemplateFit::None }
        );
        assert_eq!(good.selection(), SelectionOptions::default());
        assert!(serde_json::from_str::<Recipe>(&text.replace("count", "counts")).is_err());
    }
}
