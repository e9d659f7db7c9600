//! Layers of the map expansion as stored in the file.

use std::collections::BTreeMap;
use std::marker::PhantomData;

use serde::de::{DeserializeOwned, Deserializer, MapAccess, SeqAccess, Visitor};

use super::arcline::ArclinePath;
use crate::dataset::lenient::{Coordinate, Records, or_default, readable};
use crate::dataset::recording::degenerate::Unreadable;
use crate::dataset::recording::notes::Counts;

/// The map as stored in the file.
#[derive(serde::Deserialize)]
pub(in super::super) struct Expansion {
    node: Records<Node>,
    polygon: Records<Polygon>,
    line: Option<Records<Line>>,
    lane: Records<Surface>,
    lane_connector: Option<Records<Surface>>,
    drivable_area: Option<Records<DrivableArea>>,
    ped_crossing: Option<Records<Surface>>,
    stop_line: Option<Records<Surface>>,
    road_divider: Option<Records<Divider>>,
    lane_divider: Option<Records<Divider>>,
    #[serde(default, deserialize_with = "by_lane")]
    arcline_path_3: ByLane<Vec<ArclinePath>>,
    #[serde(default, deserialize_with = "by_lane")]
    connectivity: ByLane<Connectivity>,
}

/// Records of the layers that are read.
pub(in super::super) struct Layers {
    pub(in super::super) node: Vec<Node>,
    pub(in super::super) polygon: Vec<Polygon>,
    pub(in super::super) line: Vec<Line>,
    pub(in super::super) lane: Vec<Surface>,
    pub(in super::super) lane_connector: Vec<Surface>,
    pub(in super::super) drivable_area: Vec<DrivableArea>,
    pub(in super::super) ped_crossing: Vec<Surface>,
    pub(in super::super) stop_line: Vec<Surface>,
    pub(in super::super) road_divider: Vec<Divider>,
    pub(in super::super) lane_divider: Vec<Divider>,
    pub(in super::super) arcline_path_3: BTreeMap<String, Vec<ArclinePath>>,
    pub(in super::super) connectivity: BTreeMap<String, Connectivity>,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct Node {
    pub(in super::super) token: String,
    #[serde(default)]
    pub(in super::super) x: Coordinate,
    #[serde(default)]
    pub(in super::super) y: Coordinate,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct Polygon {
    pub(in super::super) token: String,
    #[serde(default, deserialize_with = "or_default")]
    pub(in super::super) exterior_node_tokens: Vec<Option<String>>,
    #[serde(default, deserialize_with = "or_default")]
    pub(in super::super) holes: Vec<Hole>,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct Hole {
    #[serde(default, deserialize_with = "or_default")]
    pub(in super::super) node_tokens: Vec<Option<String>>,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct Line {
    pub(in super::super) token: String,
    #[serde(default, deserialize_with = "or_default")]
    pub(in super::super) node_tokens: Vec<Option<String>>,
}

/// Record with one polygon: lane, connector, crossing or stop line.
#[derive(serde::Deserialize)]
pub(in super::super) struct Surface {
    pub(in super::super) token: String,
    pub(in super::super) polygon_token: Option<String>,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct DrivableArea {
    #[serde(default, deserialize_with = "or_default")]
    pub(in super::super) polygon_tokens: Vec<Option<String>>,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct Divider {
    pub(in super::super) line_token: Option<String>,
}

#[derive(serde::Deserialize)]
pub(in super::super) struct Connectivity {
    #[serde(default, deserialize_with = "or_default")]
    pub(in super::super) outgoing: Vec<String>,
}

impl Expansion {
    /// Returns the records that can be read, and counts the others.
    ///
    /// # Errors
    /// Returns a description of a layer without readable records.
    pub(in super::super) fn layers(self, notes: &mut Counts) -> Result<Layers, String> {
        // The connectors came with a later version.
        let lane_connector = self.lane_connector.unwrap_or_default();
        Ok(Layers {
            node: Records::of_layer("node", Some(self.node), notes)?,
            polygon: Records::of_layer("polygon", Some(self.polygon), notes)?,
            line: Records::of_layer("line", self.line, notes)?,
            lane: Records::of_layer("lane", Some(self.lane), notes)?,
            lane_connector: Records::of_layer("lane_connector", Some(lane_connector), notes)?,
            drivable_area: Records::of_layer("drivable_area", self.drivable_area, notes)?,
            ped_crossing: Records::of_layer("ped_crossing", self.ped_crossing, notes)?,
            stop_line: Records::of_layer("stop_line", self.stop_line, notes)?,
            road_divider: Records::of_layer("road_divider", self.road_divider, notes)?,
            lane_divider: Records::of_layer("lane_divider", self.lane_divider, notes)?,
            arcline_path_3: self.arcline_path_3.known("arcline_path_3", notes)?,
            connectivity: self.connectivity.known("connectivity", notes)?,
        })
    }
}

impl Layers {
    /// Returns the total corner count of all polygons and lines.
    pub(in super::super) fn corners(&self) -> usize {
        let hole = |hole: &Hole| hole.node_tokens.len();
        let polygon = |p: &Polygon| p.exterior_node_tokens.len() + p.holes.iter().map(hole).sum::<usize>();
        let lines = self.line.iter().map(|line| line.node_tokens.len());
        self.polygon.iter().map(polygon).chain(lines).sum()
    }
}

/// Records by lane. Those that cannot be read are set apart.
struct ByLane<T> {
    known: BTreeMap<String, T>,
    unreadable: Unreadable<String>,
}

impl<T> Default for ByLane<T> {
    fn default() -> Self {
        Self { known: BTreeMap::new(), unreadable: Unreadable::default() }
    }
}

impl<T> ByLane<T> {
    /// Returns the records that can be read, and counts the others.
    ///
    /// # Errors
    /// Returns a description if no record can be read.
    fn known(self, layer: &str, notes: &mut Counts) -> Result<BTreeMap<String, T>, String> {
        self.unreadable.note(layer, self.known.len(), notes)?;
        Ok(self.known)
    }
}

/// Deserializes an object keyed by lane. Maps without entries contain an empty array instead.
fn by_lane<'de, T: DeserializeOwned, D: Deserializer<'de>>(from: D) -> Result<ByLane<T>, D::Error> {
    from.deserialize_any(LanesOf(PhantomData))
}

struct LanesOf<T>(PhantomData<T>);

impl<'de, T: DeserializeOwned> Visitor<'de> for LanesOf<T> {
    type Value = ByLane<T>;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object by lane, or an empty array")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut found = ByLane::default();
        while let Some((lane, record)) = map.next_entry()? {
            found.known.extend(readable(record, &mut found.unreadable).map(|record| (lane, record)));
        }
        Ok(found)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<Self::Value, A::Error> {
        match array.next_element::<serde::de::IgnoredAny>()? {
            None => Ok(ByLane::default()),
            Some(_) => Err(serde::de::Error::invalid_type(serde::de::Unexpected::Seq, &self)),
        }
    }
}
