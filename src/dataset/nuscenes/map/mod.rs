//! Map expansion: `maps/expansion/LOCATION.json`, layers of polygons and lines with shared corner nodes.
//!
//! Format: version 1.3 of <https://www.nuscenes.org/nuscenes#map-expansion>. Earlier versions (no lane
//! connectors, no centerlines) are supported too.

pub(super) mod arcline;
pub(super) mod layers;

use std::cell::{Cell, RefCell};
use std::collections::hash_map::Entry;
use std::path::{Path, PathBuf};

use glam::DVec2;
use rustc_hash::{FxHashMap, FxHashSet};

use self::arcline::centerline;
use self::layers::{Divider, Expansion, Layers, Line, Polygon, Surface};
use crate::dataset::recording::degenerate::{self, Fault, note_fault};
use crate::dataset::recording::notes::{Counts, count};
use crate::dataset::{Area, DatasetError, Lane, VectorMap};
use crate::error::FileError;
use crate::files::input::{is_there, read_table};
use crate::files::{FileName, json};

/// Finds the map file of a location: below `map_root` if given, else below `root/maps`, where it is optional.
///
/// # Errors
/// Fails if `map_root` is given and has no such file, the location is not a valid file name, or the path is
/// not a regular file.
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

/// Reads the map of a location. Records without an area or a length, those that refer to missing ones or
/// cannot be read, and missing layers are counted.
///
/// # Errors
/// Fails if the file cannot be read or is not a map expansion, which has nodes, polygons and lanes, or if no
/// record of a layer can be read.
pub fn read_map_file(path: &Path, location: &str) -> Result<VectorMap, DatasetError> {
    const EXPECTED: &str = "a map expansion";
    let bytes = read_table(path)?;
    let mut notes = Counts::new();
    let layers = json::parse::<Expansion>(&bytes, EXPECTED, path)?.layers(&mut notes);
    let layers = layers.map_err(|found| FileError::content(EXPECTED, found, path))?;
    Ok(Resolver::new(&layers, bytes.len(), path, notes).map(location)?)
}

/// Map layers with token lookups.
struct Resolver<'a> {
    raw: &'a Layers,
    path: &'a Path,
    nodes: FxHashMap<&'a str, DVec2>,
    polygons: FxHashMap<&'a str, &'a Polygon>,
    lines: FxHashMap<&'a str, &'a Line>,
    /// Tokens of the lanes and connectors read so far.
    lanes: RefCell<FxHashSet<&'a str>>,
    /// Remaining budget for the total length of centerlines, meters.
    centerline_left_m: Cell<f64>,
    /// Remaining budget for corners of referenced polygons and lines.
    corners_left: Cell<usize>,
    /// Skipped records.
    notes: RefCell<Counts>,
}

/// Reason for which a record has no shape.
enum Refusal {
    /// Only the record is skipped.
    Record(Fault),
    /// The file is refused.
    File(FileError),
}

impl From<Fault> for Refusal {
    fn from(fault: Fault) -> Self {
        Self::Record(fault)
    }
}

/// Maximum total lane length per byte of the file, meters.
const METRES_PER_BYTE: f64 = 8.0;
/// Additional lane length, for small files.
const LANES_M: f64 = 1e4;

/// Maximum number of records per polygon or line, on average; in nuScenes' maps each record has its own.
const MAX_SHARED: usize = 8;

impl<'a> Resolver<'a> {
    /// Builds the lookups for a file of `bytes` bytes.
    fn new(raw: &'a Layers, bytes: usize, path: &'a Path, mut notes: Counts) -> Self {
        let nodes = raw.node.iter().map(|n| (n.token.as_str(), DVec2::new(n.x.0, n.y.0)));
        Self {
            raw,
            path,
            nodes: by_token("node", nodes, &mut notes),
            polygons: by_token("polygon", raw.polygon.iter().map(|p| (p.token.as_str(), p)), &mut notes),
            lines: by_token("line", raw.line.iter().map(|l| (l.token.as_str(), l)), &mut notes),
            lanes: RefCell::default(),
            centerline_left_m: Cell::new(LANES_M + METRES_PER_BYTE * bytes as f64),
            corners_left: Cell::new(raw.corners() * MAX_SHARED),
            notes: RefCell::new(notes),
        }
    }

    fn map(self, location: &str) -> Result<VectorMap, FileError> {
        let raw = self.raw;
        let lanes = self.known("lanes", raw.lane.iter().map(|s| self.lane(s)))?;
        let connectors = self.known("lane connectors", raw.lane_connector.iter().map(|s| self.lane(s)))?;
        let areas = |layer: &str, surfaces: &[Surface]| {
            self.known(layer, surfaces.iter().map(|s| self.area(s.polygon_token.as_deref())))
        };
        let drivable = raw.drivable_area.iter().flat_map(|area| &area.polygon_tokens);
        let drivable_area = self.known("drivable areas", drivable.map(|p| self.area(p.as_deref())))?;
        let crossings = areas("crossings", &raw.ped_crossing)?;
        let stop_lines = areas("stop lines", &raw.stop_line)?;
        let dividers = raw.road_divider.iter().chain(&raw.lane_divider);
        let dividers = self.known("dividers", dividers.filter_map(|d| self.divider(d).transpose()))?;
        Ok(VectorMap {
            walkways: Vec::new(),
            location: location.to_owned(),
            lanes,
            lane_connectors: connectors,
            drivable_area,
            crossings,
            stop_lines,
            dividers,
            network: None,
            notes: self.notes.into_inner(),
        })
    }

    /// Collects the shapes of a layer's records. Counts those without a shape.
    fn known<T>(
        &self,
        layer: &str,
        shapes: impl Iterator<Item = Result<T, Refusal>>,
    ) -> Result<Vec<T>, FileError> {
        let mut all = Vec::new();
        for shape in shapes {
            match shape {
                Ok(shape) => all.push(shape),
                Err(Refusal::Record(fault)) => note_fault(&mut self.notes.borrow_mut(), layer, fault),
                Err(Refusal::File(error)) => return Err(error),
            }
        }
        Ok(all)
    }

    fn lane(&self, surface: &'a Surface) -> Result<Lane, Refusal> {
        if !self.lanes.borrow_mut().insert(&surface.token) {
            return Err(Fault::Twice.into());
        }
        let paths = self.raw.arcline_path_3.get(&surface.token).map_or(&[][..], Vec::as_slice);
        let mut left_m = self.centerline_left_m.get();
        let middle = centerline(paths, &mut left_m);
        self.centerline_left_m.set(left_m);
        if left_m < 0.0 {
            let expected = "centerlines that fit the size of the file";
            let found = "more meters of lanes than a file of this size has";
            return Err(Refusal::File(FileError::content(expected, found, self.path)));
        }
        let outline = self.area(surface.polygon_token.as_deref())?;
        let centerline = middle.unwrap_or_else(|_| {
            count(&mut self.notes.borrow_mut(), "damaged centerlines of lanes (skipped)", 1);
            Vec::new()
        });
        let successors = self.raw.connectivity.get(&surface.token).map_or(Vec::new(), |c| c.outgoing.clone());
        Ok(Lane { id: surface.token.clone(), outline, centerline, successors })
    }

    fn area(&self, polygon: Option<&str>) -> Result<Area, Refusal> {
        let polygon = polygon.and_then(|token| self.polygons.get(token)).ok_or(Fault::Dangling)?;
        let exterior = degenerate::ring(self.corners(&polygon.exterior_node_tokens)?)?;
        let holes = polygon.holes.iter().filter(|hole| !hole.node_tokens.is_empty());
        let holes = holes.map(|hole| Ok(degenerate::ring(self.corners(&hole.node_tokens)?)?));
        Ok(Area { exterior, holes: self.known("holes", holes).map_err(Refusal::File)? })
    }

    /// Returns a divider's line; `None` if it has no nodes, which occurs in some maps and is counted.
    fn divider(&self, divider: &Divider) -> Result<Option<Vec<DVec2>>, Refusal> {
        let line = divider.line_token.as_deref().and_then(|token| self.lines.get(token));
        let line = line.ok_or(Fault::Dangling)?;
        if line.node_tokens.is_empty() {
            count(&mut self.notes.borrow_mut(), "dividers whose line has no nodes", 1);
            return Ok(None);
        }
        Ok(Some(degenerate::line(self.corners(&line.node_tokens)?)?))
    }

    fn corners(&self, nodes: &[Option<String>]) -> Result<Vec<DVec2>, Refusal> {
        let left = self.corners_left.get().checked_sub(nodes.len()).ok_or_else(|| {
            let expected = format!("polygons and lines that at most {MAX_SHARED} records share on average");
            Refusal::File(FileError::content(expected, "more", self.path))
        })?;
        self.corners_left.set(left);
        let corner = |token: &Option<String>| {
            let node = token.as_ref().and_then(|token| self.nodes.get(token.as_str()));
            node.copied().ok_or(Refusal::Record(Fault::Dangling))
        };
        nodes.iter().map(corner).collect()
    }
}

/// Indexes records by token. Counts further records of a token.
fn by_token<'a, T>(
    layer: &str,
    records: impl Iterator<Item = (&'a str, T)>,
    notes: &mut Counts,
) -> FxHashMap<&'a str, T> {
    let mut found = FxHashMap::default();
    for (token, record) in records {
        match found.entry(token) {
            Entry::Vacant(place) => _ = place.insert(record),
            Entry::Occupied(_) => note_fault(notes, &format!("records of {layer}"), Fault::Twice),
        }
    }
    found
}
