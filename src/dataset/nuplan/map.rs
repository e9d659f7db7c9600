//! `map.gpkg`: the HD map of a place, a layer a table.
//!
//! A connector's area stands in another layer than its lanes, and the middle of both in a third.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use glam::DVec2;
use serde::Deserialize;

use super::database::{Database, Query, Row};
use super::geometry::{self, Shape};
use super::projection::Utm;
use super::read::{Notes, note};
use crate::dataset::{Area, DatasetError, Lane, VectorMap};
use crate::error::FileError;
use crate::files::FileName;
use crate::files::input::read_table;

/// The index of a folder of maps.
const INDEX: &str = "nuplan-maps-v1.0.json";

/// An entry of the index.
#[derive(Deserialize)]
struct IndexEntry {
    version: String,
}

/// Reads the map of a name; `None` if the index does not have it.
pub(super) fn read(folder: &Path, name: &str, location: &str) -> Result<Option<VectorMap>, DatasetError> {
    let path = folder.join(INDEX);
    let bytes = read_table(&path)?;
    let index: BTreeMap<String, IndexEntry> = serde_json::from_slice(&bytes)
        .map_err(|e| FileError::content("a JSON object of maps with their version", e.to_string(), &path))?;
    let Some(IndexEntry { version }) = index.get(name) else { return Ok(None) };
    let part =
        |part: &str| FileName::new(part).map_err(|error| error.of("name or version of a map").in_file(&path));
    let database = Database::open(&folder.join(part(name)?).join(part(version)?).join("map.gpkg"))?;
    let layers = Layers { utm: utm(&database)?, columns: geometry_columns(&database)?, database };
    let mut notes = Notes::new();
    let (lanes, lane_connectors) = layers.lanes(&mut notes)?;
    Ok(Some(VectorMap {
        location: location.to_owned(),
        lanes,
        lane_connectors,
        drivable_area: layers.drivable_area(&mut notes)?,
        crossings: layers.areas("crosswalks", &mut notes)?,
        stop_lines: layers.areas("stop_polygons", &mut notes)?,
        dividers: layers.lines("boundaries", &mut notes)?,
        notes,
    }))
}

/// The system that the log's coordinates are in.
fn utm(database: &Database) -> Result<Utm, DatasetError> {
    const KEY: &str = "projectedCoordSystem";
    let mut found = None;
    database.rows(&Query { table: "meta", columns: &["key", "value"], from: "FROM meta" }, |row| {
        if row.text(0)? == KEY {
            let name = row.text(1)?;
            let expected = "a UTM zone (epsg:32601 to 32660, 32701 to 32760)";
            found = Some(Utm::from_epsg(name).ok_or_else(|| row.wrong(1, expected, &format!("{name:?}")))?);
        }
        Ok(())
    })?;
    let none = || FileError::content(format!("{KEY} in meta"), "none", database.path()).into();
    found.ok_or_else(none)
}

/// The layers' columns of geometry, quoted.
fn geometry_columns(database: &Database) -> Result<BTreeMap<String, String>, DatasetError> {
    let query = Query {
        table: "gpkg_geometry_columns",
        columns: &["table_name", "column_name"],
        from: "FROM gpkg_geometry_columns",
    };
    let mut columns = BTreeMap::new();
    database.rows(&query, |row| {
        columns.insert(row.text(0)?.to_owned(), format!("\"{}\"", row.text(1)?.replace('"', "\"\"")));
        Ok(())
    })?;
    Ok(columns)
}

struct Layers {
    utm: Utm,
    columns: BTreeMap<String, String>,
    database: Database,
}

impl Layers {
    /// Hands every feature of a layer to `each`, in order of their ids: the id, the geometry, and further columns as
    /// identifiers. Features whose geometry is empty are counted instead.
    fn features<const N: usize>(
        &self,
        layer: &str,
        further: [&str; N],
        notes: &mut Notes,
        mut each: impl FnMut(&mut Notes, &Row<'_>, Shape, [Option<i64>; N]) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        let geometry = self.columns.get(layer).ok_or_else(|| {
            FileError::content(format!("layer {layer}"), "none of that name", self.database.path())
        })?;
        // The rowid is the feature's id, whatever its column is called.
        let columns: Vec<&str> = ["rowid", geometry].into_iter().chain(further).collect();
        let from = format!("FROM {layer} ORDER BY rowid");
        self.database.rows(&Query { table: layer, columns: &columns, from: &from }, |row| {
            let shape = geometry::decode(row.blob(1)?, &self.utm)
                .map_err(|found| row.wrong(1, "lines or polygons in longitude and latitude", &found))?;
            let Some(shape) = shape else {
                note(notes, &format!("features of {layer} with an empty geometry"), 1);
                return Ok(());
            };
            let mut ids = [None; N];
            for (i, id) in ids.iter_mut().enumerate() {
                *id = row.identifier(2 + i)?;
            }
            each(notes, row, shape, ids)
        })
    }

    fn areas(&self, layer: &str, notes: &mut Notes) -> Result<Vec<Area>, DatasetError> {
        let mut all = Vec::new();
        self.features(layer, [], notes, |_, row, shape, []| {
            all.extend(areas(row, shape)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Roads outside of junctions, junctions, and what is neither: the layer of that name has only the last.
    fn drivable_area(&self, notes: &mut Notes) -> Result<Vec<Area>, DatasetError> {
        let mut all = Vec::new();
        for layer in ["lane_groups_polygons", "intersections", "generic_drivable_areas", "carpark_areas"] {
            all.extend(self.areas(layer, notes)?);
        }
        Ok(all)
    }

    fn lines(&self, layer: &str, notes: &mut Notes) -> Result<Vec<Vec<DVec2>>, DatasetError> {
        let mut all = Vec::new();
        self.features(layer, [], notes, |_, row, shape, []| {
            all.extend(lines(row, shape)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Lanes and lane connectors, each in order of their ids.
    fn lanes(&self, notes: &mut Notes) -> Result<(Vec<Lane>, Vec<Lane>), DatasetError> {
        let (mut lanes, mut connectors) = (BTreeMap::new(), BTreeMap::new());
        self.features("lanes_polygons", [], notes, |notes, row, shape, []| {
            add_lane(&mut lanes, row.integer(0)?, row, shape, notes)
        })?;
        let further = ["lane_connector_fid"];
        self.features(
            "gen_lane_connectors_scaled_width_polygons",
            further,
            notes,
            |notes, row, shape, [id]| {
                let id = id.ok_or_else(|| row.wrong(2, "the id of a lane connector", "NULL"))?;
                add_lane(&mut connectors, id, row, shape, notes)
            },
        )?;
        let further = ["exit_lane_fid", "entry_lane_fid"];
        self.features("lane_connectors", further, notes, |notes, row, _, [from, to]| {
            let id = row.integer(0)?;
            let Some(connector) = connectors.get_mut(&id) else {
                note(notes, "lane connectors without an area", 1);
                return Ok(());
            };
            connector.successors.extend(to.map(|to| to.to_string()));
            if let Some(lane) = from.and_then(|from| lanes.get_mut(&from)) {
                lane.successors.push(id.to_string());
            }
            Ok(())
        })?;
        let further = ["lane_fid", "lane_connector_fid"];
        self.features("baseline_paths", further, notes, |notes, row, shape, [a, b]| {
            let lane = a.and_then(|id| lanes.get_mut(&id)).or(b.and_then(|id| connectors.get_mut(&id)));
            match lane {
                Some(lane) if lane.centerline.is_empty() => lane.centerline = lines(row, shape)?.concat(),
                Some(_) => note(notes, "further baseline paths of a lane", 1),
                None => note(notes, "baseline paths of unknown lanes", 1),
            }
            Ok(())
        })?;
        Ok((lanes.into_values().collect(), connectors.into_values().collect()))
    }
}

/// Adds a lane of an area; of several parts the largest, of several areas of an id the first.
fn add_lane(
    lanes: &mut BTreeMap<i64, Lane>,
    id: i64,
    row: &Row<'_>,
    shape: Shape,
    notes: &mut Notes,
) -> Result<(), DatasetError> {
    let parts = areas(row, shape)?;
    note(notes, "smaller parts of lanes", parts.len().saturating_sub(1));
    let largest = parts.into_iter().max_by(|a, b| size_m2(a).total_cmp(&size_m2(b)));
    match (lanes.entry(id), largest) {
        (Entry::Vacant(place), Some(outline)) => {
            let (centerline, successors) = Default::default();
            place.insert(Lane { id: id.to_string(), outline, centerline, successors });
        }
        _ => note(notes, "further areas of a lane", 1),
    }
    Ok(())
}

/// The area without its holes, square metres.
fn size_m2(area: &Area) -> f64 {
    let ring = |ring: &Vec<DVec2>| {
        // About a corner rather than the origin, which is far away.
        let Some(origin) = ring.first() else { return 0.0 };
        let next = ring.iter().cycle().skip(1);
        let twice: f64 = ring.iter().zip(next).map(|(a, b)| (*a - origin).perp_dot(*b - origin)).sum();
        twice.abs() / 2.0
    };
    ring(&area.exterior) - area.holes.iter().map(ring).sum::<f64>()
}

fn areas(row: &Row<'_>, shape: Shape) -> Result<Vec<Area>, DatasetError> {
    match shape {
        Shape::Areas(areas) => Ok(areas),
        Shape::Lines(_) => Err(row.wrong(1, "polygons", "lines")),
    }
}

fn lines(row: &Row<'_>, shape: Shape) -> Result<Vec<Vec<DVec2>>, DatasetError> {
    match shape {
        Shape::Lines(lines) => Ok(lines),
        Shape::Areas(_) => Err(row.wrong(1, "lines", "polygons")),
    }
}
