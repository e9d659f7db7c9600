//! `map/log_map_archive_*.json`: vector map of a log's surroundings, in the city frame.
//!
//! Format: <https://argoverse.github.io/user-guide/api/hd_maps.html>. Lanes of all kinds (vehicles, bikes,
//! buses) are read. Dividers are the painted lane boundaries.

use std::path::{Path, PathBuf};

use glam::DVec2;
use rustc_hash::FxHashSet;

use crate::dataset::lenient::{ById, Coordinate, Id, Records, or_default};
use crate::dataset::recording::degenerate::{self, Fault, note_fault};
use crate::dataset::recording::notes::count;
use crate::dataset::{Area, DatasetError, Lane, VectorMap};
use crate::error::FileError;
use crate::files::json;

/// Approximate spacing of centerline points, meters.
const STEP_M: f64 = 0.5;

/// Maximum number of centerline steps, which limits the cost of a damaged coordinate.
const MAX_STEPS: f64 = 2000.0;

const NAME_START: &str = "log_map_archive_";

/// Returns the map files in a folder, sorted by name; empty if the folder does not exist. One file is
/// expected.
///
/// # Errors
/// Fails if the folder cannot be read.
pub(super) fn find(folder: &Path) -> Result<Vec<PathBuf>, FileError> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(FileError::io("read", folder))?,
    };
    let mut maps = Vec::new();
    for entry in entries {
        let path = entry.map_err(FileError::io("read", folder))?.path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if name.starts_with(NAME_START) && name.ends_with(".json") {
            maps.push(path);
        }
    }
    maps.sort();
    Ok(maps)
}

/// Returns the city in a map file's name, `.._LOG_ID____PIT_city_47896.json`; empty if it has none.
pub(super) fn city(map: Option<&Path>) -> String {
    let name = map.and_then(|path| path.file_name()?.to_str()).unwrap_or_default();
    let city = name.split_once("____").and_then(|(_, rest)| rest.split_once("_city_"));
    city.map_or_else(String::new, |(city, _)| city.to_owned())
}

/// Reads a map. Records without an area or a length, those that cannot be read, and missing layers of areas
/// are counted.
///
/// # Errors
/// Fails if the file cannot be read or has no lanes, or if no record of a layer can be read.
pub fn read_map_file(path: &Path, location: &str) -> Result<VectorMap, DatasetError> {
    let raw: Archive = json::read(path, "an Argoverse 2 map")?;
    let wrong = |found| FileError::content("an Argoverse 2 map", found, path).into();
    raw.map(location).map_err(wrong)
}

#[derive(serde::Deserialize)]
struct Archive {
    lane_segments: ById<LaneSegment>,
    drivable_areas: Option<ById<DrivableArea>>,
    pedestrian_crossings: Option<ById<Crossing>>,
}

#[derive(serde::Deserialize)]
struct LaneSegment {
    id: Id,
    is_intersection: bool,
    #[serde(default, deserialize_with = "or_default")]
    left_lane_boundary: Vec<Point>,
    #[serde(default, deserialize_with = "or_default")]
    right_lane_boundary: Vec<Point>,
    left_lane_mark_type: Option<String>,
    right_lane_mark_type: Option<String>,
    #[serde(default, deserialize_with = "or_default")]
    successors: Vec<Id>,
}

#[derive(serde::Deserialize)]
struct DrivableArea {
    #[serde(default, deserialize_with = "or_default")]
    area_boundary: Vec<Point>,
}

#[derive(serde::Deserialize)]
struct Crossing {
    #[serde(default, deserialize_with = "or_default")]
    edge1: Vec<Point>,
    #[serde(default, deserialize_with = "or_default")]
    edge2: Vec<Point>,
}

#[derive(serde::Deserialize)]
struct Point {
    #[serde(default)]
    x: Coordinate,
    #[serde(default)]
    y: Coordinate,
}

impl Archive {
    /// Converts the map.
    ///
    /// # Errors
    /// Returns the error of a record if no record of its layer can be read.
    fn map(self, location: &str) -> Result<VectorMap, String> {
        let mut map = VectorMap { location: location.to_owned(), ..VectorMap::default() };
        let areas = self.drivable_areas.map(|layer| layer.0);
        let crossings = self.pedestrian_crossings.map(|layer| layer.0);
        let lanes = Records::of_layer("lane_segments", Some(self.lane_segments.0), &mut map.notes)?;
        let mut painted = FxHashSet::default();
        for raw in &lanes {
            let unmarked = [&raw.left_lane_mark_type, &raw.right_lane_mark_type];
            let unmarked = unmarked.iter().filter(|mark| mark.is_none()).count();
            count(&mut map.notes, "lane boundaries without a mark type (not drawn)", unmarked);
            let of = if raw.is_intersection { &mut map.lane_connectors } else { &mut map.lanes };
            match raw.lane(&mut map.dividers, &mut painted) {
                Ok(lane) => of.push(lane),
                Err(fault) => note_fault(&mut map.notes, "lane segments", fault),
            }
        }
        for raw in Records::of_layer("drivable_areas", areas, &mut map.notes)? {
            match area(points(&raw.area_boundary)) {
                Ok(area) => map.drivable_area.push(area),
                Err(fault) => note_fault(&mut map.notes, "drivable areas", fault),
            }
        }
        for raw in Records::of_layer("pedestrian_crossings", crossings, &mut map.notes)? {
            match area(between(&points(&raw.edge1), points(&raw.edge2))) {
                Ok(area) => map.crossings.push(area),
                Err(fault) => note_fault(&mut map.notes, "crossings", fault),
            }
        }
        Ok(map)
    }
}

impl LaneSegment {
    /// Converts the lane. Appends painted boundaries to `dividers`, unless the adjacent lane has already
    /// added them.
    fn lane(
        &self,
        dividers: &mut Vec<Vec<DVec2>>,
        brought: &mut FxHashSet<Vec<[u64; 2]>>,
    ) -> Result<Lane, Fault> {
        let left = degenerate::line(points(&self.left_lane_boundary))?;
        let right = degenerate::line(points(&self.right_lane_boundary))?;
        let outline = area(left.iter().chain(right.iter().rev()).copied().collect())?;
        for (line, mark) in [(&left, &self.left_lane_mark_type), (&right, &self.right_lane_mark_type)] {
            let painted = !["NONE", "UNKNOWN"].contains(&mark.as_deref().unwrap_or("UNKNOWN"));
            if painted && brought.insert(key(line)) {
                dividers.push(line.clone());
            }
        }
        Ok(Lane {
            id: self.id.to_string(),
            outline,
            centerline: midway(&left, &right),
            successors: self.successors.iter().map(Id::to_string).collect(),
        })
    }
}

/// Returns a key that is equal for a line and its reverse.
fn key(line: &[DVec2]) -> Vec<[u64; 2]> {
    // Adding 0 turns -0 into 0.
    let bits: Vec<[u64; 2]> = line.iter().map(|p| (*p + 0.0).to_array().map(f64::to_bits)).collect();
    let reversed = bits.iter().rev().copied().collect();
    bits.min(reversed)
}

fn points(raw: &[Point]) -> Vec<DVec2> {
    let mut points: Vec<DVec2> = raw.iter().map(|p| DVec2::new(p.x.0, p.y.0)).collect();
    points.dedup();
    points
}

/// Returns the area of a ring without repeated corners.
fn area(mut corners: Vec<DVec2>) -> Result<Area, Fault> {
    corners.dedup();
    Ok(Area { exterior: degenerate::ring(corners)?, holes: Vec::new() })
}

/// Returns the outline between two edges of either direction. The sides of a convex quadrilateral are shorter
/// in sum than its diagonals, so joining the edges the shorter way avoids self-intersection.
fn between(edge1: &[DVec2], mut edge2: Vec<DVec2>) -> Vec<DVec2> {
    if let (Some((a, b)), Some((c, d))) = (ends(edge1), ends(&edge2))
        && b.distance(d) + c.distance(a) < b.distance(c) + d.distance(a)
    {
        edge2.reverse();
    }
    edge1.iter().copied().chain(edge2).collect()
}

fn ends(line: &[DVec2]) -> Option<(DVec2, DVec2)> {
    line.first().copied().zip(line.last().copied())
}

/// Returns the line midway between two lines, sampled at equal fractions of their lengths.
fn midway(left: &[DVec2], right: &[DVec2]) -> Vec<DVec2> {
    let (left_m, right_m) = (lengths(left), lengths(right));
    let last = |lengths: &[f64]| lengths.last().copied().unwrap_or(0.0);
    let longer_m = last(&left_m).max(last(&right_m));
    let steps = (longer_m / STEP_M).ceil().clamp(1.0, MAX_STEPS) as u32;
    let at = |line: &[DVec2], lengths: &[f64], share: f64| {
        let along = share * last(lengths);
        let next = lengths.partition_point(|l| *l < along).clamp(1, line.len() - 1);
        let (from, to) = (lengths[next - 1], lengths[next]);
        line[next - 1].lerp(line[next], ((along - from) / (to - from)).clamp(0.0, 1.0))
    };
    let middle = |step: u32| {
        let share = f64::from(step) / f64::from(steps);
        at(left, &left_m, share).midpoint(at(right, &right_m, share))
    };
    (0..=steps).map(middle).collect()
}

/// Returns the arc length at each point of a line, meters.
fn lengths(line: &[DVec2]) -> Vec<f64> {
    let mut along = 0.0;
    let steps = line.windows(2).map(|pair| pair[0].distance(pair[1]));
    std::iter::once(0.0)
        .chain(steps.map(|step| {
            along += step;
            along
        }))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(corners: &[(f64, f64)]) -> Vec<DVec2> {
        corners.iter().map(|(x, y)| DVec2::new(*x, *y)).collect()
    }

    #[test]
    fn the_middle_lies_midway() {
        let left = line(&[(0.0, 2.0), (3.0, 2.0), (10.0, 2.0)]);
        let middle = midway(&left, &line(&[(0.0, 0.0), (10.0, 0.0)]));
        assert_eq!(middle.len(), 21);
        assert!(middle.iter().enumerate().all(|(i, p)| p.distance(DVec2::new(0.5 * i as f64, 1.0)) < 1e-12));
        // Arcs about the origin with radius 10 and 14; their center line has radius 12.
        let arc =
            |r: f64| (0..=90).map(|d| DVec2::from_angle(f64::from(d).to_radians()) * r).collect::<Vec<_>>();
        let middle = midway(&arc(10.0), &arc(14.0));
        assert!(middle.iter().all(|p| (p.length() - 12.0).abs() < 1e-3));
        assert_eq!(midway(&left, &line(&[(0.0, 0.0), (1e300, 0.0)])).len(), 2001);
    }

    #[test]
    fn a_crossing_does_not_cross_itself() {
        let edge = line(&[(0.0, 0.0), (4.0, 0.0)]);
        let square = line(&[(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]);
        assert_eq!(between(&edge, line(&[(0.0, 3.0), (4.0, 3.0)])), square);
        assert_eq!(between(&edge, line(&[(4.0, 3.0), (0.0, 3.0)])), square);
    }

    #[test]
    fn the_city_is_parsed_from_the_name() {
        let city = |name: &str| city(Some(Path::new(name)));
        assert_eq!(city("a/log_map_archive_7fab____PIT_city_47896.json"), "PIT");
        assert_eq!((city("log_map_archive_7fab.json"), super::city(None)), (String::new(), String::new()));
    }
}
