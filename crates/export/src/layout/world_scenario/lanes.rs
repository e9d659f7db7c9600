//! Lanes and their relations, for the map loader of AlpaSim: beside the tables of a clip it expects `lane`,
//! `association`, `clip` and `traffic_sign`, and all of `road_boundary` and `wait_line`.

use std::collections::BTreeMap;

use glam::DVec2;
use point_skeleton::dataset::{Lane, VectorMap};

use super::parquet::Column;
use super::rails::rails;
use super::tables::{Clip, Table, VERSION, map_key, points, table, text, texts, xyz, xyzw};

/// A lane near the ego's path.
struct Row<'a> {
    id: String,
    lane: &'a Lane,
    /// Left and right border.
    rails: [Vec<DVec2>; 2],
}

impl Clip<'_> {
    /// Returns the tables of the clip with those of lanes. Without lanes, [`tables`](Self::tables).
    pub(in crate::layout) fn tables_with_lanes(&self, map: &VectorMap) -> Vec<Table> {
        let mut tables = self.tables(Some(map));
        let rows = self.lanes(map);
        if !rows.is_empty() {
            tables.retain(|table| !matches!(table.kind, "road_boundary" | "wait_line"));
            tables.extend([
                self.lane(&rows),
                self.association(&rows),
                self.clip(),
                self.traffic_sign(),
                self.road_boundaries(map),
                self.wait_lines_of_lanes(map, &rows),
            ]);
        }
        tables
    }

    /// Returns the lanes and connectors with centerlines that are near the ego's path.
    fn lanes<'m>(&self, map: &'m VectorMap) -> Vec<Row<'m>> {
        let lanes = map.lanes.iter().chain(&map.lane_connectors);
        let near = lanes.filter(|lane| self.is_near(&lane.centerline));
        near.filter_map(|lane| Some(Row { id: id(&lane.id), lane, rails: rails(lane)? })).collect()
    }

    fn lane(&self, rows: &[Row<'_>]) -> Table {
        let mut columns = self.map_key(rows.iter().map(|row| row.id.clone()).collect());
        for side in 0..2 {
            let lines: Vec<Vec<DVec2>> = rows.iter().map(|row| row.rails[side].clone()).collect();
            columns.extend(self.rail(&lines));
        }
        // Data sets do not tell what is painted on a border.
        for value in ["VIRTUAL", "VIRTUAL", "UNKNOWN", "UNKNOWN"] {
            let values = rows.iter().map(|row| vec![value.to_owned(); row.rails[0].len()]);
            columns.push(Column::Texts(values.collect()));
        }
        columns.push(Column::Int(vec![VERSION; rows.len()]));
        let rails = ["left_rail", "right_rail"].map(points).join(" ");
        let edges = ["left_edge_styles", "right_edge_styles", "left_edge_colors", "right_edge_colors"];
        table("lane", &map_key(), &format!("{rails} {}", edges.map(texts).join(" ")), columns)
    }

    /// Returns the lanes after and before each lane. Lanes that are not near the path are left out.
    fn association(&self, rows: &[Row<'_>]) -> Table {
        let mut next: BTreeMap<&str, Vec<String>> =
            rows.iter().map(|row| (row.id.as_str(), Vec::new())).collect();
        let mut previous = next.clone();
        for row in rows {
            for after in row.lane.successors.iter().map(|successor| id(successor)) {
                if let Some(before) = previous.get_mut(after.as_str()) {
                    before.push(row.id.clone());
                    next.entry(&row.id).or_default().push(after);
                }
            }
        }
        let kinds = [("NEXT_LANE", next), ("PREVIOUS_LANE", previous)];
        let relations =
            || kinds.iter().flat_map(|(kind, of)| of.iter().map(move |(id, to)| (*kind, *id, to)));
        let rows = relations().count();
        let columns = vec![
            self.clip_ids(rows),
            Column::Text(vec![self.log.name.clone(); rows]),
            Column::Text(relations().map(|(kind, id, _)| format!("{kind}-{id}")).collect()),
            Column::Text(relations().map(|(kind, ..)| kind.to_owned()).collect()),
            Column::Texts(relations().map(|(_, id, _)| vec![id.to_owned()]).collect()),
            Column::Texts(relations().map(|(_, _, to)| to.clone()).collect()),
            Column::Int(vec![VERSION; rows]),
        ];
        let key = ["clip_id", "label_class_id", "map_id", "kind"].map(text).join(" ");
        table("association", &key, &["subjects", "objects"].map(texts).join(" "), columns)
    }

    fn clip(&self) -> Table {
        let name = || Column::Text(vec![self.log.name.clone()]);
        let columns = vec![self.clip_ids(1), name(), name(), Column::Int(vec![VERSION])];
        let key = ["clip_id", "label_class_id"].map(text).join(" ");
        table("clip", &key, &text("name"), columns)
    }

    /// Returns an empty table: maps of data sets have no traffic signs.
    fn traffic_sign(&self) -> Table {
        let mut columns = self.map_key(Vec::new());
        columns.extend((0..10).map(|_| Column::Number(Vec::new())));
        columns.extend([Column::Text(Vec::new()), Column::Int(Vec::new())]);
        let fields = [xyz("center"), xyz("dimensions"), xyzw("orientation"), text("category")];
        table("traffic_sign", &map_key(), &fields.join(" "), columns)
    }

    /// Returns the stop lines, once for each lane that crosses one: their ids are `LINE-LANE`.
    fn wait_lines_of_lanes(&self, map: &VectorMap, rows: &[Row<'_>]) -> Table {
        let mut lines = Vec::new();
        for (number, stop) in self.stop_lines(map).into_iter().enumerate() {
            let crossing = rows.iter().filter(|row| crosses(&row.lane.centerline, &stop));
            let mut lanes: Vec<&str> = crossing.map(|row| row.id.as_str()).collect();
            if lanes.is_empty() {
                lanes.push("");
            }
            lines.extend(lanes.into_iter().map(|lane| (format!("{number}-{lane}"), stop.clone())));
        }
        let is_empty = lines.is_empty();
        let mut table = self.wait_lines(lines);
        if is_empty {
            // The loader finds no fields in a structure without rows, but needs these two columns.
            let flat = format!("{} {} }}", text("key.clip_id"), text("key.map_id"));
            table.schema = table.schema.trim_end_matches('}').to_owned() + &flat;
            table.columns.extend([Column::Text(Vec::new()), Column::Text(Vec::new())]);
        }
        table
    }
}

/// Returns the id of a lane in the tables. The loader divides the ids of stop lines at hyphens.
fn id(lane: &str) -> String {
    lane.replace('-', "_")
}

/// Returns whether two lines cross.
fn crosses(line: &[DVec2], other: &[DVec2]) -> bool {
    line.windows(2).any(|a| other.windows(2).any(|b| do_cross([a[0], a[1]], [b[0], b[1]])))
}

fn do_cross([a, b]: [DVec2; 2], [c, d]: [DVec2; 2]) -> bool {
    let side = |from: DVec2, to: DVec2, point: DVec2| (to - from).perp_dot(point - from) > 0.0;
    side(a, b, c) != side(a, b, d) && side(c, d, a) != side(c, d, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_cross_within_both() {
        let at = DVec2::new;
        let line = [at(0.0, 0.0), at(10.0, 0.0), at(20.0, 5.0)];
        assert!(crosses(&line, &[at(15.0, -5.0), at(15.0, 5.0)]));
        assert!(!crosses(&line, &[at(15.0, -5.0), at(15.0, 1.0)]));
        assert!(!crosses(&line, &[at(25.0, -5.0), at(25.0, 50.0)]));
        assert!(!crosses(&[], &line));
    }
}
