//! `map.gpkg`: the HD map of a location, one table per layer.
//!
//! The areas of connectors and of lanes are in different layers, and the centerlines of both are in a third
//! one.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use glam::DVec2;
use serde::Deserialize;

use super::database::{Database, Query, Row};
use super::projection::Utm;
use crate::dataset::recording::degenerate::{Fault, Unreadable, note_fault, note_missing};
use crate::dataset::recording::notes::{Counts, count};
use crate::dataset::wkb::{self, Shape};
use crate::dataset::{Area, DatasetError, Lane, RoadNetwork, VectorMap};
use crate::error::FileError;
use crate::files::{FileName, json};

/// Index file of a map folder.
const INDEX: &str = "nuplan-maps-v1.0.json";

/// Layer that every map has.
const LANES: &str = "lanes_polygons";

/// Column with the speed limit, meters per second.
const SPEED_LIMIT: &str = "speed_limit_mps";

/// Groups of lanes, and speed limits in meters per second, by ids of lanes.
type Groups = (BTreeMap<String, String>, BTreeMap<String, f64>);

/// Entry of the index.
#[derive(Deserialize)]
struct IndexEntry {
    version: String,
}

/// Reads a map by name; `None` if the index does not contain it.
pub(super) fn read(folder: &Path, name: &str, location: &str) -> Result<Option<VectorMap>, DatasetError> {
    let path = folder.join(INDEX);
    let index: BTreeMap<String, IndexEntry> = json::read(&path, "a JSON object of maps with their version")?;
    let Some(IndexEntry { version }) = index.get(name) else { return Ok(None) };
    let part =
        |part: &str| FileName::new(part).map_err(|error| error.of("name or version of a map").in_file(&path));
    let database = Database::open(&folder.join(part(name)?).join(part(version)?).join("map.gpkg"))?;
    let layers = Layers { utm: utm(&database)?, columns: geometry_columns(&database)?, database };
    if !layers.columns.contains_key(LANES) {
        return Err(FileError::content(
            format!("layer {LANES}"),
            "none of that name",
            layers.database.path(),
        )
        .into());
    }
    let mut notes = Counts::new();
    let (lanes, lane_connectors) = layers.lanes(&mut notes)?;
    let area = |layer: &str, notes: &mut Counts| layers.areas(layer, notes);
    let roads = area("lane_groups_polygons", &mut notes)?;
    let intersections = area("intersections", &mut notes)?;
    let others = area("generic_drivable_areas", &mut notes)?;
    let car_parks = area("carpark_areas", &mut notes)?;
    // The generic drivable areas alone lack roads and intersections.
    let drivable_area = [&roads, &intersections, &others, &car_parks].map(|areas| &areas[..]).concat();
    Ok(Some(VectorMap {
        location: location.to_owned(),
        lanes,
        lane_connectors,
        drivable_area,
        crossings: layers.areas("crosswalks", &mut notes)?,
        stop_lines: layers.areas("stop_polygons", &mut notes)?,
        walkways: layers.areas("walkways", &mut notes)?,
        dividers: layers.lines("boundaries", &mut notes)?,
        network: layers.groups(&mut notes)?.map(|(roadblocks, speed_limits_mps)| RoadNetwork {
            roads,
            intersections,
            car_parks,
            roadblocks,
            speed_limits_mps,
        }),
        notes,
    }))
}

/// Reads the projected coordinate system of the log.
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

/// Returns the quoted geometry column of each layer.
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
    /// Passes every feature of a layer to `each`, in order of ids: the id, the geometry, and further columns
    /// as identifiers. Counts features with an empty geometry, and those that cannot be read, instead. Maps
    /// of some versions lack layers, which are counted.
    ///
    /// # Errors
    /// Fails if no feature of the layer can be read, or the database is damaged.
    fn features<const N: usize>(
        &self,
        layer: &str,
        further: [&str; N],
        notes: &mut Counts,
        mut each: impl FnMut(&mut Counts, &Row<'_>, Shape, [Option<i64>; N]) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        let Some(geometry) = self.columns.get(layer) else {
            note_missing(notes, layer);
            return Ok(());
        };
        // The rowid is the feature id, whatever its column name.
        let columns: Vec<&str> = ["rowid", geometry].into_iter().chain(further).collect();
        let from = format!("FROM {layer} ORDER BY rowid");
        let mut feature = |row: &Row<'_>| {
            let mut faults = Vec::new();
            let shape = match row.is_null(1) {
                true => None,
                false => wkb::decode_gpkg(row.blob(1)?, &|place| self.utm.project(place), &mut faults)
                    .map_err(|found| row.wrong(1, "lines or polygons in longitude and latitude", &found))?,
            };
            for fault in &faults {
                note_fault(notes, &format!("geometries of {layer}"), *fault);
            }
            let Some(shape) = shape else {
                let is_empty = usize::from(faults.is_empty());
                count(notes, &format!("features of {layer} with an empty geometry"), is_empty);
                return Ok(());
            };
            let mut ids = [None; N];
            for (i, id) in ids.iter_mut().enumerate() {
                *id = row.identifier(2 + i)?;
            }
            each(notes, row, shape, ids)
        };
        let (mut known, mut unreadable) = (0, Unreadable::default());
        self.database.rows(&Query { table: layer, columns: &columns, from: &from }, |row| {
            match feature(row) {
                Ok(()) => known += 1,
                Err(error) => unreadable.add(|| error),
            }
            Ok(())
        })?;
        unreadable.note(layer, known, notes)
    }

    fn areas(&self, layer: &str, notes: &mut Counts) -> Result<Vec<Area>, DatasetError> {
        let mut all = Vec::new();
        self.features(layer, [], notes, |_, row, shape, []| {
            all.extend(areas(row, shape)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Reads the groups of lanes and lane connectors, and their speed limits, by their ids; `None` if the map
    /// has no groups. Rows that cannot be read are counted.
    fn groups(&self, notes: &mut Counts) -> Result<Option<Groups>, DatasetError> {
        let (mut roadblocks, mut limits_mps) = Groups::default();
        for (table, group) in [(LANES, "lane_group_fid"), ("lane_connectors", "lane_group_connector_fid")] {
            for column in [group, SPEED_LIMIT] {
                if !self.database.has_column(table, column)? {
                    return Ok(None);
                }
            }
            let mut add = |row: &Row<'_>| -> Result<(), DatasetError> {
                let id = row.integer(0)?.to_string();
                let limit_mps = if row.is_null(2) { None } else { Some(row.number(2)?) };
                let limit_mps = limit_mps.filter(|limit_mps| limit_mps.is_finite() && *limit_mps > 0.0);
                limits_mps.extend(limit_mps.map(|limit_mps| (id.clone(), limit_mps)));
                roadblocks.extend(row.identifier(1)?.map(|group| (id, group.to_string())));
                Ok(())
            };
            let (mut known, mut unreadable) = (0, Unreadable::default());
            let columns = ["rowid", group, SPEED_LIMIT];
            let query = Query { table, columns: &columns, from: &format!("FROM {table}") };
            self.database.rows(&query, |row| {
                match add(row) {
                    Ok(()) => known += 1,
                    Err(error) => unreadable.add(|| error),
                }
                Ok(())
            })?;
            unreadable.note(&format!("groups of {table}"), known, notes)?;
        }
        Ok(Some((roadblocks, limits_mps)))
    }

    fn lines(&self, layer: &str, notes: &mut Counts) -> Result<Vec<Vec<DVec2>>, DatasetError> {
        let mut all = Vec::new();
        self.features(layer, [], notes, |_, row, shape, []| {
            all.extend(lines(row, shape)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Reads lanes and lane connectors, each in order of ids.
    fn lanes(&self, notes: &mut Counts) -> Result<(Vec<Lane>, Vec<Lane>), DatasetError> {
        let (mut lanes, mut connectors) = (BTreeMap::new(), BTreeMap::new());
        self.features(LANES, [], notes, |notes, row, shape, []| {
            add_lane(&mut lanes, row.integer(0)?, row, shape, notes)
        })?;
        let further = ["lane_connector_fid"];
        self.features(
            "gen_lane_connectors_scaled_width_polygons",
            further,
            notes,
            |notes, row, shape, [id]| match id {
                Some(id) => add_lane(&mut connectors, id, row, shape, notes),
                None => {
                    note_fault(notes, "areas of lane connectors", Fault::Dangling);
                    Ok(())
                }
            },
        )?;
        let further = ["exit_lane_fid", "entry_lane_fid"];
        self.features("lane_connectors", further, notes, |notes, row, _, [from, to]| {
            let id = row.integer(0)?;
            let Some(connector) = connectors.get_mut(&id) else {
                count(notes, "lane connectors without an area", 1);
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
                Some(_) => count(notes, "further baseline paths of a lane", 1),
                None => count(notes, "baseline paths of unknown lanes", 1),
            }
            Ok(())
        })?;
        Ok((lanes.into_values().collect(), connectors.into_values().collect()))
    }
}

/// Adds a lane. Uses the largest part of an area, and the first area of an id.
fn add_lane(
    lanes: &mut BTreeMap<i64, Lane>,
    id: i64,
    row: &Row<'_>,
    shape: Shape,
    notes: &mut Counts,
) -> Result<(), DatasetError> {
    let parts = areas(row, shape)?;
    count(notes, "smaller parts of lanes", parts.len().saturating_sub(1));
    let largest = parts.into_iter().max_by(|a, b| size_m2(a).total_cmp(&size_m2(b)));
    match (lanes.entry(id), largest) {
        (Entry::Vacant(place), Some(outline)) => {
            let (centerline, successors) = Default::default();
            place.insert(Lane { id: id.to_string(), outline, centerline, successors });
        }
        _ => count(notes, "further areas of a lane", 1),
    }
    Ok(())
}

/// Returns the area without holes, square meters.
fn size_m2(area: &Area) -> f64 {
    let ring = |ring: &Vec<DVec2>| {
        // Relative to a corner, since the coordinate origin is far away.
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
