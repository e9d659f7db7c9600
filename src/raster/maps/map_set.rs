use std::ops::{BitAnd, BitOr};
use std::str::FromStr;

use serde::{Serialize, Serializer};

use crate::gpu::shaders::resolve_full_wgsl_both as shader;
use crate::named::UnknownName;
use crate::{named, named_in_files};

/// Kind of map. The value is its bit in a [`MapSet`]; the kinds that a rasterizer renders have the bits of
/// the resolve shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum MapKind {
    /// RGB of the nearest point of the color cloud.
    Color = shader::WANT_COLOR,
    /// Camera depth of the nearest point of the geometry cloud.
    Depth = shader::WANT_DEPTH,
    /// Coarse class of the nearest point of the geometry cloud.
    Class = shader::WANT_CLASS,
    /// Actor number of the nearest point of the geometry cloud.
    Instance = shader::WANT_INSTANCE,
    /// Outlines of the actors' boxes.
    Boxes = 1 << 16,
    /// Outlines of the HD map: lanes, drivable area, crossings.
    Map = 1 << 17,
    /// Index + 1 of the nearest point of the geometry cloud, counted through the geometry instances.
    Point = shader::WANT_POINT,
    /// Network input: color and depth in 20 channels, boxes and map in 6.
    Tensor = 1 << 18,
}

named!(MapKind, "map" {
    Color => "color", "Color of the nearest point";
    Depth => "depth", "Depth of the nearest point";
    Class => "class", "Coarse class of the nearest point";
    Instance => "instance", "Actor of the nearest point";
    Boxes => "boxes", "Outlines of the actors' boxes";
    Map => "map", "Outlines of the log's HD map";
    Point => "point", "Number of the nearest point";
    Tensor => "tensor", "Network inputs";
});
named_in_files!(MapKind);

/// Type of a map's pixels. Writers, contact sheets and Python treat all maps of a type alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelType {
    /// RGB levels, black where empty.
    Rgb,
    /// Camera depth in meters, `f32::INFINITY` in memory where empty.
    Depth,
    /// Coarse class in 8 bits, 0 where empty.
    Class,
    /// Number in 32 bits, 0 where empty.
    Number,
    /// Channels of the network input, which are no image.
    Channels,
}

/// Description of a map kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapDescription {
    /// Name of files, arrays and command-line values.
    pub name: &'static str,
    /// Type of the pixels.
    pub pixels: PixelType,
    /// Whether contact sheets and pages show the map; point numbers carry no visual information.
    pub is_shown: bool,
}

impl MapKind {
    /// Returns the description of the kind.
    pub fn description(self) -> MapDescription {
        let pixels = match self {
            Self::Color | Self::Boxes | Self::Map => PixelType::Rgb,
            Self::Depth => PixelType::Depth,
            Self::Class => PixelType::Class,
            Self::Instance | Self::Point => PixelType::Number,
            Self::Tensor => PixelType::Channels,
        };
        MapDescription { name: self.name(), pixels, is_shown: self != Self::Point }
    }
}

/// Set of map kinds. Text form: names with commas, `color,depth`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapSet(u32);

impl MapSet {
    /// No maps.
    pub const NONE: Self = Self(0);
    /// The maps that a rasterizer renders.
    pub const SPLATTED: Self = Self::COLOR.or(Self::GEOMETRY).or(Self::ACTORS);
    /// The map of the color cloud.
    pub(in super::super) const COLOR: Self = Self::of(&[MapKind::Color]);
    /// Maps of the nearest point of the geometry cloud.
    pub(in super::super) const GEOMETRY: Self = Self::of(&[MapKind::Depth, MapKind::Point]);
    /// Maps that [`Occlusion`](crate::raster::Occlusion) applies to.
    pub(in super::super) const ACTORS: Self = Self::of(&[MapKind::Class, MapKind::Instance]);
    /// Maps that share the words of one plane.
    pub(in super::super) const RGB_CLASS: Self = Self::of(&[MapKind::Color, MapKind::Class]);

    /// Creates a set of some kinds.
    pub const fn of(kinds: &[MapKind]) -> Self {
        let (mut set, mut i) = (Self::NONE, 0);
        while i < kinds.len() {
            set = set.or(Self(kinds[i] as u32));
            i += 1;
        }
        set
    }

    const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the set with one more kind.
    pub fn with(self, kind: MapKind) -> Self {
        Self(self.0 | kind as u32)
    }

    /// Returns the set without one kind.
    pub fn without(self, kind: MapKind) -> Self {
        Self(self.0 & !(kind as u32))
    }

    /// Returns whether the set contains a kind.
    pub fn contains(self, kind: MapKind) -> bool {
        self.0 & kind as u32 != 0
    }

    /// Returns whether the sets have a kind in common.
    pub fn intersects(self, other: Self) -> bool {
        self & other != Self::NONE
    }

    /// Returns the bits of the resolve shaders.
    pub(in super::super) fn bits(self) -> u32 {
        self.0
    }

    /// Iterates over the kinds of the set, in the order of [`MapKind::ALL`].
    pub fn iter(self) -> impl Iterator<Item = MapKind> {
        MapKind::ALL.into_iter().filter(move |kind| self.contains(*kind))
    }
}

impl BitOr for MapSet {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        self.or(other)
    }
}

impl BitAnd for MapSet {
    type Output = Self;

    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

/// All maps that every log supports: without map layout, point numbers and model tensor.
impl Default for MapSet {
    fn default() -> Self {
        use MapKind::{Boxes, Class, Color, Depth, Instance};
        Self::of(&[Color, Depth, Class, Instance, Boxes])
    }
}

impl FromStr for MapSet {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Ok(Self::of(&text.split(',').map(|name| name.trim().parse()).collect::<Result<Vec<_>, _>>()?))
    }
}

impl Serialize for MapSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_parsed_and_changed() {
        let maps: MapSet = "depth,color".parse().unwrap();
        assert_eq!(maps.iter().collect::<Vec<_>>(), [MapKind::Color, MapKind::Depth]);
        assert!(maps.with(MapKind::Map) == "map,depth,color".parse().unwrap());
        assert_eq!(maps.with(MapKind::Map).without(MapKind::Map), maps);
        assert!("depth,colour".parse::<MapSet>().is_err() && "".parse::<MapSet>().is_err());
    }

    #[test]
    fn every_kind_has_its_own_bit() {
        let bits = MapKind::ALL.map(|kind| MapSet::of(&[kind]).bits());
        assert!(bits.iter().all(|bit| bit.is_power_of_two()));
        assert_eq!(bits.iter().sum::<u32>(), MapSet::of(&MapKind::ALL).bits());
    }
}
