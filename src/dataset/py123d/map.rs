//! Maps: one row per object, in a table of the log or of a place.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec2;
use serde::Deserialize;

use super::choose::maps_beside;
use super::metadata::{self, LogMetadata};
use crate::dataset::recording::degenerate::{self, Unreadable, note_fault};
use crate::dataset::recording::notes::{Counts, count};
use crate::dataset::tables::ArrowFile;
use crate::dataset::wkb::{Shape, decode_wkb};
use crate::dataset::{Area, DatasetError, Lane, LogLocator, VectorMap};
use crate::error::FileError;
use crate::files::FileName;
use crate::files::input::is_there;

/// Layers by number.
const LANE: i64 = 0;
const LANE_GROUP: i64 = 1;
const INTERSECTION: i64 = 2;
const CROSSWALK: i64 = 3;
const WALKWAY: i64 = 4;
const CAR_PARK: i64 = 5;
const DRIVABLE: i64 = 6;
const STOP_ZONE: i64 = 7;
const ROAD_EDGE: i64 = 8;
const ROAD_LINE: i64 = 9;

/// Names of the layers, for messages.
const NAMES: [&str; 11] = [
    "lanes",
    "lane groups",
    "intersections",
    "crosswalks",
    "walkways",
    "car parks",
    "generic drivable areas",
    "stop zones",
    "road edges",
    "road lines",
    "speed bumps",
];

/// Returns the file of a log's map: that of the log, or that of its place. `None` if there is none.
///
/// # Errors
/// Fails if a folder of maps is given and has no map of the place.
pub(super) fn find(locator: &LogLocator, about: &LogMetadata) -> Result<Option<PathBuf>, DatasetError> {
    let own = locator.path.join("map.arrow");
    if is_there(&own)? {
        return Ok(Some(own));
    }
    let folder = locator.map_root.clone().or_else(|| maps_beside(&locator.path));
    let (Some(folder), Some(location)) = (folder, &about.location) else { return Ok(None) };
    let name = |text: &str| {
        let wrong = |error: crate::files::NameError| {
            FileError::content(error.expected, error.found, &locator.path.join(super::choose::SYNC))
        };
        FileName::new(text).map_err(wrong)
    };
    let dataset = name(&about.dataset)?;
    let path = folder.join(&*dataset).join(format!("{dataset}_{}.arrow", name(location)?));
    match is_there(&path)? {
        true => Ok(Some(path)),
        false if locator.map_root.is_some() => {
            Err(FileError::content("a map of the place", "none", &path).into())
        }
        false => Ok(None),
    }
}

/// Reads a map.
///
/// # Errors
/// Fails if the table is damaged, or no object of a layer can be read.
pub(super) fn read(path: &Path, location: &str, dataset: &str) -> Result<VectorMap, DatasetError> {
    let file = ArrowFile::open(path)?;
    let mut objects = Objects { layers: BTreeMap::new(), notes: Counts::new(), path };
    for batch in 0..file.batches() {
        let table = file.batch(batch, &["object_id", "map_layer", "features", "wkb"], &[])?;
        let (ids, layers) = (table.column("object_id")?.integers()?, table.column("map_layer")?.integers()?);
        let (features, shapes) = (table.column("features")?, table.column("wkb")?);
        for (row, (id, layer)) in ids.into_iter().zip(layers).enumerate() {
            objects.add(id, layer, features.bytes(row)?, shapes.bytes(row)?);
        }
    }
    objects.map(location, dataset)
}

/// Object of a layer.
struct Object {
    id: i64,
    shape: Shape,
    features: Features,
}

/// What is read of the features of lanes and groups of lanes; other layers have none of these.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Features {
    lane_group_id: Option<i64>,
    intersection_id: Option<i64>,
    centerline: Option<Points>,
    successor_ids: Option<Vec<i64>>,
}

/// Points of a NumPy array.
struct Points(Vec<DVec2>);

/// NumPy array as msgpack-numpy writes it, with keys that are bytes.
#[derive(Deserialize)]
struct Array<'a> {
    dtype: String,
    shape: [usize; 2],
    data: &'a [u8],
}

impl<'de> Deserialize<'de> for Points {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Array { dtype, shape: [count, width], data } = Array::deserialize(deserializer)?;
        let (numbers, rest) = data.as_chunks::<8>();
        let fits = width >= 2 && count.checked_mul(width) == Some(numbers.len()) && rest.is_empty();
        if dtype != "<f8" || !fits {
            let found = format!("an array of {count}x{width} {dtype} in {} bytes", data.len());
            return Err(serde::de::Error::custom(found));
        }
        let point = |row: &[[u8; 8]]| DVec2::new(f64::from_le_bytes(row[0]), f64::from_le_bytes(row[1]));
        Ok(Self(numbers.chunks_exact(width).map(point).collect()))
    }
}

struct Objects<'a> {
    layers: BTreeMap<i64, Layer>,
    notes: Counts,
    path: &'a Path,
}

#[derive(Default)]
struct Layer {
    objects: Vec<Object>,
    unreadable: Unreadable<String>,
}

impl Objects<'_> {
    /// Adds a row. Objects without an area or a length are counted, and those that cannot be read.
    fn add(&mut self, id: i64, layer: i64, features: Option<&[u8]>, wkb: Option<&[u8]>) {
        let Some(name) = usize::try_from(layer).ok().and_then(|layer| NAMES.get(layer)) else {
            count(&mut self.notes, &format!("map objects of the unknown layer {layer} (not read)"), 1);
            return;
        };
        let mut faults = Vec::new();
        let shape = decode_wkb(wkb.unwrap_or_default(), &mut faults);
        faults.into_iter().for_each(|fault| note_fault(&mut self.notes, name, fault));
        let features = features.filter(|_| [LANE, LANE_GROUP].contains(&layer));
        let features = features.map_or_else(|| Ok(Features::default()), metadata::decode);
        let found = self.layers.entry(layer).or_default();
        match (shape, features) {
            (Ok(Some(shape)), Ok(features)) => found.objects.push(Object { id, shape, features }),
            (Ok(None), _) => {}
            (Err(error), _) | (_, Err(error)) => {
                found.unreadable.add(|| format!("object {id} of {name}: {error}"))
            }
        }
    }

    /// Converts the map.
    fn map(mut self, location: &str, dataset: &str) -> Result<VectorMap, DatasetError> {
        for (layer, found) in &mut self.layers {
            let unreadable = std::mem::take(&mut found.unreadable);
            let noted = unreadable.note(NAMES[*layer as usize], found.objects.len(), &mut self.notes);
            noted.map_err(|found| FileError::content("a map of py123d", found, self.path))?;
        }
        let intersections = self.group_intersections();
        let (mut lanes, mut lane_connectors) = (Vec::new(), Vec::new());
        for lane in self.take(LANE) {
            let group = lane.features.lane_group_id.and_then(|group| intersections.get(&group));
            let of = if group.is_some_and(Option::is_some) { &mut lane_connectors } else { &mut lanes };
            of.extend(self.lane(lane));
        }
        let has_generic = self.layers.get(&DRIVABLE).is_some_and(|layer| !layer.objects.is_empty());
        // Generic areas of OpenDRIVE (CARLA) and nuPlan lack roads and intersections.
        let of_lanes = !has_generic || ["opendrive", "griffin"].contains(&dataset);
        let drivable: &[i64] = match dataset {
            "nuplan" => &[LANE_GROUP, INTERSECTION, DRIVABLE, CAR_PARK],
            _ if of_lanes => &[INTERSECTION, DRIVABLE, CAR_PARK],
            _ => &[DRIVABLE],
        };
        let mut drivable_area = Vec::new();
        if of_lanes {
            let lanes = lanes.iter().chain(&lane_connectors);
            drivable_area.extend(lanes.map(|lane: &Lane| lane.outline.clone()));
        }
        for layer in drivable.iter().copied() {
            let outside = |object: &Object| layer != LANE_GROUP || object.features.intersection_id.is_none();
            let objects = self.take(layer).into_iter().filter(outside).collect();
            drivable_area.extend(self.areas(layer, objects));
        }
        let [crossings, stop_lines, walkways] = [CROSSWALK, STOP_ZONE, WALKWAY].map(|layer| {
            let objects = self.take(layer);
            self.areas(layer, objects)
        });
        let objects = self.take(ROAD_LINE);
        let dividers = self.lines(ROAD_LINE, objects);
        for layer in [ROAD_EDGE, 10] {
            let unused = self.take(layer).len();
            count(&mut self.notes, &format!("{} (not drawn)", NAMES[layer as usize]), unused);
        }
        let (location, notes) = (location.to_owned(), self.notes);
        Ok(VectorMap {
            location,
            lanes,
            lane_connectors,
            drivable_area,
            crossings,
            stop_lines,
            walkways,
            dividers,
            network: None,
            notes,
        })
    }

    /// Returns the intersection of each lane group.
    fn group_intersections(&self) -> BTreeMap<i64, Option<i64>> {
        let groups = self.layers.get(&LANE_GROUP).into_iter().flat_map(|layer| &layer.objects);
        groups.map(|group| (group.id, group.features.intersection_id)).collect()
    }

    fn take(&mut self, layer: i64) -> Vec<Object> {
        self.layers.remove(&layer).unwrap_or_default().objects
    }

    /// Converts a lane; `None` if it is not one area, which is counted.
    fn lane(&mut self, object: Object) -> Option<Lane> {
        let Object { id, shape, features } = object;
        let outline = self.areas(LANE, vec![Object { id, shape, features: Features::default() }]).pop()?;
        let centerline = features.centerline.map(|points| degenerate::line(points.0)).transpose();
        let centerline = centerline.unwrap_or_else(|fault| {
            note_fault(&mut self.notes, "centerlines", fault);
            None
        });
        let successors = features.successor_ids.unwrap_or_default();
        let successors = successors.iter().map(i64::to_string).collect();
        Some(Lane { id: id.to_string(), outline, centerline: centerline.unwrap_or_default(), successors })
    }

    fn areas(&mut self, layer: i64, objects: Vec<Object>) -> Vec<Area> {
        let mut all = Vec::new();
        for object in objects {
            match object.shape {
                Shape::Areas(areas) => all.extend(areas),
                Shape::Lines(_) => self.note_kind(layer, "lines"),
            }
        }
        all
    }

    fn lines(&mut self, layer: i64, objects: Vec<Object>) -> Vec<Vec<DVec2>> {
        let mut all = Vec::new();
        for object in objects {
            match object.shape {
                Shape::Lines(lines) => all.extend(lines),
                Shape::Areas(_) => self.note_kind(layer, "areas"),
            }
        }
        all
    }

    fn note_kind(&mut self, layer: i64, kind: &str) {
        count(&mut self.notes, &format!("{} that are {kind} (skipped)", NAMES[layer as usize]), 1);
    }
}
