//! Export of a map in nuScenes' formats: the map expansion, and an image of the drivable and walkable areas.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec2;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use serde_json::{Map, Value, json};
use tiny_skia::{FillRule, Mask, PathBuilder, Transform};

use super::map::arcline::straight_paths;
use crate::dataset::{Area, Lane, VectorMap};
use crate::error::FileError;
use crate::files::FileName;
use crate::files::{write_json, write_whole};

/// Layers of the map expansion beyond a [`VectorMap`], global meters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapLayers {
    /// Number of leading [`VectorMap::dividers`] that separate directions; the others separate lanes of one
    /// direction.
    pub road_dividers: usize,
    /// Sidewalks.
    pub walkways: Vec<Area>,
    /// Parking strips.
    pub carparks: Vec<Area>,
    /// Roads between intersections, and intersections.
    pub road_segments: Vec<RoadSegment>,
    /// Areas that hold all lanes of a road in one direction.
    pub road_blocks: Vec<Area>,
}

/// Segment of a road.
#[derive(Clone, Debug, PartialEq)]
pub struct RoadSegment {
    /// Area of the segment.
    pub area: Area,
    /// Whether it is an intersection.
    pub is_intersection: bool,
}

/// Pixel size of the map image, meters, as expected by the development kit.
const PIXEL_M: f64 = 0.1;
/// Margin beyond the largest x and y, meters.
const EDGE_M: f64 = 20.0;
/// Maximum side of the map image, meters; the largest of nuScenes' own is 3.7 km.
const MAX_SIDE_M: f64 = 4000.0;

/// Returns the path of a location's map image within a dataset.
pub(super) fn picture_name(location: &str) -> String {
    format!("maps/{location}.png")
}

/// Writes `maps/expansion/LOCATION.json` (version 1.3) and `maps/LOCATION.png` (white where one may drive or
/// walk) below a folder. Reading the expansion yields the same map, except that centerlines become straight
/// pieces within 2 mm of their points.
///
/// # Errors
/// Fails if areas have coordinates below 0 or the image with its margin would exceed 4 km. Fails if the
/// location is not a valid file name or a file cannot be written.
pub fn write_map(root: &Path, map: &VectorMap, layers: &MapLayers) -> Result<(), FileError> {
    let location = &map.location;
    let location = &FileName::new(location).map_err(|error| error.of("location of the map").in_file(root))?;
    let path = root.join("maps/expansion").join(format!("{location}.json"));
    let size_m = canvas_m(map, layers, &path)?;
    let folder = root.join("maps/expansion");
    std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
    write_json(&path, &Layers::default().all(map, layers, size_m))?;
    write_picture(&root.join(picture_name(location)), map, layers, size_m)
}

/// Returns the width and height that cover all drivable areas and walkways with a margin, meters.
fn canvas_m(map: &VectorMap, layers: &MapLayers, path: &Path) -> Result<DVec2, FileError> {
    let areas = map.drivable_area.iter().chain(&layers.walkways);
    let (mut min, mut max) = (DVec2::ZERO, DVec2::ZERO);
    for corner in areas.flat_map(|area| &area.exterior) {
        (min, max) = (min.min(*corner), max.max(*corner));
    }
    let size_m = (max + EDGE_M).ceil();
    let fits = min.cmpge(DVec2::ZERO).all() && size_m.max_element() <= MAX_SIDE_M;
    if !fits {
        let expected = format!("a map within 0 and {MAX_SIDE_M} m");
        return Err(FileError::content(expected, format!("one from {min} to {max}"), path));
    }
    Ok(size_m)
}

/// Geometry layers under construction.
#[derive(Default)]
struct Layers {
    nodes: Vec<Value>,
    lines: Vec<Value>,
    polygons: Vec<Value>,
}

impl Layers {
    fn all(mut self, map: &VectorMap, extra: &MapLayers, size_m: DVec2) -> Value {
        let mut layers = Map::new();
        let mut put = |name: &str, records: Vec<Value>| {
            layers.insert(name.to_owned(), records.into());
        };
        let drivable: Vec<Value> = map.drivable_area.iter().map(|area| self.polygon(area)).collect();
        put("drivable_area", vec![json!({"token": "drivable_area-0", "polygon_tokens": drivable})]);
        let lane = |layers: &mut Self, lane: &Lane| {
            json!({
                "token": lane.id, "polygon_token": layers.polygon(&lane.outline), "lane_type": "CAR",
                "from_edge_line_token": "", "to_edge_line_token": "",
                "left_lane_divider_segments": [], "right_lane_divider_segments": [],
            })
        };
        put("lane", map.lanes.iter().map(|l| lane(&mut self, l)).collect());
        let connector = |layers: &mut Self, lane: &Lane| {
            json!({"token": lane.id,
            "polygon_token": layers.polygon(&lane.outline)})
        };
        put("lane_connector", map.lane_connectors.iter().map(|l| connector(&mut self, l)).collect());
        put("ped_crossing", self.areas("ped_crossing", &map.crossings, json!({"road_segment_token": ""})));
        let stop = json!({
            "stop_line_type": "TURN_STOP", "ped_crossing_tokens": [], "traffic_light_tokens": [],
            "road_block_token": "",
        });
        put("stop_line", self.areas("stop_line", &map.stop_lines, stop));
        put("walkway", self.areas("walkway", &extra.walkways, json!({})));
        let carpark = json!({"orientation": 0.0, "road_block_token": ""});
        put("carpark_area", self.areas("carpark_area", &extra.carparks, carpark));
        let block = json!({"from_edge_line_token": "", "to_edge_line_token": "", "road_segment_token": ""});
        put("road_block", self.areas("road_block", &extra.road_blocks, block));
        put("road_segment", self.segments(&extra.road_segments));
        let (roads, lanes) = map.dividers.split_at(extra.road_dividers.min(map.dividers.len()));
        put("road_divider", self.dividers("road_divider", roads));
        put("lane_divider", self.dividers("lane_divider", lanes));
        put("traffic_light", Vec::new());
        put("node", self.nodes);
        put("line", self.lines);
        put("polygon", self.polygons);
        layers.insert("arcline_path_3".to_owned(), paths(map));
        layers.insert("connectivity".to_owned(), connectivity(map));
        layers.insert("canvas_edge".to_owned(), json!(size_m.to_array()));
        layers.insert("version".to_owned(), json!("1.3"));
        layers.into()
    }

    /// Creates records with one polygon each, plus fields with the same value for all.
    fn areas(&mut self, layer: &str, areas: &[Area], fields: Value) -> Vec<Value> {
        let record = |(i, area): (usize, &Area)| {
            let mut record = fields.clone();
            record["token"] = json!(format!("{layer}-{i}"));
            record["polygon_token"] = self.polygon(area);
            record
        };
        areas.iter().enumerate().map(record).collect()
    }

    fn segments(&mut self, segments: &[RoadSegment]) -> Vec<Value> {
        let record = |(i, segment): (usize, &RoadSegment)| {
            json!({
                "token": format!("road_segment-{i}"), "polygon_token": self.polygon(&segment.area),
                "is_intersection": segment.is_intersection, "drivable_area_token": "drivable_area-0",
            })
        };
        segments.iter().enumerate().map(record).collect()
    }

    fn dividers(&mut self, layer: &str, lines: &[Vec<DVec2>]) -> Vec<Value> {
        let record = |(i, line): (usize, &Vec<DVec2>)| {
            let nodes = self.ring(line);
            let segments: Vec<Value> = nodes
                .iter()
                .map(|node| json!({"node_token": node, "segment_type": "SINGLE_SOLID_WHITE"}))
                .collect();
            let token = format!("line-{}", self.lines.len());
            self.lines.push(json!({"token": token, "node_tokens": nodes}));
            json!({
                "token": format!("{layer}-{i}"), "line_token": token, "road_segment_token": "",
                "lane_divider_segments": segments,
            })
        };
        lines.iter().enumerate().map(record).collect()
    }

    /// Adds an area and returns its token.
    fn polygon(&mut self, area: &Area) -> Value {
        let exterior = self.ring(&area.exterior);
        let holes: Vec<Value> =
            area.holes.iter().map(|hole| json!({"node_tokens": self.ring(hole)})).collect();
        let token = format!("polygon-{}", self.polygons.len());
        self.polygons.push(json!({"token": token, "exterior_node_tokens": exterior, "holes": holes}));
        token.into()
    }

    /// Adds corners and returns their tokens.
    fn ring(&mut self, corners: &[DVec2]) -> Vec<Value> {
        let node = |corner: &DVec2| {
            let token = format!("node-{}", self.nodes.len());
            self.nodes.push(json!({"token": token, "x": corner.x, "y": corner.y}));
            token.into()
        };
        corners.iter().map(node).collect()
    }
}

fn all_lanes(map: &VectorMap) -> impl Iterator<Item = &Lane> {
    map.lanes.iter().chain(&map.lane_connectors)
}

fn paths(map: &VectorMap) -> Value {
    all_lanes(map)
        .map(|lane| (lane.id.clone(), json!(straight_paths(&lane.centerline))))
        .collect::<Map<_, _>>()
        .into()
}

fn connectivity(map: &VectorMap) -> Value {
    let mut incoming: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for lane in all_lanes(map) {
        lane.successors.iter().for_each(|next| incoming.entry(next).or_default().push(&lane.id));
    }
    let entry = |lane: &Lane| {
        let before = incoming.get(lane.id.as_str());
        (
            lane.id.clone(),
            json!({"incoming": before.cloned().unwrap_or_default(), "outgoing": lane.successors}),
        )
    };
    all_lanes(map).map(entry).collect::<Map<_, _>>().into()
}

/// Writes the map image, white where one may drive or walk. The lower left corner is the origin.
fn write_picture(path: &Path, map: &VectorMap, layers: &MapLayers, size_m: DVec2) -> Result<(), FileError> {
    let [width, height] = (size_m / PIXEL_M).round().to_array().map(|side| side as u32);
    let too_large = || FileError::content("a map that a picture can hold", format!("{size_m} m"), path);
    let mut mask = Mask::new(width, height).ok_or_else(too_large)?;
    for area in map.drivable_area.iter().chain(&layers.walkways) {
        let mut builder = PathBuilder::new();
        for ring in std::iter::once(&area.exterior).chain(&area.holes) {
            let mut corners =
                ring.iter().map(|c| [c.x / PIXEL_M, f64::from(height) - c.y / PIXEL_M].map(|v| v as f32));
            let Some([x, y]) = corners.next() else { continue };
            builder.move_to(x, y);
            corners.for_each(|[x, y]| builder.line_to(x, y));
            builder.close();
        }
        if let Some(outline) = builder.finish() {
            mask.fill_path(&outline, FillRule::EvenOdd, false, Transform::identity());
        }
    }
    write_whole(path, |out| {
        let encoded = PngEncoder::new(out).write_image(mask.data(), width, height, ExtendedColorType::L8);
        encoded.map_err(|e| FileError::io("write", path)(std::io::Error::other(e)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::nuscenes::read_map_file;

    fn area(corners: [[f64; 2]; 4]) -> Area {
        Area { exterior: corners.map(DVec2::from).to_vec(), holes: Vec::new() }
    }

    fn map() -> VectorMap {
        // A bend of radius 20 about (40, 30).
        let bend = |i: i32| DVec2::new(40.0, 30.0) + DVec2::from_angle(f64::from(i) * 0.05) * 20.0;
        let lane = |id: &str, next: &[&str]| Lane {
            id: id.into(),
            outline: area([[1.0, 2.0], [60.0, 2.25], [60.0, 50.0], [1.0, 50.0]]),
            centerline: (0..=30).map(bend).collect(),
            successors: next.iter().map(|n| (*n).to_owned()).collect(),
        };
        let mut drivable = area([[0.0, 0.0], [80.0, 0.0], [80.0, 60.0], [0.0, 60.0]]);
        drivable.holes.push(vec![DVec2::new(10.0, 10.0), DVec2::new(20.0, 10.0), DVec2::new(20.0, 30.0)]);
        VectorMap {
            location: "place".into(),
            lanes: vec![lane("a", &["c", "beyond"]), lane("b", &[])],
            lane_connectors: vec![lane("c", &["b"])],
            drivable_area: vec![drivable],
            crossings: vec![area([[1.0, 1.0], [4.0, 1.0], [4.0, 9.0], [1.0, 9.0]])],
            stop_lines: vec![area([[5.0, 1.0], [5.5, 1.0], [5.5, 4.0], [5.0, 4.0]])],
            walkways: Vec::new(),
            dividers: vec![vec![DVec2::ZERO, DVec2::new(80.0, 60.0)], vec![DVec2::X, DVec2::new(30.1, 7.7)]],
            network: None,
            notes: BTreeMap::new(),
        }
    }

    fn layers() -> MapLayers {
        let walkway = area([[0.0, 70.0], [80.0, 70.0], [80.0, 75.0], [0.0, 75.0]]);
        MapLayers { road_dividers: 1, walkways: vec![walkway], ..MapLayers::default() }
    }

    #[test]
    fn a_written_map_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        write_map(folder.path(), &map(), &layers()).unwrap();
        let mut read = read_map_file(&folder.path().join("maps/expansion/place.json"), "place").unwrap();
        let mut wrote = map();
        for (read, wrote) in read
            .lanes
            .iter_mut()
            .chain(&mut read.lane_connectors)
            .zip(wrote.lanes.iter_mut().chain(&mut wrote.lane_connectors))
        {
            let (read, wrote) = (std::mem::take(&mut read.centerline), std::mem::take(&mut wrote.centerline));
            let off = |p: &DVec2, line: &[DVec2]| {
                let to_piece = |w: &[DVec2]| {
                    let s = ((*p - w[0]).dot(w[1] - w[0]) / (w[1] - w[0]).length_squared()).clamp(0.0, 1.0);
                    p.distance(w[0].lerp(w[1], s))
                };
                line.windows(2).map(to_piece).fold(f64::INFINITY, f64::min)
            };
            assert!(read.iter().all(|p| off(p, &wrote) < 0.01) && wrote.iter().all(|p| off(p, &read) < 0.01));
            assert!(read[0].distance(wrote[0]) < 1e-9 && read.last().unwrap().distance(wrote[30]) < 1e-9);
        }
        assert_eq!(read, wrote);
    }

    #[test]
    fn the_picture_is_white_where_driving_or_walking_is_allowed() {
        let folder = tempfile::tempdir().unwrap();
        write_map(folder.path(), &map(), &layers()).unwrap();
        let picture = image::open(folder.path().join("maps/place.png")).unwrap().into_luma8();
        assert_eq!(picture.dimensions(), (1000, 950)); // 80 + 20 m, 75 + 20 m
        let at = |x: f64, y: f64| picture.get_pixel((x * 10.0) as u32, 949 - (y * 10.0) as u32).0[0];
        assert_eq!([at(5.05, 5.05), at(79.85, 59.85), at(40.05, 72.05)], [255; 3]);
        assert_eq!([at(18.05, 15.05), at(40.05, 65.05), at(80.25, 5.05), at(40.05, 76.05)], [0; 4]);
    }

    #[test]
    fn rejects_maps_that_no_picture_can_show() {
        let folder = tempfile::tempdir().unwrap();
        let write = |map: &VectorMap| write_map(folder.path(), map, &layers()).unwrap_err().to_string();
        let mut far = map();
        far.drivable_area[0].exterior[2].x = 5000.0;
        assert!(
            write(&far).starts_with("expected a map within 0 and 4000 m, found one from"),
            "{}",
            write(&far)
        );
        far.drivable_area[0].exterior[2].x = -1.0;
        assert!(write(&far).contains("[-1, 0]"), "{}", write(&far));
        assert!(write(&VectorMap { location: "../out".into(), ..map() }).contains("a name without /"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
