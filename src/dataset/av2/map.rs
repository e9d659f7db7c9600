//! `map/log_map_archive_*.json`: vector map of a log's surroundings, in the city frame.
//!
//! Format: <https://argoverse.github.io/user-guide/api/hd_maps.html>. Lanes of all kinds (vehicles, bikes, buses) are
//! read. Dividers are the painted lane boundaries.

use std::path::{Path, PathBuf};

use glam::DVec2;
use rustc_hash::FxHashSet;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};

use crate::dataset::{Area, DatasetError, Lane, VectorMap};
use crate::error::FileError;
use crate::files::input::read_table;

/// Approximate spacing of centerline points, meters.
const STEP_M: f64 = 0.5;

/// Maximum number of centerline steps, which limits the cost of a damaged coordinate.
const MAX_STEPS: f64 = 2000.0;

const NAME_START: &str = "log_map_archive_";

/// Returns the map files in a folder, sorted by name; empty if the folder does not exist. One file is expected.
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

/// Reads a map.
///
/// # Errors
/// Fails if the file cannot be read or is not such a map, a boundary has fewer than two points, or an area has fewer
/// than three corners.
pub fn read_map_file(path: &Path, location: &str) -> Result<VectorMap, DatasetError> {
    let bytes = read_table(path)?;
    let wrong = |e: serde_json::Error| FileError::content("an Argoverse 2 map", e.to_string(), path);
    let raw: Archive = serde_json::from_slice(&bytes).map_err(wrong)?;
    let told = |e: TooFew| {
        let found = format!("{} in {}", e.found, e.record);
        FileError::content(format!("at least {} different points", e.least), found, path)
    };
    Ok(raw.map(location).map_err(told)?)
}

#[derive(serde::Deserialize)]
struct Archive {
    lane_segments: Entries<LaneSegment>,
    drivable_areas: Entries<DrivableArea>,
    pedestrian_crossings: Entries<Crossing>,
}

#[derive(serde::Deserialize)]
struct LaneSegment {
    id: i64,
    is_intersection: bool,
    left_lane_boundary: Vec<Point>,
    right_lane_boundary: Vec<Point>,
    left_lane_mark_type: String,
    right_lane_mark_type: String,
    successors: Vec<i64>,
}

#[derive(serde::Deserialize)]
struct DrivableArea {
    id: i64,
    area_boundary: Vec<Point>,
}

#[derive(serde::Deserialize)]
struct Crossing {
    id: i64,
    edge1: Vec<Point>,
    edge2: Vec<Point>,
}

#[derive(serde::Deserialize)]
struct Point {
    x: f64,
    y: f64,
}

/// Values of a JSON object, in file order.
struct Entries<T>(Vec<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Entries<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Values<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Values<T> {
            type Value = Entries<T>;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an object by id")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entries<T>, A::Error> {
                let mut values = Vec::new();
                while let Some((_, value)) = map.next_entry::<serde::de::IgnoredAny, T>()? {
                    values.push(value);
                }
                Ok(Entries(values))
            }
        }
        from.deserialize_map(Values(std::marker::PhantomData))
    }
}

/// Error of a line or ring with too few points.
struct TooFew {
    least: usize,
    found: usize,
    record: String,
}

impl Archive {
    fn map(&self, location: &str) -> Result<VectorMap, TooFew> {
        let mut map = VectorMap { location: location.to_owned(), ..VectorMap::default() };
        let mut painted = FxHashSet::default();
        for raw in &self.lane_segments.0 {
            let of = if raw.is_intersection { &mut map.lane_connectors } else { &mut map.lanes };
            of.push(raw.lane(&mut map.dividers, &mut painted)?);
        }
        for raw in &self.drivable_areas.0 {
            let ring = ring(points(&raw.area_boundary), || format!("drivable area {}", raw.id))?;
            map.drivable_area.push(Area { exterior: ring, holes: Vec::new() });
        }
        for raw in &self.pedestrian_crossings.0 {
            let corners = between(&points(&raw.edge1), points(&raw.edge2));
            let ring = ring(corners, || format!("pedestrian crossing {}", raw.id))?;
            map.crossings.push(Area { exterior: ring, holes: Vec::new() });
        }
        Ok(map)
    }
}

impl LaneSegment {
    /// Converts the lane. Appends painted boundaries to `dividers`, unless the adjacent lane has already added them.
    fn lane(
        &self,
        dividers: &mut Vec<Vec<DVec2>>,
        brought: &mut FxHashSet<Vec<[u64; 2]>>,
    ) -> Result<Lane, TooFew> {
        let record = || format!("lane segment {}", self.id);
        let [left, right] = [points(&self.left_lane_boundary), points(&self.right_lane_boundary)];
        for (line, mark) in [(&left, &self.left_lane_mark_type), (&right, &self.right_lane_mark_type)] {
            if line.len() < 2 {
                return Err(TooFew { least: 2, found: line.len(), record: record() });
            }
            let painted = !["NONE", "UNKNOWN"].contains(&mark.as_str());
            if painted && brought.insert(key(line)) {
                dividers.push(line.clone());
            }
        }
        let outline = left.iter().chain(right.iter().rev()).copied().collect();
        Ok(Lane {
            id: self.id.to_string(),
            outline: Area { exterior: ring(outline, record)?, holes: Vec::new() },
            centerline: midway(&left, &right),
            successors: self.successors.iter().map(i64::to_string).collect(),
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
    let mut points: Vec<DVec2> = raw.iter().map(|p| DVec2::new(p.x, p.y)).collect();
    points.dedup();
    points
}

/// Removes repeated corners. Fails if fewer than three remain.
fn ring(mut corners: Vec<DVec2>, record: impl FnOnce() -> String) -> Result<Vec<DVec2>, TooFew> {
    corners.dedup();
    while corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    let found = corners.len();
    if found >= 3 { Ok(corners) } else { Err(TooFew { least: 3, found, record: record() }) }
}

/// Returns the outline between two edges of either direction. The sides of a convex quadrilateral are shorter in sum
/// than its diagonals, so joining the edges the shorter way avoids self-intersection.
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
    fn the_city_stands_in_the_name() {
        let city = |name: &str| city(Some(Path::new(name)));
        assert_eq!(city("a/log_map_archive_7fab____PIT_city_47896.json"), "PIT");
        assert_eq!((city("log_map_archive_7fab.json"), super::city(None)), (String::new(), String::new()));
    }
}
