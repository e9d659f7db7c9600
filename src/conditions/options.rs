use std::str::FromStr;

use serde::{Deserialize, Serialize, Serializer};

use super::{DepthBins, DepthEmbedding};
use crate::geometry::{ImageSize, ParseOptionError, View};
use crate::raster::{Occlusion, SplatSchedule};

/// Kind of condition map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MapKind {
    /// RGB of the nearest point of the color cloud.
    Color,
    /// Camera depth of the nearest point of the geometry cloud.
    Depth,
    /// Coarse class of the nearest point of the geometry cloud.
    Class,
    /// Actor number of the nearest point of the geometry cloud.
    Instance,
    /// Outlines of the actors' boxes.
    Boxes,
    /// Outlines of the HD map: lanes, drivable area, crossings.
    Map,
    /// Index + 1 of the nearest point of the geometry cloud, counted through the geometry instances.
    Point,
    /// Network input: color and depth in 20 channels, boxes and map in 6.
    Tensor,
}

impl MapKind {
    /// All kinds, in the order of files and sheets.
    pub const ALL: [Self; 8] = [
        Self::Color,
        Self::Depth,
        Self::Class,
        Self::Instance,
        Self::Boxes,
        Self::Map,
        Self::Point,
        Self::Tensor,
    ];

    /// Returns the name used for files, arrays and command-line values.
    pub fn name(self) -> &'static str {
        match self {
            Self::Color => "color",
            Self::Depth => "depth",
            Self::Class => "class",
            Self::Instance => "instance",
            Self::Boxes => "boxes",
            Self::Map => "map",
            Self::Point => "point",
            Self::Tensor => "tensor",
        }
    }
}

/// Set of map kinds. Text form: names with commas, `color,depth`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapSet([bool; MapKind::ALL.len()]);

impl MapSet {
    /// Creates a set of some kinds.
    pub fn of(kinds: &[MapKind]) -> Self {
        Self(MapKind::ALL.map(|kind| kinds.contains(&kind)))
    }

    /// Returns the set with one more kind.
    pub fn with(mut self, kind: MapKind) -> Self {
        self.0[kind as usize] = true;
        self
    }

    /// Returns whether the set contains a kind.
    pub fn contains(self, kind: MapKind) -> bool {
        self.0[kind as usize]
    }

    /// Adds the maps that the model tensor is encoded from, if it is requested; the map layout only if there is an HD
    /// map.
    pub fn with_parts(mut self, has_map: bool) -> Self {
        if self.contains(MapKind::Tensor) {
            for part in [MapKind::Color, MapKind::Depth, MapKind::Boxes] {
                self.0[part as usize] = true;
            }
            self.0[MapKind::Map as usize] |= has_map;
        }
        self
    }

    /// Returns the set without one kind.
    pub fn without(mut self, kind: MapKind) -> Self {
        self.0[kind as usize] = false;
        self
    }

    /// Iterates over the kinds of the set, in the order of [`MapKind::ALL`].
    pub fn iter(self) -> impl Iterator<Item = MapKind> {
        MapKind::ALL.into_iter().filter(move |kind| self.contains(*kind))
    }
}

/// All maps that every log supports: without map layout, point numbers and model tensor.
impl Default for MapSet {
    fn default() -> Self {
        let extra = |kind| matches!(kind, MapKind::Map | MapKind::Point | MapKind::Tensor);
        Self(MapKind::ALL.map(|kind| !extra(kind)))
    }
}

impl FromStr for MapSet {
    type Err = ParseOptionError;

    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let kind = |name: &str| {
            let known = MapKind::ALL.into_iter().find(|kind| kind.name() == name.trim());
            known.ok_or_else(|| ParseOptionError {
                expected: "maps out of color,depth,class,instance,boxes,map,point,tensor",
                found: name.to_owned(),
            })
        };
        Ok(Self::of(&text.split(',').map(kind).collect::<Result<Vec<_>, _>>()?))
    }
}

impl Serialize for MapSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

/// Reduction filter of color maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColorFilter {
    /// OpenCV's INTER_LINEAR; empty pixels count as black.
    #[default]
    Bilinear,
    /// Area-weighted mean of the pixels that are not empty.
    ValidArea,
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
}

impl ConditionOptions {
    /// Returns the view at render size ([`ConditionOptions::size`]), with scaled intrinsics.
    pub fn drawn_view(&self, view: &View) -> View {
        let camera =
            self.size.map_or_else(|| view.camera.clone(), |s| view.camera.resized(s.height, s.width));
        View { camera, camera_from_world: view.camera_from_world }
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
        assert_eq!(maps.iter().collect::<Vec<_>>(), [MapKind::Color, MapKind::Depth]);
        let tensor: MapSet = "tensor,class".parse().unwrap();
        let parts: MapSet = "color,depth,class,boxes,tensor".parse().unwrap();
        assert_eq!([tensor.with_parts(false), tensor.with_parts(true)], [parts, parts.with(MapKind::Map)]);
        assert_eq!(maps.with_parts(true), maps);
        assert!(maps.with(MapKind::Map) == "map,depth,color".parse().unwrap());
        assert!("depth,colour".parse::<MapSet>().is_err() && "".parse::<MapSet>().is_err());
    }

    #[test]
    fn options_serialize_as_the_command_line_has_them() {
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
