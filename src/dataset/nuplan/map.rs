//! `map.gpkg`: the HD map of a place, a layer a table.
//!
//! A connector's area stands in another layer than its lanes, and the middle of both in a third.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec2;
use serde::Deserialize;

use super::database::{Database, Query, Row};
use super::geometry::{self, Shape};
use super::place::leads_below;
use super::projection::Utm;
use crate::dataset::{Area, DatasetError, Lane, VectorMap};
use crate::error::FileError;

/// The index of a folder of maps.
const INDEX: &str = "nuplan-maps-v1.0.json";

/// An entry of the index.
#[derive(Deserialize)]
struct Entry {
    version: String,
}

/// Reads the map of a name; `None` if the index does not have it.
pub(super) fn read(folder: &Path, name: &str, location: &str) -> Result<Option<VectorMap>, DatasetError> {
    let path = folder.join(INDEX);
    let bytes = std::fs::read(&path).map_err(FileError::io("read", &path))?;
    let index: BTreeMap<String, Entry> = serde_json::from_slice(&bytes)
        .map_err(|e| FileError::content("a JSON object of maps with their version", e.to_string(), &path))?;
    let Some(Entry { version }) = index.get(name) else { return Ok(None) };
    if let Some(part) = [name, version].into_iter().find(|part| !leads_below(part)) {
        return Err(FileError::content("names of folders", format!("{part:?}"), &path).into());
    }
    let database = Database::open(&folder.join(name).join(version).join("map.gpkg"))?;
    let layers = Layers { utm: utm(&database)?, columns: geometry_columns(&database)?, database };
    let (lanes, lane_connectors) = layers.lanes()?;
    Ok(Some(VectorMap {
        location: location.to_owned(),
        lanes,
        lane_connectors,
        drivable_area: layers.drivable_area()?,
        crossings: layers.areas("crosswalks")?,
        stop_lines: layers.areas("stop_polygons")?,
        dividers: layers.lines("boundaries")?,
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
    /// identifiers.
    fn features<const N: usize>(
        &self,
        layer: &str,
        further: [&str; N],
        mut each: impl FnMut(&Row<'_>, i64, Shape, [Option<i64>; N]) -> Result<(), DatasetError>,
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
            let mut ids = [None; N];
            for (i, id) in ids.iter_mut().enumerate() {
                *id = row.identifier(2 + i)?;
            }
            each(row, row.integer(0)?, shape, ids)
        })
    }

    fn areas(&self, layer: &str) -> Result<Vec<Area>, DatasetError> {
        let mut all = Vec::new();
        self.features(layer, [], |row, _, shape, []| {
            all.extend(areas(row, shape)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Roads outside of junctions, junctions, and what is neither: the layer of that name has only the last.
    fn drivable_area(&self) -> Result<Vec<Area>, DatasetError> {
        let mut all = Vec::new();
        for layer in ["lane_groups_polygons", "intersections", "generic_drivable_areas", "carpark_areas"] {
            all.extend(self.areas(layer)?);
        }
        Ok(all)
    }

    fn lines(&self, layer: &str) -> Result<Vec<Vec<DVec2>>, DatasetError> {
        let mut all = Vec::new();
        self.features(layer, [], |row, _, shape, []| {
            all.extend(lines(row, shape)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Lanes and lane connectors, each in order of their ids.
    fn lanes(&self) -> Result<(Vec<Lane>, Vec<Lane>), DatasetError> {
        let mut lanes = BTreeMap::new();
        self.features("lanes_polygons", [], |row, id, shape, []| {
            lanes.insert(id, lane(id, area(row, shape)?));
            Ok(())
        })?;
        let mut connectors = BTreeMap::new();
        let further = ["lane_connector_fid"];
        self.features("gen_lane_connectors_scaled_width_polygons", further, |row, _, shape, [id]| {
            let id = id.ok_or_else(|| row.wrong(2, "the id of a lane connector", "NULL"))?;
            connectors.insert(id, lane(id, area(row, shape)?));
            Ok(())
        })?;
        let further = ["exit_lane_fid", "entry_lane_fid"];
        self.features("lane_connectors", further, |row, id, _, [from, to]| {
            let area_layer = "a row of the connector in gen_lane_connectors_scaled_width_polygons";
            let connector = connectors.get_mut(&id).ok_or_else(|| row.wrong(0, area_layer, "none"))?;
            connector.successors.extend(to.map(|to| to.to_string()));
            if let Some(lane) = from.and_then(|from| lanes.get_mut(&from)) {
                lane.successors.push(id.to_string());
            }
            Ok(())
        })?;
        // A path of a lane that the map does not have is no lane's middle.
        self.features("baseline_paths", ["lane_fid", "lane_connector_fid"], |row, _, shape, [a, b]| {
            let lane = a.and_then(|id| lanes.get_mut(&id)).or(b.and_then(|id| connectors.get_mut(&id)));
            if let Some(lane) = lane {
                lane.centerline = lines(row, shape)?.concat();
            }
            Ok(())
        })?;
        Ok((lanes.into_values().collect(), connectors.into_values().collect()))
    }
}

fn lane(id: i64, outline: Area) -> Lane {
    Lane { id: id.to_string(), outline, centerline: Vec::new(), successors: Vec::new() }
}

fn areas(row: &Row<'_>, shape: Shape) -> Result<Vec<Area>, DatasetError> {
    match shape {
        Shape::Areas(areas) => Ok(areas),
        Shape::Lines(_) => Err(row.wrong(1, "polygons", "lines")),
    }
}

/// The area of a feature that is one.
fn area(row: &Row<'_>, shape: Shape) -> Result<Area, DatasetError> {
    let mut areas = areas(row, shape)?;
    match (areas.pop(), areas.len()) {
        (Some(area), 0) => Ok(area),
        (_, others) => Err(row.wrong(1, "one polygon", &(others + 1).to_string())),
    }
}

fn lines(row: &Row<'_>, shape: Shape) -> Result<Vec<Vec<DVec2>>, DatasetError> {
    match shape {
        Shape::Lines(lines) => Ok(lines),
        Shape::Areas(_) => Err(row.wrong(1, "lines", "polygons")),
    }
}
