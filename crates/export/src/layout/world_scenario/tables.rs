//! Table rows of a clip.

use std::ops::{Range, RangeInclusive};
use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use point_skeleton::dataset::{EgoTrack, Frame, Recording, VectorMap};
use point_skeleton::error::FileError;
use point_skeleton::geometry::Pose;

use super::super::slots;
use super::parquet::{Column, encode};
use super::rig::rig;

/// Map items farther than this from the ego's path are left out, meters.
const AROUND_M: f64 = 150.0;
/// Version of the data, which readers ignore.
pub(super) const VERSION: i64 = 1;

/// A table of a clip.
pub(in crate::layout) struct Table {
    pub(in crate::layout) kind: &'static str,
    pub(super) schema: String,
    /// Leaves of the schema; the first one is a text.
    pub(super) columns: Vec<Column>,
}

impl Table {
    fn is_empty(&self) -> bool {
        matches!(self.columns.first(), Some(Column::Text(rows)) if rows.is_empty())
    }

    /// Encodes the table as a Parquet file.
    ///
    /// # Errors
    /// Fails if the columns do not fit the schema.
    pub(in crate::layout) fn encode(&self) -> Result<Vec<u8>, FileError> {
        let name = format!("{}.parquet", self.kind);
        let failed = |error| FileError::io("write", Path::new(&name))(std::io::Error::other(error));
        encode(&self.schema, &self.columns).map_err(failed)
    }
}

/// Some frames of a log.
pub(in crate::layout) struct Clip<'a> {
    pub(in crate::layout) log: &'a Recording,
    pub(in crate::layout) frames: &'a [Frame],
    pub(in crate::layout) name: String,
    /// Frame of all coordinates.
    pub(in crate::layout) clip_from_global: Pose,
}

impl<'a> Clip<'a> {
    /// Creates a clip in coordinates of the ego at the first frame that is near most others.
    pub(super) fn new(log: &'a Recording, frames: Range<usize>, name: &str) -> Self {
        let frames = log.frames.get(frames).unwrap_or_default();
        let origin = Frame::origin_of(frames).map_or(Pose::IDENTITY, |frame| frame.global_from_ego);
        Self { log, frames, name: name.to_owned(), clip_from_global: origin.inverse() }
    }

    /// Returns the tables; the map's only if they have rows.
    pub(in crate::layout) fn tables(&self, map: Option<&VectorMap>) -> Vec<Table> {
        let mut tables = vec![self.obstacles(), self.calibration(), self.egomotion()];
        if let Some(map) = map {
            tables.extend(self.map_tables(map));
        }
        tables
    }

    fn obstacles(&self) -> Table {
        let boxes = self.frames.iter().flat_map(|frame| frame.boxes.iter().map(move |item| (frame, item)));
        let boxes: Vec<_> = boxes.collect();
        let poses: Vec<Pose> =
            boxes.iter().map(|(_, item)| self.clip_from_global * item.cuboid.pose).collect();
        let mut columns = vec![
            self.clip_ids(boxes.len()),
            Column::Int(boxes.iter().map(|(frame, _)| frame.t_us).collect()),
            Column::Text(boxes.iter().map(|_| self.log.name.clone()).collect()),
            Column::Text(boxes.iter().map(|(_, item)| self.log.tracks[item.track].id.clone()).collect()),
        ];
        columns.extend(vector(poses.iter().map(|pose| pose.translation)));
        columns.extend(vector(boxes.iter().map(|(_, item)| item.cuboid.size)));
        columns.extend(quaternion(poses.iter().map(|pose| pose.rotation)));
        let category = |track: usize| category(&self.log.tracks[track].category).to_owned();
        columns.push(Column::Text(boxes.iter().map(|(_, item)| category(item.track)).collect()));
        columns.push(Column::Int(vec![VERSION; boxes.len()]));
        let fields = format!(
            "{} {} {} {} {}",
            text("trackline_id"),
            xyz("center"),
            xyz("size"),
            xyzw("orientation"),
            text("category")
        );
        table("obstacle", &format!("{} {}", time_key(), text("label_class_id")), &fields, columns)
    }

    fn calibration(&self) -> Table {
        let names = slots::names(&self.log.rig);
        let named: Vec<_> =
            names.iter().zip(&self.log.rig).filter_map(|(name, rig)| Some(((*name)?, rig))).collect();
        let columns = vec![
            self.clip_ids(1),
            Column::Int(vec![-1]),
            Column::Text(vec![self.log.name.clone()]),
            Column::Text(vec![rig(&named).to_string()]),
            Column::Int(vec![VERSION]),
        ];
        table("calibration_estimate", &time_key(), &format!("{} {}", text("name"), text("rig_json")), columns)
    }

    /// Returns the time between the first and the last frame, microseconds; `None` without frames.
    pub(in crate::layout) fn times_us(&self) -> Option<RangeInclusive<i64>> {
        self.frames.first().zip(self.frames.last()).map(|(first, last)| first.t_us..=last.t_us)
    }

    /// Returns the ego's poses at frames and sweeps, with their times in microseconds.
    pub(in crate::layout) fn ego_poses(&self) -> Vec<(i64, Pose)> {
        let Some(times_us) = self.times_us() else { return Vec::new() };
        let track = EgoTrack::new(self.log);
        let within = track.poses().iter().filter(|(t_us, _)| times_us.contains(t_us));
        let mut poses: Vec<_> = within.map(|(t_us, pose)| (*t_us, self.clip_from_global * *pose)).collect();
        poses.dedup_by_key(|(t_us, _)| *t_us);
        poses
    }

    fn egomotion(&self) -> Table {
        let poses = self.ego_poses();
        let mut columns = vec![
            self.clip_ids(poses.len()),
            Column::Int(poses.iter().map(|(t_us, _)| *t_us).collect()),
            Column::Text(vec!["recorded".to_owned(); poses.len()]),
        ];
        columns.extend(vector(poses.iter().map(|(_, pose)| pose.translation)));
        columns.extend(quaternion(poses.iter().map(|(_, pose)| pose.rotation)));
        columns.push(Column::Int(vec![VERSION; poses.len()]));
        let fields = format!("{} {} {}", text("name"), xyz("location"), xyzw("orientation"));
        table("egomotion_estimate", &time_key(), &fields, columns)
    }

    fn map_tables(&self, map: &VectorMap) -> Vec<Table> {
        let tables = [
            self.lane_lines(&self.near(map.dividers.clone())),
            self.road_boundaries(map),
            self.crosswalks(map),
            self.wait_lines(numbered(self.stop_lines(map))),
        ];
        tables.into_iter().filter(|table| !table.is_empty()).collect()
    }

    /// Returns the outlines of drivable areas and of the holes in them.
    pub(super) fn road_boundaries(&self, map: &VectorMap) -> Table {
        let rings =
            map.drivable_area.iter().flat_map(|area| std::iter::once(&area.exterior).chain(&area.holes));
        let lines = self.near(rings.map(|ring| closed(ring)).collect());
        self.places("road_boundary", "road_boundary", numbered(lines), Vec::new())
    }

    fn crosswalks(&self, map: &VectorMap) -> Table {
        let lines = self.near(map.crossings.iter().map(|area| area.exterior.clone()).collect());
        self.places("crosswalk", "PEDESTRIAN", numbered(lines), Vec::new())
    }

    /// Returns the closed outlines of the stop areas near the ego's path.
    pub(super) fn stop_lines(&self, map: &VectorMap) -> Vec<Vec<DVec2>> {
        self.near(map.stop_lines.iter().map(|area| closed(&area.exterior)).collect())
    }

    /// Returns the table of stop lines, which are given with their ids.
    pub(super) fn wait_lines(&self, lines: Vec<(String, Vec<DVec2>)>) -> Table {
        let implicit = (flag("is_implicit"), Column::Bool(vec![false; lines.len()]));
        let subtype = (text("intersection_subtype"), Column::Text(vec!["UNKNOWN".to_owned(); lines.len()]));
        self.places("wait_line", "STOP", lines, vec![implicit, subtype])
    }

    /// Returns a table of lines of one category, which are given with their ids.
    fn places(
        &self,
        kind: &'static str,
        category: &str,
        lines: Vec<(String, Vec<DVec2>)>,
        more: Vec<(String, Column)>,
    ) -> Table {
        let (ids, lines): (Vec<String>, Vec<Vec<DVec2>>) = lines.into_iter().unzip();
        let rows = lines.len();
        let mut columns = self.map_key(ids);
        columns.push(Column::Text(vec![category.to_owned(); rows]));
        columns.extend(self.rail(&lines));
        let fields = format!("{} {}", text("category"), points("location"));
        let fields = more.iter().fold(fields, |fields, (field, _)| format!("{fields} {field}"));
        columns.extend(more.into_iter().map(|(_, column)| column));
        columns.push(Column::Int(vec![VERSION; rows]));
        table(kind, &map_key(), &fields, columns)
    }

    fn lane_lines(&self, lines: &[Vec<DVec2>]) -> Table {
        let each = |value: &str| {
            Column::Texts(lines.iter().map(|line| vec![value.to_owned(); line.len()]).collect())
        };
        let mut columns = self.map_key((0..lines.len()).map(|number| number.to_string()).collect());
        columns.extend(self.rail(lines));
        columns.extend([each("SOLID_SINGLE"), each("WHITE"), Column::Int(vec![VERSION; lines.len()])]);
        let fields = format!("{} {} {}", points("line_rail"), texts("styles"), texts("colors"));
        table("lane_line", &map_key(), &fields, columns)
    }

    pub(super) fn clip_ids(&self, rows: usize) -> Column {
        Column::Text(vec![self.name.clone(); rows])
    }

    /// Returns the key of map items with these ids.
    pub(super) fn map_key(&self, ids: Vec<String>) -> Vec<Column> {
        let same = |value: &str| Column::Text(vec![value.to_owned(); ids.len()]);
        let [clip, label, version] = [same(&self.name), same(&self.log.name), same("1")];
        vec![clip, label, Column::Text(ids), version]
    }

    /// Returns the lines with a point near the ego's path.
    fn near(&self, lines: Vec<Vec<DVec2>>) -> Vec<Vec<DVec2>> {
        lines.into_iter().filter(|line| self.is_near(line)).collect()
    }

    /// Returns whether a line has a point near the ego's path.
    pub(super) fn is_near(&self, line: &[DVec2]) -> bool {
        let mut path = self.frames.iter().map(|frame| frame.global_from_ego.translation.truncate());
        path.any(|ego| line.iter().any(|at| ego.distance(*at) < AROUND_M))
    }

    /// Returns points of lines in coordinates of the clip, at the height of the nearest ego pose.
    pub(super) fn rail(&self, lines: &[Vec<DVec2>]) -> [Column; 3] {
        let height = |at: DVec2| {
            let poses = self.frames.iter().map(|frame| frame.global_from_ego.translation);
            poses
                .min_by(|a, b| a.truncate().distance(at).total_cmp(&b.truncate().distance(at)))
                .map_or(0.0, |p| p.z)
        };
        let point = |at: &DVec2| self.clip_from_global.transform_point(at.extend(height(*at)));
        let placed: Vec<Vec<DVec3>> = lines.iter().map(|line| line.iter().map(point).collect()).collect();
        std::array::from_fn(|axis| {
            Column::Numbers(placed.iter().map(|line| line.iter().map(|p| p[axis]).collect()).collect())
        })
    }
}

/// Returns the object type of a category.
pub(in crate::layout) fn category(category: &str) -> &'static str {
    let has = |part: &str| category.split('.').any(|p| p == part);
    match () {
        () if has("bicycle") || has("motorcycle") => "rider",
        () if has("stroller") => "stroller",
        () if has("pedestrian") => "person",
        () if has("bus") => "bus",
        () if has("truck") || has("construction") => "heavy_truck",
        () if has("trailer") => "trailer",
        () if has("vehicle") => "automobile",
        () if has("animal") => "animal",
        () => "protruding_object",
    }
}

fn closed(ring: &[DVec2]) -> Vec<DVec2> {
    ring.iter().chain(ring.first()).copied().collect()
}

/// Numbers lines from 0.
fn numbered(lines: Vec<Vec<DVec2>>) -> Vec<(String, Vec<DVec2>)> {
    lines.into_iter().enumerate().map(|(number, line)| (number.to_string(), line)).collect()
}

fn vector(values: impl Iterator<Item = DVec3> + Clone) -> [Column; 3] {
    std::array::from_fn(|axis| Column::Number(values.clone().map(|v| v[axis]).collect()))
}

fn quaternion(values: impl Iterator<Item = DQuat> + Clone) -> [Column; 4] {
    std::array::from_fn(|axis| Column::Number(values.clone().map(|q| q.to_array()[axis]).collect()))
}

pub(super) fn table(kind: &'static str, key: &str, fields: &str, columns: Vec<Column>) -> Table {
    let version = "required int64 version (INTEGER(64,false));";
    let schema = format!(
        "message table {{ required group key {{ {key} }} required group {kind} {{ {fields} }} {version} }}"
    );
    Table { kind, schema, columns }
}

fn time_key() -> String {
    format!("{} required int64 timestamp_micros;", text("clip_id"))
}

pub(super) fn map_key() -> String {
    ["clip_id", "label_class_id", "map_id", "map_id_version"].map(text).join(" ")
}

pub(super) fn text(name: &str) -> String {
    format!("required binary {name} (STRING);")
}

fn flag(name: &str) -> String {
    format!("required boolean {name};")
}

pub(super) fn xyz(name: &str) -> String {
    format!("required group {name} {{ required double x; required double y; required double z; }}")
}

pub(super) fn xyzw(name: &str) -> String {
    format!(
        "required group {name} {{ required double x; required double y; required double z; required double \
            w; }}"
    )
}

pub(super) fn points(name: &str) -> String {
    format!("required group {name} (LIST) {{ repeated group list {{ {} }} }}", xyz("element"))
}

pub(super) fn texts(name: &str) -> String {
    format!("required group {name} (LIST) {{ repeated group list {{ {} }} }}", text("element"))
}
