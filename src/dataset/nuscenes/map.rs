//! Map expansion: `maps/expansion/LOCATION.json`, layers of polygons and lines with shared corner nodes.
//!
//! Format: version 1.3 of <https://www.nuscenes.org/nuscenes#map-expansion>. Earlier versions (no lane connectors, no
//! centerlines) are supported too.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use glam::DVec2;
use rustc_hash::FxHashMap;
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use super::arcline::{ArclinePath, centerline};
use crate::dataset::{Area, DatasetError, Lane, VectorMap};
use crate::error::FileError;
use crate::files::FileName;
use crate::files::input::{is_there, read_table};

/// Finds the map file of a location: below `map_root` if given, else below `root/maps`, where it is optional.
///
/// # Errors
/// Fails if `map_root` is given and has no such file, the location is not a valid file name, or the path is not a
/// regular file.
pub(super) fn find(
    root: &Path,
    map_root: Option<&Path>,
    location: &str,
) -> Result<Option<PathBuf>, FileError> {
    let maps = map_root.map_or_else(|| root.join("maps"), Path::to_owned);
    if location.is_empty() && map_root.is_none() {
        return Ok(None);
    }
    let location = FileName::new(location).map_err(|error| error.of("location of the log").in_file(&maps))?;
    let name = format!("{location}.json");
    for path in [maps.join("expansion").join(&name), maps.join(&name)] {
        if is_there(&path)? {
            return Ok(Some(path));
        }
    }
    match map_root {
        None => Ok(None),
        Some(_) => Err(FileError::content(format!("map {name} or expansion/{name}"), "none", &maps)),
    }
}

/// Reads the map of a location.
///
/// # Errors
/// Fails if the file cannot be read or is not a map expansion, or tokens are duplicate or unresolved. Fails if an
/// area has fewer than three corners, a line has a single point, or a centerline is invalid.
pub fn read_map_file(path: &Path, location: &str) -> Result<VectorMap, DatasetError> {
    let bytes = read_table(path)?;
    let wrong = |e: serde_json::Error| FileError::content("a map expansion", e.to_string(), path);
    let raw: Expansion = serde_json::from_slice(&bytes).map_err(wrong)?;
    Ok(Resolver::new(&raw, bytes.len(), path)?.map(location)?)
}

/// Layers that are read, as stored in the file.
#[derive(serde::Deserialize)]
struct Expansion {
    node: Vec<Node>,
    polygon: Vec<Polygon>,
    line: Vec<Line>,
    lane: Vec<Surface>,
    #[serde(default)]
    lane_connector: Vec<Surface>,
    drivable_area: Vec<DrivableArea>,
    ped_crossing: Vec<Surface>,
    stop_line: Vec<Surface>,
    road_divider: Vec<Divider>,
    lane_divider: Vec<Divider>,
    #[serde(default, deserialize_with = "by_lane")]
    arcline_path_3: BTreeMap<String, Vec<ArclinePath>>,
    #[serde(default, deserialize_with = "by_lane")]
    connectivity: BTreeMap<String, Connectivity>,
}

#[derive(serde::Deserialize)]
struct Node {
    token: String,
    x: f64,
    y: f64,
}

#[derive(serde::Deserialize)]
struct Polygon {
    token: String,
    exterior_node_tokens: Vec<String>,
    #[serde(default)]
    holes: Vec<Hole>,
}

#[derive(serde::Deserialize)]
struct Hole {
    node_tokens: Vec<String>,
}

#[derive(serde::Deserialize)]
struct Line {
    token: String,
    node_tokens: Vec<String>,
}

/// Record with one polygon: lane, connector, crossing or stop line.
#[derive(serde::Deserialize)]
struct Surface {
    token: String,
    polygon_token: String,
}

#[derive(serde::Deserialize)]
struct DrivableArea {
    token: String,
    polygon_tokens: Vec<String>,
}

#[derive(serde::Deserialize)]
struct Divider {
    token: String,
    line_token: String,
}

#[derive(serde::Deserialize)]
struct Connectivity {
    outgoing: Vec<String>,
}

/// Map layers with token lookups.
struct Resolver<'a> {
    raw: &'a Expansion,
    path: &'a Path,
    nodes: FxHashMap<&'a str, DVec2>,
    polygons: FxHashMap<&'a str, &'a Polygon>,
    lines: FxHashMap<&'a str, &'a Line>,
    /// Remaining budget for the total length of centerlines, meters.
    centerline_left_m: Cell<f64>,
    /// Remaining budget for corners of referenced polygons and lines.
    corners_left: Cell<usize>,
}

/// Maximum total lane length per byte of the file, meters.
const METRES_PER_BYTE: f64 = 8.0;
/// Additional lane length, for small files.
const LANES_M: f64 = 1e4;

/// Maximum number of records per polygon or line, on average; in nuScenes' maps each record has its own.
const MOST_SHARED: usize = 8;

impl Expansion {
    /// Returns the number of corners of all polygons and lines.
    fn corners(&self) -> usize {
        let hole = |hole: &Hole| hole.node_tokens.len();
        let polygon = |p: &Polygon| p.exterior_node_tokens.len() + p.holes.iter().map(hole).sum::<usize>();
        let lines = self.line.iter().map(|line| line.node_tokens.len());
        self.polygon.iter().map(polygon).chain(lines).sum()
    }
}

impl<'a> Resolver<'a> {
    /// Builds the lookups for a file of `bytes` bytes.
    fn new(raw: &'a Expansion, bytes: usize, path: &'a Path) -> Result<Self, FileError> {
        let nodes = raw.node.iter().map(|n| (n.token.as_str(), DVec2::new(n.x, n.y)));
        let surfaces = raw.lane.iter().chain(&raw.lane_connector);
        by_token("lane", surfaces.map(|s| (s.token.as_str(), ())), path)?;
        Ok(Self {
            raw,
            path,
            nodes: by_token("node", nodes, path)?,
            polygons: by_token("polygon", raw.polygon.iter().map(|p| (p.token.as_str(), p)), path)?,
            lines: by_token("line", raw.line.iter().map(|l| (l.token.as_str(), l)), path)?,
            centerline_left_m: Cell::new(LANES_M + METRES_PER_BYTE * bytes as f64),
            corners_left: Cell::new(raw.corners() * MOST_SHARED),
        })
    }

    fn map(&self, location: &str) -> Result<VectorMap, FileError> {
        let raw = self.raw;
        let lanes = |surfaces: &[Surface]| surfaces.iter().map(|s| self.lane(s)).collect::<Result<_, _>>();
        let areas = |kind: &'static str, surfaces: &[Surface]| {
            let area = |s: &Surface| self.area(&s.polygon_token, || format!("{kind} {}", s.token));
            surfaces.iter().map(area).collect::<Result<_, _>>()
        };
        let mut drivable_area = Vec::new();
        for area in &raw.drivable_area {
            for polygon in &area.polygon_tokens {
                drivable_area.push(self.area(polygon, || format!("drivable_area {}", area.token))?);
            }
        }
        let (mut dividers, mut notes) = (Vec::new(), BTreeMap::new());
        for divider in raw.road_divider.iter().chain(&raw.lane_divider) {
            match self.divider(divider)? {
                Some(line) => dividers.push(line),
                None => *notes.entry("dividers whose line has no nodes".to_owned()).or_default() += 1,
            }
        }
        Ok(VectorMap {
            walkways: Vec::new(),
            location: location.to_owned(),
            lanes: lanes(&raw.lane)?,
            lane_connectors: lanes(&raw.lane_connector)?,
            drivable_area,
            crossings: areas("ped_crossing", &raw.ped_crossing)?,
            stop_lines: areas("stop_line", &raw.stop_line)?,
            dividers,
            notes,
        })
    }

    fn lane(&self, surface: &Surface) -> Result<Lane, FileError> {
        let by = || format!("lane {}", surface.token);
        let paths = self.raw.arcline_path_3.get(&surface.token).map_or(&[][..], Vec::as_slice);
        let not_a_path = |found| {
            let found = format!("{found} in arcline_path_3 {}", surface.token);
            FileError::content(
                "paths of three letters L S R, a radius over 0 m and lengths of 0 to 1000 m",
                found,
                self.path,
            )
        };
        let mut left_m = self.centerline_left_m.get();
        let middle = centerline(paths, &mut left_m).map_err(not_a_path)?;
        self.centerline_left_m.set(left_m);
        Ok(Lane {
            id: surface.token.clone(),
            outline: self.area(&surface.polygon_token, by)?,
            centerline: middle,
            successors: self.raw.connectivity.get(&surface.token).map_or(Vec::new(), |c| c.outgoing.clone()),
        })
    }

    fn area(&self, polygon: &str, by: impl FnOnce() -> String) -> Result<Area, FileError> {
        let polygon = self.polygons.get(polygon).ok_or_else(|| self.dangling("polygon", polygon, by()))?;
        let holes = polygon.holes.iter().filter(|hole| !hole.node_tokens.is_empty());
        Ok(Area {
            exterior: self.ring(&polygon.exterior_node_tokens, polygon)?,
            holes: holes.map(|hole| self.ring(&hole.node_tokens, polygon)).collect::<Result<_, _>>()?,
        })
    }

    /// Returns a ring's corners without the closing one.
    fn ring(&self, nodes: &[String], polygon: &Polygon) -> Result<Vec<DVec2>, FileError> {
        let by = || format!("polygon {}", polygon.token);
        let mut ring = self.corners(nodes, by)?;
        while ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        self.at_least(3, ring, by)
    }

    /// Returns a divider's line; `None` if it has no nodes, which occurs in some maps.
    fn divider(&self, divider: &Divider) -> Result<Option<Vec<DVec2>>, FileError> {
        let by = || format!("divider {}", divider.token);
        let line = self.lines.get(divider.line_token.as_str());
        let line = line.ok_or_else(|| self.dangling("line", &divider.line_token, by()))?;
        if line.node_tokens.is_empty() {
            return Ok(None);
        }
        let by = || format!("line {}", line.token);
        self.at_least(2, self.corners(&line.node_tokens, by)?, by).map(Some)
    }

    fn corners(&self, nodes: &[String], by: impl Fn() -> String) -> Result<Vec<DVec2>, FileError> {
        let left = self.corners_left.get().checked_sub(nodes.len()).ok_or_else(|| {
            let expected = format!("polygons and lines that at most {MOST_SHARED} records share on average");
            FileError::content(expected, "more", self.path)
        })?;
        self.corners_left.set(left);
        let corner = |token: &String| {
            self.nodes.get(token.as_str()).copied().ok_or_else(|| self.dangling("node", token, by()))
        };
        nodes.iter().map(corner).collect()
    }

    fn at_least(
        &self,
        least: usize,
        corners: Vec<DVec2>,
        by: impl FnOnce() -> String,
    ) -> Result<Vec<DVec2>, FileError> {
        if corners.len() >= least {
            return Ok(corners);
        }
        let found = format!("{} in {}", corners.len(), by());
        Err(FileError::content(format!("at least {least} corners"), found, self.path))
    }

    fn dangling(&self, layer: &str, token: &str, by: String) -> FileError {
        let expected = format!("layer {layer} to hold token {token}");
        FileError::content(expected, format!("none (referred to by {by})"), self.path)
    }
}

/// Indexes records by token. Fails if a token occurs twice.
fn by_token<'a, T>(
    layer: &str,
    records: impl Iterator<Item = (&'a str, T)>,
    path: &Path,
) -> Result<FxHashMap<&'a str, T>, FileError> {
    let mut found = FxHashMap::default();
    for (token, record) in records {
        if found.insert(token, record).is_some() {
            let twice = format!("{layer} {token} twice");
            return Err(FileError::content("every token once", twice, path));
        }
    }
    Ok(found)
}

/// Deserializes an object keyed by lane. Maps without entries contain an empty array instead.
fn by_lane<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<BTreeMap<String, T>, D::Error> {
    from.deserialize_any(ByLane(PhantomData))
}

struct ByLane<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for ByLane<T> {
    type Value = BTreeMap<String, T>;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object by lane, or an empty array")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut found = BTreeMap::new();
        while let Some((lane, value)) = map.next_entry()? {
            found.insert(lane, value);
        }
        Ok(found)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<Self::Value, A::Error> {
        match array.next_element::<serde::de::IgnoredAny>()? {
            None => Ok(BTreeMap::new()),
            Some(_) => Err(serde::de::Error::invalid_type(serde::de::Unexpected::Seq, &self)),
        }
    }
}
