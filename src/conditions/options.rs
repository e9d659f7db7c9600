use serde::Serialize;

use super::layout::LayoutStyle;
use super::{DepthBins, DepthEmbedding};
use crate::geometry::{ImageSize, View};
use crate::raster::{MapKind, MapSet, Occlusion, SplatSchedule};
use crate::{named, named_in_files};

impl MapSet {
    /// Adds the maps that the model tensor is encoded from, if it is requested; the map layout only if there
    /// is an HD map.
    pub fn with_parts(self, has_map: bool) -> Self {
        match self.contains(MapKind::Tensor) {
            true if has_map => {
                self | Self::of(&[MapKind::Color, MapKind::Depth, MapKind::Boxes, MapKind::Map])
            }
            true => self | Self::of(&[MapKind::Color, MapKind::Depth, MapKind::Boxes]),
            false => self,
        }
    }
}

/// Reduction filter of color maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorFilter {
    /// OpenCV's INTER_LINEAR; empty pixels count as black.
    #[default]
    Bilinear,
    /// Area-weighted mean of the pixels that are not empty.
    ValidArea,
    /// The same without pixels that show a surface through the gaps between the points of a nearer one.
    VisibleArea,
}

named!(ColorFilter, "color filter" {
    Bilinear => "bilinear", "OpenCV's INTER_LINEAR; empty pixels count as black";
    ValidArea => "valid-area", "Area-weighted mean of the pixels that are not empty";
    VisibleArea => "visible-area",
        "The same without pixels that show a surface through the gaps between the points of a nearer one";
});
named_in_files!(ColorFilter);

impl ColorFilter {
    /// Returns whether the filter needs to know which pixels are empty.
    pub fn needs_depth(self) -> bool {
        self != Self::Bilinear
    }
}

/// Options for rendering condition maps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConditionOptions {
    /// Maps to render.
    pub maps: MapSet,
    /// Splat radius by depth.
    pub splat: SplatSchedule,
    /// Points farther than this from the ego along the world's x or y are cropped, meters.
    pub radius_m: f64,
    /// Render size; `None` for the camera's own.
    pub size: Option<ImageSize>,
    /// Size after reduction; `None` for no reduction.
    pub out_size: Option<ImageSize>,
    /// Reduction filter of the color map.
    pub color_filter: ColorFilter,
    /// Points that can occlude actors.
    pub occlusion: Occlusion,
    /// Depth bins of PNG, sheet and model tensor.
    pub depth_bins: DepthBins,
    /// Depth channels of the model tensor to fill.
    pub depth_embedding: DepthEmbedding,
    /// How layouts are drawn.
    pub layout: LayoutStyle,
    /// Line-width scales by view, for views that differ from the recorded images (see [`Self::line_scale`]).
    #[serde(skip)]
    pub line_scales: Option<Vec<f32>>,
}

impl ConditionOptions {
    /// Returns whether a radius or the end of depth bins may be this distance: more than 0 and finite as
    /// `f32`, meters.
    pub fn is_distance_m(distance_m: f64) -> bool {
        distance_m as f32 > 0.0 && (distance_m as f32).is_finite()
    }

    /// Returns the view at render size ([`ConditionOptions::size`]), with scaled intrinsics.
    pub fn drawn_view(&self, view: &View) -> View {
        let camera =
            self.size.map_or_else(|| view.camera.clone(), |s| view.camera.resized(s.height, s.width));
        View { camera, camera_from_world: view.camera_from_world }
    }

    /// Returns a view's width relative to its camera's own image, which scales the lines of layouts.
    pub fn line_scale(&self, view: &View) -> f32 {
        self.drawn_view(view).camera.width as f32 / view.camera.width as f32
    }

    /// Returns the size of a camera's maps as written.
    pub fn written_size(&self, view: &View) -> ImageSize {
        self.out_size.or(self.size).unwrap_or_else(|| ImageSize::of(&view.camera))
    }
}

impl Default for ConditionOptions {
    fn default() -> Self {
        Self {
            maps: MapSet::default(),
            splat: SplatSchedule::default(),
            radius_m: 100.0,
            size: None,
            out_size: None,
            color_filter: ColorFilter::default(),
            occlusion: Occlusion::default(),
            depth_bins: DepthBins::default(),
            depth_embedding: DepthEmbedding::default(),
            layout: LayoutStyle::default(),
            line_scales: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_maps_are_parsed() {
        assert_eq!("256x448".parse(), Ok(ImageSize { height: 256, width: 448 }));
        for text in ["", "256", "0x4", "4x16385", "-1x4", "4x4x4", "axb"] {
            assert!(text.parse::<ImageSize>().is_err(), "{text}");
        }
        let maps: MapSet = "depth,color".parse().unwrap();
        let tensor: MapSet = "tensor,class".parse().unwrap();
        let parts: MapSet = "color,depth,class,boxes,tensor".parse().unwrap();
        assert_eq!([tensor.with_parts(false), tensor.with_parts(true)], [parts, parts.with(MapKind::Map)]);
        assert_eq!(maps.with_parts(true), maps);
    }

    #[test]
    fn options_serialize_as_on_the_command_line() {
        let options = ConditionOptions {
            out_size: Some(ImageSize { height: 256, width: 448 }),
            color_filter: ColorFilter::ValidArea,
            ..ConditionOptions::default()
        };
        let json = serde_json::to_value(&options).unwrap();
        assert_eq!(json["splat"], "15:2,35:1,100:0");
        assert_eq!(json["out_size"], "256x448");
        assert_eq!(json["color_filter"], "valid-area");
        assert_eq!(json["maps"], serde_json::json!(["color", "depth", "class", "instance", "boxes"]));
        assert_eq!(json["size"], serde_json::Value::Null);
    }
}
