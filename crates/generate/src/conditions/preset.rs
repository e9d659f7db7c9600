use point_skeleton::conditions::{ColorFilter, DepthBins, LayoutLayers, LineWidth};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{SplatSchedule, SplatStep};
use point_skeleton::scene::TemplateFit;

use crate::Recipe;

/// Conditions and denoising loop for a network from the paper *Point as Skeleton*. Source: the configurations
/// of its reference implementation.
#[derive(Clone, Debug, PartialEq)]
pub struct Preset {
    /// Conditions.
    pub recipe: Recipe,
    /// Frames in the window.
    pub window: usize,
    /// Inference steps.
    pub steps: usize,
    /// Scale of classifier-free guidance.
    pub guidance: f32,
}

impl Preset {
    /// Names of the presets.
    pub const NAMES: [&'static str; 2] = ["pas-nuscenes", "pas-nuplan"];

    /// Returns the preset of a name.
    pub fn named(name: &str) -> Option<Self> {
        let [nuscenes, nuplan] = Self::NAMES;
        match name {
            name if name == nuscenes => Some(Self {
                recipe: recipe([900, 1600], [256, 448], &[(15.0, 2), (35.0, 1), (100.0, 0)], [50.0, 50.0]),
                window: 12,
                steps: 36,
                guidance: 2.0,
            }),
            name if name == nuplan => Some(Self {
                recipe: Recipe {
                    map_layers: LayoutLayers::Dividers,
                    ..recipe([1080, 1920], [224, 448], &[(25.0, 1), (50.0, 0)], [150.0, 150.0])
                },
                window: 10,
                steps: 30,
                guidance: 2.0,
            }),
            _ => None,
        }
    }
}

/// Returns a recipe of these render and result sizes, splat radii by depth, radius of the scene and far end
/// of the bins.
fn recipe(drawn: [u32; 2], size: [u32; 2], splat: &[(f32, u32)], [radius_m, far_m]: [f64; 2]) -> Recipe {
    let size_of = |[height, width]: [u32; 2]| ImageSize { height, width };
    let steps = splat.iter().map(|&(z_max_m, radius)| SplatStep { z_max_m, radius }).collect();
    Recipe {
        drawn: size_of(drawn),
        size: size_of(size),
        splat: SplatSchedule::new(steps).unwrap_or_default(),
        radius_m,
        color_filter: ColorFilter::Bilinear,
        bins: DepthBins { far_m: far_m as f32, ..DepthBins::default() },
        template_fit: TemplateFit::None,
        line_width: LineWidth::Scaled,
        ..Recipe::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As recipes in JSON; every window divides its steps.
    #[test]
    fn presets_match_the_published_networks() {
        let texts = [
            r#"{"drawn": "900x1600", "size": "256x448", "splat": "15:2,35:1,100:0", "radius_m": 50.0,
                "color_filter": "bilinear", "bins": {"count": 256, "far_m": 50.0}, "template_fit": "none",
                "line_width": "scaled", "map_layers": "lanes"}"#,
            r#"{"drawn": "1080x1920", "size": "224x448", "splat": "25:1,50:0", "radius_m": 150.0,
                "color_filter": "bilinear", "bins": {"count": 256, "far_m": 150.0}, "template_fit": "none",
                "line_width": "scaled", "map_layers": "dividers"}"#,
        ];
        for ((name, text), loops) in Preset::NAMES.iter().zip(texts).zip([[12, 36], [10, 30]]) {
            let preset = Preset::named(name).unwrap();
            assert_eq!(preset.recipe, serde_json::from_str::<Recipe>(text).unwrap(), "{name}");
            assert_eq!(([preset.window, preset.steps], preset.guidance), (loops, 2.0), "{name}");
            preset.recipe.check().unwrap();
            assert!(preset.steps.is_multiple_of(preset.window), "{name}");
        }
        assert_eq!(Preset::named("pas"), None);
    }
}
