//! Table rows of a clip.

use std::ops::Range;

use glam::{DQuat, DVec2, DVec3};
use point_skeleton::dataset::{EgoTrack, Frame, Recording, VectorMap};
use point_skeleton::geometry::Pose;

use super::super::slots;
use super::parquet::Column;
use super::rig::rig;

/// Map items farther than this from the ego's path are left out, meters.
const AROUND_M: f64 = 150.0;
/// Version of the data, which readers ignore.
const VERSION: i64 = 1;

/// A table of a clip.
pub(super) struct Table {
    pub(super) kind: &'static str,
    pub(super) schema: String,
    pub(super) columns: Vec<Column>,
}

/// Some frames of a log.
pub(super) struct Clip<'a> {
    log: &'a Recording,
    frames: &'a [Frame],
    name: String,
    /// Pose of the first frame near most others.
    clip_from_global: Pose,
}

impl<'a> Clip<'a> {
    pub(super) fn new(log: &'a Recording, frames: Range<usize>, name: &str) -> Self {
        let frames = log.frames.get(frames).unwrap_or_default();
        let origin = Frame::origin_of(frames).map_or(Pose::IDENTITY, |frame| frame.global_from_ego);
        Self { log, frames, name: name.to_owned(), clip_from_global: origin.inverse() }
    }

    /// Returns the tables; the map's only if they have rows.
    pub(super) fn tables(&self, map: Option<&VectorMap>) -> Vec<Table> {
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

    /// The ego's poses at frames and sweeps.
    fn egomotion(&self) -> Table {
        let track = EgoTrack::new(self.log);
        let ends = self.frames.first().zip(self.frames.last()).map(|(a, b)| a.t_us..=b.t_us);
        let mut poses: Vec<(i64, Pose)> = track
            .poses()
            .iter()
            .filter(|(t, _)| ends.as_ref().is_some_and(|e| e.contains(t)))
            .copied()
            .collect();
        poses.dedup_by_key(|(t_us, _)| *t_us);
        for (_, pose) in &mut poses {
            *pose = self.clip_from_global * *pose;
        }
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
        let rings = |areas: &[point_skeleton::dataset::Area]| -> Vec<Vec<DVec2>> {
            areas
                .iter()
                .flat_map(|area| std::iter::once(&area.exterior).chain(&area.holes))
                .map(|ring| closed(ring))
                .collect()
        };
        let exteriors = |areas: &[point_skeleton::dataset::Area]| -> Vec<Vec<DVec2>> {
            areas.iter().map(|area| area.exterior.clone()).collect()
        };
        let categorized =
            |kind: &'static str, category: &str, lines: Vec<Vec<DVec2>>, more: Vec<(String, Column)>| {
                let rows = lines.len();
                let categories = Column::Text(vec![category.to_owned(); rows]);
                let mut columns = self.map_key(rows);
                columns.push(categories);
                columns.extend(self.rail(&lines));
                let fields = format!("{} {}", text("category"), points("location"));
                let fields = more.iter().fold(fields, |fields, (field, _)| format!("{fields} {field}"));
                columns.extend(more.into_iter().map(|(_, column)| column));
                columns.push(Column::Int(vec![VERSION; rows]));
                table(kind, &map_key(), &fields, columns)
            };
        let mut tables = Vec::new();
        let dividers = self.near(map.dividers.clone());
        if !dividers.is_empty() {
            tables.push(self.lane_lines(&dividers));
        }
        let boundaries = self.near(rings(&map.drivable_area));
        let crossings = self.near(exteriors(&map.crossings));
        let stops = self.near(exteriors(&map.stop_lines).iter().map(|ring| closed(ring)).collect());
        let implicit = (flag("is_implicit"), Column::Bool(vec![false; stops.len()]));
        let subtype = (text("intersection_subtype"), Column::Text(vec!["UNKNOWN".to_owned(); stops.len()]));
        for (kind, category, lines, more) in [
            ("road_boundary", "road_boundary", boundaries, Vec::new()),
            ("crosswalk", "PEDESTRIAN", crossings, Vec::new()),
            ("wait_line", "STOP", stops, vec![implicit, subtype]),
        ] {
            if !lines.is_empty() {
                tables.push(categorized(kind, category, lines, more));
            }
        }
        tables
    }

    fn lane_lines(&self, lines: &[Vec<DVec2>]) -> Table {
        let each = |value: &str| {
            Column::Texts(lines.iter().map(|line| vec![value.to_owned(); line.len()]).collect())
        };
        let mut columns = self.map_key(lines.len());
        columns.extend(self.rail(lines));
        columns.extend([each("SOLID_SINGLE"), each("WHITE"), Column::Int(vec![VERSION; lines.len()])]);
        let fields = format!("{} {} {}", points("line_rail"), texts("styles"), texts("colors"));
        table("lane_line", &map_key(), &fields, columns)
    }

    fn clip_ids(&self, rows: usize) -> Column {
        Column::Text(vec![self.name.clone(); rows])
    }

    fn map_key(&self, rows: usize) -> Vec<Column> {
        let same = |value: &str| Column::Text(vec![value.to_owned(); rows]);
        vec![same(&self.name), same(&self.log.name), same(&self.log.location), same("1")]
    }

    /// Returns the lines with a point near the ego's path.
    fn near(&self, lines: Vec<Vec<DVec2>>) -> Vec<Vec<DVec2>> {
        let path: Vec<DVec2> = self.frames.iter().map(|f| f.global_from_ego.translation.truncate()).collect();
        let is_near = |at: &DVec2| path.iter().any(|ego| ego.distance(*at) < AROUND_M);
        lines.into_iter().filter(|line| line.iter().any(is_near)).collect()
    }

    /// Returns points of lines in coordinates of the clip, at the height of the nearest ego pose.
    fn rail(&self, lines: &[Vec<DVec2>]) -> [Column; 3] {
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
fn category(category: &str) -> &'static str {
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

fn vector(values: impl Iterator<Item = DVec3> + Clone) -> [Column; 3] {
    std::array::from_fn(|axis| Column::Number(values.clone().map(|v| v[axis]).collect()))
}

fn quaternion(values: impl Iterator<Item = DQuat> + Clone) -> [Column; 4] {
    std::array::from_fn(|axis| Column::Number(values.clone().map(|q| q.to_array()[axis]).collect()))
}

fn table(kind: &'static str, key: &str, fields: &str, columns: Vec<Column>) -> Table {
    let version = "required int64 version (INTEGER(64,false));";
    let schema = format!(
        "message table {{ required group key {{ {key} }} required group {kind} {{ {fields} }} {version} }}"
    );
    Table { kind, schema, columns }
}

fn time_key() -> String {
    format!("{} required int64 timestamp_micros;", text("clip_id"))
}

fn map_key() -> String {
    ["clip_id", "label_class_id", "map_id", "map_id_version"].map(text).join(" ")
}

fn text(name: &str) -> String {
    format!("required binary {name} (STRING);")
}

fn flag(name: &str) -> String {
    format!("required boolean {name};")
}

fn xyz(name: &str) -> String {
    format!("required group {name} {{ required double x; required double y; required double z; }}")
}

fn xyzw(name: &str) -> String {
    format!(
        "required group {name} {{ required double x; required double y; required double z; required double \
            w; }}"
    )
}

fn points(name: &str) -> String {
    format!("required group {name} (LIST) {{ repeated group list {{ {} }} }}", xyz("element"))
}

fn texts(name: &str) -> String {
    format!("required group {name} (LIST) {{ repeated group list {{ {} }} }}", text("element"))
}
