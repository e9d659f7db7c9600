//! What data sets in this layout have beside what is read: further tables, and HD maps in other forms.

use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

use serde::Deserialize;

use super::folders::SensorFiles;
use super::map;
use super::tables::Scene;
use super::version::Version;
use crate::dataset::LogLocator;
use crate::dataset::recording::notes::{Notes, note};
use crate::files::input::{DataRoot, is_taken, is_there, open_regular};
use crate::files::json;
use crate::files::text::printable;

/// Tables beside the thirteen of nuScenes: those of nuScenes-lidarseg, TruckScenes and T4.
const TABLES: [&str; 10] = [
    "ego_motion_cabin",
    "ego_motion_chassis",
    "keypoint",
    "lidarseg",
    "object_ann",
    "panoptic",
    "surface_ann",
    "traffic_light",
    "vehicle_state",
    "weather_annotation",
];

/// The vector map of a T4 scene.
const LANELET: &str = "map/lanelet2_map.osm";

/// Record of the table `map`.
#[derive(Deserialize)]
struct MapRecord {
    #[serde(default)]
    log_tokens: Vec<String>,
    #[serde(default)]
    filename: String,
}

/// Notes the tables with records that are not read, and the maps of a scene without a map expansion.
pub(super) fn note_unread(
    version: &Version,
    scene: &Scene,
    locator: &LogLocator,
    location: &str,
    notes: &mut Notes,
) {
    for table in TABLES {
        let is_unread = has_records(&version.folder.join(format!("{table}.json")));
        note(notes, &format!("tables that are not read ({table})"), usize::from(is_unread));
    }
    // An error of the map is one of the commands that need it.
    if !matches!(map::find(&locator.path, locator.map_root.as_deref(), location), Ok(None)) {
        return;
    }
    let root = DataRoot { path: locator.path.clone(), allow_outside: false };
    let files = SensorFiles::new(root, &version.folder);
    for name in other_maps(&version.folder, scene) {
        let path = files.resolve(&name).ok();
        if path.is_some_and(|path| is_there(&path).unwrap_or(false)) {
            let kind = if name.ends_with(".osm") { "Lanelet2" } else { "an image" };
            note(notes, &format!("maps as {kind} (not read; {})", printable(&name)), 1);
        }
    }
}

/// Returns whether a table exists and is more than an empty array, as far as it can be read.
fn has_records(path: &Path) -> bool {
    let Ok((file, _)) = open_regular(path) else { return is_taken(path) };
    let mut head = Vec::new();
    file.take(64).read_to_end(&mut head).map_or(true, |_| head.contains(&b'{'))
}

/// Returns the names of files that may be maps of a scene. A table that cannot be read names none.
fn other_maps(tables: &Path, scene: &Scene) -> BTreeSet<String> {
    let records: Vec<MapRecord> = json::read(&tables.join("map.json"), "maps").unwrap_or_default();
    let is_of_log = |map: &MapRecord| map.log_tokens.contains(&scene.log_token);
    let named = records.into_iter().filter(is_of_log).map(|map| map.filename);
    named.filter(|name| !name.is_empty()).chain([LANELET.to_owned()]).collect()
}
