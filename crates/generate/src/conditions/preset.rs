use point_skeleton::conditions::{ColorFilter, DepthBins, LayoutLayers, LineWidth};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{SplatSchedule, SplatStep};
use point_skeleton::scene::TemplateFit;

use crate::{Prediction, Recipe, SamplerOptions};

/// Conditions and denoising loop for a network from the paper *Point as Skeleton*. Source: the configurations
/// of its reference implementation for the video networks, and the paper for the image networks, of which
/// nothing is published.
#[derive(Clone, Debug, PartialEq)]
pub struct Preset {
    /// Conditions.
    pub recipe: Recipe,
    /// Frames in the window.
    pub window: usize,
    /// Inference steps.
    pub steps: usize,
    /// Kind of the network's predictions.
    pub sampler: SamplerOptions,
    /// Scale of classifier-free guidance.
    pub guidance: f32,
}

impl Preset {
    /// Returns the preset of a name.
    pub fn named(name: &str) -> Option<Self> {
        let nuscenes =
            |size, radius_m| recipe([900, 1600], size, &[(15.0, 2), (35.0, 1), (100.0, 0)], radius_m);
        let nuplan = |size, radius_m| Recipe {
            map_layers: LayoutLayers::Dividers,
            ..recipe([1080, 1920], size, &[(25.0, 1), (50.0, 0)], radius_m)
        };
        let video = |recipe, window, steps| Self {
            recipe,
            window,
            steps,
            sampler: SamplerOptions::default(),
            guidance: 2.0,
        };
        let image = |recipe| Self {
            sampler: SamplerOptions::Ddim { prediction: Prediction::Epsilon },
            ..video(recipe, 2, 20)
        };
        Some(match name {
            "pas-nuscenes" => video(nuscenes([256, 448], 50.0), 12, 36),
            "pas-nuplan" => video(nuplan([224, 448], 150.0), 10, 30),
            "pas-image-nuscenes" => image(nuscenes([224, 400], 100.0)),
            "pas-image-nuplan" => image(nuplan([224, 400], 100.0)),
            _ => return None,
        })
    }
}

/// Returns a recipe of these render and result sizes, splat radii by depth, and radius of the scene, at which
/// the bins end too.
fn recipe(drawn: [u32; 2], size: [u32; 2], splat: &[(f32, u32)], radius_m: f64) -> Recipe {
    let size_of = |[height, width]: [u32; 2]| ImageSize { height, width };
    let steps = splat.iter().map(|&(z_max_m, radius)| SplatStep { z_max_m, radius }).collect();
    Recipe {
        drawn: size_of(drawn),
        size: size_of(size),
        splat: SplatSchedule::new(steps).unwrap_or_default(),
        radius_m,
        color_filter: ColorFilter::Bilinear,
        bins: DepthBins { far_m: radius_m as f32, ..DepthBins::default() },
        template_fit: TemplateFit::None,
        line_width: LineWidth::Scaled,
        ..Recipe::default()
    }
}

#[cfg(test)]
mod tests {
    use point_skeleton::named::Named;

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
            r#"{"drawn": "900x1600", "size": "224x400", "splat": "15:2,35:1,100:0", "radius_m": 100.0,
                "color_filter": "bilinear", "bins": {"count": 256, "far_m": 100.0}, "template_fit": "none",
                "line_width": "scaled", "map_layers": "lanes"}"#,
            r#"{"drawn": "1080x1920", "size": "224x400", "splat": "25:1,50:0", "radius_m": 100.0,
                "color_filter": "bilinear", "bins": {"count": 256, "far_m": 100.0}, "template_fit": "none",
                "line_width": "scaled", "map_layers": "dividers"}"#,
        ];
        let names = ["pas-nuscenes", "pas-nuplan", "pas-image-nuscenes", "pas-image-nuplan"];
        let loops = [[12, 36], [10, 30], [2, 20], [2, 20]];
        for ((name, text), loops) in names.into_iter().zip(texts).zip(loops) {
            let preset = Preset::named(name).unwrap();
            assert_eq!(preset.recipe, serde_json::from_str::<Recipe>(text).unwrap(), "{name}");
            assert_eq!(([preset.window, preset.steps], preset.guidance), (loops, 2.0), "{name}");
            let is_image = name.starts_with("pas-image");
            assert_eq!(preset.sampler.name(), if is_image { "ddim_epsilon" } else { "flow_match" }, "{name}");
            preset.recipe.check().unwrap();
            assert!(preset.steps.is_multiple_of(preset.window), "{name}");
        }
        assert_eq!(Preset::named("pas"), None);
    }
}
