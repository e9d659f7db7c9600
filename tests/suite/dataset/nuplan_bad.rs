//! The nuPlan reader on bad input of every kind. One part of a synthetic log is broken, and the message must
//! name the expected and the found value, and the file.

use point_skeleton::dataset::nuplan::NuPlan;
use point_skeleton::dataset::{LogLocator, LogReader, MissingData};
use proptest::prelude::*;

use pskel_testing::nuplan_log::{
    EAST, LOG, NORTH, NuplanLog, RING, SOUTH, WEST, assert_says, geometry, image_file, pickled, sweep_file,
    token,
};
use pskel_testing::shared::shared;

/// Checks the message after some statements.
#[track_caller]
fn refused(statements: &str, parts: &[&str]) {
    let nuplan = NuplanLog::new();
    nuplan.sql(statements);
    nuplan.refuses(parts);
}

#[test]
fn files_other_than_logs_are_named() {
    let nuplan = NuplanLog::new();
    let path = nuplan.database();
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, "no database, but long enough to be looked at more closely").unwrap();
    nuplan.refuses(&["expected a SQLite database", "found text that begins with"]);
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    nuplan.refuses(&["(cut off)"]);
    std::fs::write(&path, []).unwrap();
    nuplan.refuses(&["expected a SQLite database", "found an empty file"]);
    std::fs::remove_file(&path).unwrap();
    nuplan.refuses(&["cannot read", "No such file"]);
}

#[test]
fn missing_tables_and_columns_are_named() {
    let tables = [
        "log",
        "category",
        "lidar",
        "camera",
        "ego_pose",
        "lidar_pc",
        "image",
        "track",
        "lidar_box",
        "scenario_tag",
        "scene",
        "traffic_light_status",
    ];
    for table in tables {
        refused(&format!("DROP TABLE {table};"), &["expected ", &format!("no such table: {table}")]);
    }
    let columns = [
        ("lidar_pc", "timestamp"),
        ("lidar_pc", "filename"),
        ("ego_pose", "qz"),
        ("camera", "distortion"),
        ("image", "filename_jpg"),
        ("lidar_box", "yaw"),
        ("category", "name"),
        ("scene", "roadblock_ids"),
        ("scene", "goal_ego_pose_token"),
    ];
    for (table, column) in columns {
        let statement = format!("ALTER TABLE {table} RENAME COLUMN {column} TO other;");
        refused(&statement, &[column, "found no such column", column]);
    }
}

/// Goals may lie in a part of the recording that was cut off.
#[test]
fn missing_goals_are_counted() {
    let nuplan = NuplanLog::new();
    nuplan.sql("UPDATE scene SET goal_ego_pose_token = x'0123456789abcdef', roadblock_ids = '7 8';");
    let log = nuplan.open().unwrap();
    let (routes, notes) = (&log.recording().routes, &log.recording().notes);
    assert!(!routes.is_empty() && routes.iter().all(|route| route.roadblocks == ["7", "8"]));
    assert!(routes.iter().all(|route| route.goal.is_none()));
    assert_eq!(notes["missing goals of routes"], routes.len());
}

#[test]
fn dangling_tokens_are_named() {
    let cases = [
        ("lidar_pc", "ego_pose_token", "ego_pose"),
        ("lidar_pc", "lidar_token", "lidar"),
        ("image", "ego_pose_token", "ego_pose"),
        ("image", "camera_token", "camera"),
        ("track", "category_token", "category"),
        ("lidar_box", "track_token", "track"),
    ];
    for (table, column, target) in cases {
        for (value, found) in [("x'00ff'", "00ff"), ("NULL", "NULL")] {
            let nuplan = NuplanLog::new();
            nuplan.sql(&format!("UPDATE {table} SET {column} = {value};"));
            let mut locator = nuplan.locator();
            locator.reading.missing = MissingData::Error;
            let message = NuPlan::open(&locator).expect_err("a log with gaps").to_string();
            let kind = if table == "image" || table == "lidar_pc" { "sweeps and images" } else { "boxes" };
            let missing = format!("whose {target} {found} is missing");
            assert_says(&message, &[&format!("{kind} that refer to a missing record"), &missing], "");
        }
        refused(
            &format!("UPDATE {table} SET {column} = 'text';"),
            &[&format!("expected bytes as {column} of {table} "), "\"text\""],
        );
    }
}

#[test]
fn wrong_values_are_named_with_their_row() {
    let cases: [(&str, &[&str]); 21] = [
        (
            "UPDATE lidar_box SET width = 9e999",
            &["positive length, width and height", "4 x inf x 1.5", "lidar_box 62"],
        ),
        ("UPDATE lidar_box SET x = 'far'", &["a number as x of lidar_box 62", "\"far\""]),
        ("UPDATE lidar_box SET yaw = NULL", &["a number as yaw", "found NULL"]),
        ("UPDATE lidar_box SET yaw = 9e999", &["finite numbers", "inf", "lidar_box 62"]),
        ("UPDATE ego_pose SET qw = 0.5", &["unit quaternion", "length 0.5", "ego_pose 65"]),
        ("UPDATE ego_pose SET x = x'00'", &["a number as ego_pose.x of lidar_pc", "1 bytes"]),
        ("UPDATE ego_pose SET y = 9e999", &["finite numbers", "ego_pose 65"]),
        (
            "UPDATE lidar_pc SET timestamp = 'soon' WHERE rowid = 1",
            &["a whole number as timestamp", "\"soon\""],
        ),
        ("UPDATE lidar_pc SET filename = NULL", &["text as filename of lidar_pc 70"]),
        ("UPDATE lidar_pc SET filename = '../../a.pcd'", &["below the data set's folder", "../../a.pcd"]),
        ("UPDATE lidar_pc SET filename = '/etc/passwd'", &["below the data set's folder", "/etc/passwd"]),
        (
            "UPDATE image SET filename_jpg = 'a/../../b.jpg'",
            &["below the data set's folder", "filename_jpg of image 69"],
        ),
        ("UPDATE image SET timestamp = 'noon'", &["a whole number as timestamp of image", "\"noon\""]),
        ("UPDATE camera SET width = 1.25", &["whole pixels as width of camera 63", "found 1.25"]),
        ("UPDATE camera SET height = 0", &["a size of 1 to 16384", "0x96", "camera 63"]),
        ("UPDATE camera SET width = -1e300", &["whole pixels as width"]),
        ("UPDATE camera SET channel = 'CAM_F0'", &["one row in camera for a channel", "two of CAM_F0"]),
        ("UPDATE category SET name = NULL", &["text as category.name of track 74", "found NULL"]),
        ("UPDATE log SET logfile = 5", &["text as logfile of log 6f", "found 5"]),
        ("DELETE FROM log", &["one row in log, found 0"]),
        ("DELETE FROM lidar_pc; DELETE FROM lidar_box", &["at least one row in lidar_pc, found none"]),
    ];
    for (statement, parts) in cases {
        refused(&format!("{statement};"), parts);
    }
}

#[test]
fn rejects_pickles_of_anything_but_lists() {
    // `os.system("true")` through `__reduce__`, as Python pickles it.
    let attack = "x'8004951f000000000000008c05706f736978948c0673797374656d9493948c047472756594859452942e'";
    let cases = [
        (attack, "class posix.system"),
        ("x'80045d522e'", "opcode 0x52 (REDUCE) at byte 3"),
        ("x'8004636f730a73797374656d0a2e'", "class os.system"),
        ("x'80015d2e'", "protocol 1"),
        ("x'80045d'", "the end of the pickle after 3 bytes"),
        ("x''", "the end of the pickle after 0 bytes"),
        ("x'80045d2e00'", "1 bytes after the end"),
        ("x'80045d2e'", "found []"),
    ];
    let columns = [
        ("lidar", "translation", "3 numbers"),
        ("lidar", "rotation", "4 numbers"),
        ("camera", "translation", "3 numbers"),
        ("camera", "rotation", "4 numbers"),
        ("camera", "intrinsic", "3x3 matrix"),
        ("camera", "distortion", "5 numbers"),
    ];
    for (table, column, shape) in columns {
        for (pickle, found) in cases {
            let expected = format!("{shape} as {column} of {table} ");
            refused(&format!("UPDATE {table} SET {column} = {pickle};"), &[&expected, found]);
        }
        refused(&format!("UPDATE {table} SET {column} = 'text';"), &["expected bytes as", "\"text\""]);
    }
    let long = format!("UPDATE camera SET distortion = {};", pickled(&[0.0; 1000]));
    refused(&long, &["9006 bytes where at most 4096"]);
    refused(
        &format!("UPDATE lidar SET rotation = {};", pickled(&[1.0, 1.0, 0.0, 0.0])),
        &["unit quaternion", "length 1.41", "in lidar 6c"],
    );
    let nan = format!("UPDATE camera SET distortion = {};", pickled(&[f64::NAN, 0.0, 0.0, 0.0, 0.0]));
    refused(&nan, &["finite numbers as distortion of camera 63", "NaN"]);
    refused(
        &format!("UPDATE camera SET distortion = {};", pickled(&[0.0; 3])),
        &["a pickled list of 4 or 5 numbers", "found [0, 0, 0]"],
    );
}

#[test]
fn times_that_do_not_increase_are_named() {
    let [a, b] = [1, 2].map(|frame| token('p', frame));
    refused(
        &format!("UPDATE lidar_pc SET timestamp = timestamp + 50000 WHERE token = {a};"),
        &["timestamps that grow from frame to frame", "1600000000100000 in lidar_pc 70"],
    );
    // Rows are sorted by time, but their chain has another order.
    refused(
        &format!("UPDATE lidar_pc SET timestamp = timestamp + 60000 WHERE token = {a};"),
        &["timestamps that grow along next_token", "1600000000100000 in lidar_pc 7000000000000002 after"],
    );
    refused(&format!("UPDATE lidar_pc SET next_token = token WHERE token = {b};"), &["along next_token"]);
    refused(
        &format!("UPDATE image SET timestamp = {} ;", 1_600_000_000_000_000_i64),
        &["timestamps that grow from image to image as timestamp of image", "twice, CAM_"],
    );
    // A next_token of a row outside the log ends the chain without an error.
    let nuplan = NuplanLog::new();
    nuplan.sql(&format!("UPDATE lidar_pc SET next_token = x'00' WHERE token = {b};"));
    assert!(nuplan.open().is_ok());
}

/// Logs are cut from longer recordings, and some tables keep rows of the remainder.
#[test]
fn data_without_a_frame_is_counted() {
    let tables = ["scenario_tag", "traffic_light_status", "lidar_box"];
    let kinds = ["scenario tags", "traffic lights", "boxes"];
    for (table, kind) in tables.into_iter().zip(kinds) {
        let nuplan = NuplanLog::new();
        let whole = nuplan.open().unwrap().recording().clone();
        let all = [
            whole.scenarios.values().map(Vec::len).sum(),
            whole.lights.len(),
            whole.frames.iter().map(|f| f.boxes.len()).sum(),
        ];
        nuplan.sql(&format!("UPDATE {table} SET lidar_pc_token = x'0102' WHERE rowid <= 2;"));
        for scene in [None, Some("scene-000".into())] {
            let dataset = NuPlan::open(&LogLocator { scene, ..nuplan.locator() }).unwrap();
            let notes: Vec<_> = dataset.recording().notes.clone().into_iter().collect();
            assert_eq!(notes, [(format!("{kind} of frames that are not there"), 2)]);
        }
        let log = nuplan.open().unwrap().recording().clone();
        assert_eq!(log.frames[0].boxes.is_empty(), table == "lidar_box");
        assert!(all.iter().all(|count: &usize| *count > 2));
        refused(
            &format!("UPDATE {table} SET lidar_pc_token = 'first';"),
            &[&format!("expected bytes as lidar_pc_token of {table} "), "\"first\""],
        );
    }
}

#[test]
fn boxes_without_a_size_are_counted() {
    for statement in ["SET width = 0", "SET height = -1", "SET length = 0, width = -5"] {
        let nuplan = NuplanLog::new();
        let box_0 = token('b', 10);
        nuplan.sql(&format!("UPDATE lidar_box {statement} WHERE token = {box_0};"));
        let log = nuplan.open().unwrap().recording().clone();
        assert_eq!(log.notes.into_iter().collect::<Vec<_>>(), [("boxes without a size".to_owned(), 1)]);
        let boxes: Vec<usize> = log.frames.iter().map(|f| f.boxes.len()).collect();
        assert_eq!(boxes, [2, 1, 2, 2], "{statement}");
    }
}

#[test]
fn rejects_two_boxes_of_a_track_in_a_frame() {
    refused(
        &format!("UPDATE lidar_box SET track_token = {};", token('t', 9)),
        &["one box per track and frame", "two of track 7400000000000009 in lidar_pc 70"],
    );
}

#[test]
fn damaged_blobs_are_named() {
    let nuplan = NuplanLog::new();
    let dataset = nuplan.open().unwrap();
    let frame = &dataset.recording().frames[0];
    let path = nuplan.blob(&sweep_file(0));
    let whole = std::fs::read(&path).unwrap();
    let message = || {
        let read = dataset.read_sweep(&frame.sweeps[0]).unwrap_err().to_string();
        (read, dataset.check_sweep(&frame.sweeps[0]).unwrap_err().to_string())
    };
    std::fs::write(&path, &whole[..40_000]).unwrap();
    for message in [message().0, message().1] {
        assert_says(&message, &["expected 3220 points of 15 bytes", "(truncated)"], "0.pcd");
    }
    let text = String::from_utf8_lossy(&whole[..300]).into_owned();
    let swapped = text.replacen("TYPE F F F", "TYPE F F U", 1);
    std::fs::write(&path, [swapped.as_bytes()[..250].to_vec(), whole[250..].to_vec()].concat()).unwrap();
    assert_says(&message().1, &["z as a single float of 4 or 8 bytes", "TYPE F F U U U U"], "0.pcd");
    std::fs::remove_file(&path).unwrap();
    assert_says(&message().0, &["cannot read"], "0.pcd");

    let path = nuplan.blob(&image_file(RING[0], 0));
    let jpeg = std::fs::read(&path).unwrap();
    std::fs::write(&path, &jpeg[..jpeg.len() / 2]).unwrap();
    assert_says(&dataset.read_image(&frame.images[0]).unwrap_err().to_string(), &["expected"], "0.jpg");
}

/// Checks the message of reading the map after some statements.
#[track_caller]
fn map_refused(statements: &str, parts: &[&str]) {
    let nuplan = NuplanLog::new();
    nuplan.map_sql(statements);
    let message = nuplan.open().unwrap().read_map().expect_err("a damaged map").to_string();
    assert_says(&message, parts, "map.gpkg");
}

#[test]
fn missing_map_layers_are_counted_but_lanes_are_required() {
    let layers = [
        "lanes_polygons",
        "lane_connectors",
        "gen_lane_connectors_scaled_width_polygons",
        "baseline_paths",
        "boundaries",
        "crosswalks",
        "stop_polygons",
        "generic_drivable_areas",
        "lane_groups_polygons",
        "intersections",
        "carpark_areas",
    ];
    for layer in layers {
        map_refused(&format!("DROP TABLE {layer};"), &[&format!("no such table: {layer}")]);
        let drop_both =
            format!("DROP TABLE {layer}; DELETE FROM gpkg_geometry_columns WHERE table_name = '{layer}';");
        if layer == "lanes_polygons" {
            map_refused(&drop_both, &["expected layer lanes_polygons, found none of that name"]);
            continue;
        }
        let nuplan = NuplanLog::new();
        nuplan.map_sql(&drop_both);
        let map = nuplan.open().unwrap().read_map().unwrap().unwrap();
        assert_eq!(map.notes[&format!("maps without {layer}")], 1);
    }
    map_refused("DROP TABLE meta;", &["expected meta with key, value", "no such table: meta"]);
    map_refused("DELETE FROM meta WHERE id = 2;", &["projectedCoordSystem in meta, found none"]);
    map_refused("UPDATE meta SET value = 'epsg:3857';", &["a UTM zone", "\"epsg:3857\""]);
}

#[test]
fn wrong_geometry_is_named_with_its_feature() {
    let triangle = [[-115.0, 36.0], [-115.1, 36.0], [-115.0, 36.1], [-115.0, 36.0]];
    let set = |blob: &str| format!("UPDATE crosswalks SET geom = {blob};");
    let area = geometry(true, &triangle);
    let cut = format!("{}'", &area[..area.len() - 21]);
    let cases = [
        (set("x''"), "lines or polygons"),
        (set("x'00112233'"), "lines or polygons"),
        (set(&cut), "lines or polygons"),
        (set(&geometry(false, &triangle)), "expected polygons as \"geom\" of crosswalks 61, found lines"),
        (set(&area.replace("e6100000", "e6110000")), "srs_id 4582"),
        (set(&geometry(true, &[[664_000.0, 3_997_000.0]; 3])), "longitude 664000"),
        // A point, and a collection in a collection.
        (set("x'47500001e610000001010000000000000000805cc00000000000004240'"), "a point"),
        (set("x'47500001e610000001070000000100000001070000000100000001'"), "a geometry collection"),
        (set(&format!("{}ff'", &area[..area.len() - 1])), "1 bytes behind the geometry"),
        // Four billion corners.
        (set(&area.replace("0100000004000000", "01000000ffffffff")), "lines or polygons"),
        (
            "UPDATE baseline_paths SET lane_fid = 'left';".to_owned(),
            "a whole number as lane_fid of baseline_paths 41, found \"left\"",
        ),
    ];
    for (statement, found) in cases {
        map_refused(&statement, &[found]);
    }
}

/// Returns the blob of a multi-part geometry, as SQL: blobs of `geometry` without their headers.
fn several(parts: &[String], kind: u8) -> String {
    let count = parts.len();
    let parts: String = parts.iter().map(|p| p["x'47500001e6100000".len()..p.len() - 1].to_owned()).collect();
    format!("x'47500001e610000001{kind:02x}000000{count:02x}000000{parts}'")
}

#[test]
fn missing_parts_of_a_map_are_counted() {
    let notes = NuplanLog::map_and_notes;
    let one = |kind: &str, count: usize| vec![(kind.to_owned(), count)];
    let (whole, none) = notes("");
    assert_eq!(none, []);

    let (map, reported) = notes("DELETE FROM gen_lane_connectors_scaled_width_polygons;");
    let lost = [
        ("baseline paths of unknown lanes".to_owned(), 1),
        ("lane connectors without an area".to_owned(), 1),
    ];
    assert_eq!(reported, lost);
    assert!(map.lane_connectors.is_empty() && map.lanes[0].successors.is_empty());

    // Maps may lack a layer for people.
    let (map, reported) = notes("DELETE FROM gpkg_geometry_columns WHERE table_name = 'walkways';");
    assert_eq!((reported, map.walkways.len()), (one("maps without walkways", 1), 0));

    // Polygons, lines and their multi-part types, all without parts.
    for kind in [2, 3, 5, 6] {
        let empty = format!("x'47500011e610000001{kind:02x}00000000000000'");
        let (map, reported) = notes(&format!("UPDATE crosswalks SET geom = {empty};"));
        assert_eq!(reported, one("features of crosswalks with an empty geometry", 1));
        assert!(map.crossings.is_empty() && map.lanes == whole.lanes);
    }

    // A small part before and after the lane's.
    let small = geometry(true, &[[-115.0, 36.0], [-115.0001, 36.0], [-115.0, 36.0001], [-115.0, 36.0]]);
    let large = [[WEST, SOUTH], [WEST, NORTH], [EAST, NORTH], [EAST, SOUTH], [WEST, SOUTH]];
    let parts = several(&[small.clone(), geometry(true, &large), small], 6);
    let (map, reported) = notes(&format!("UPDATE lanes_polygons SET geom = {parts} WHERE fid = 12;"));
    assert_eq!(reported, one("smaller parts of lanes", 2));
    assert_eq!(map.lanes, whole.lanes);

    let copy = "INSERT INTO gen_lane_connectors_scaled_width_polygons SELECT 32, geom, lane_connector_fid \
        FROM \
        gen_lane_connectors_scaled_width_polygons;";
    let (map, reported) = notes(copy);
    assert_eq!(reported, one("further areas of a lane", 1));
    assert_eq!(map.lane_connectors, whole.lane_connectors);

    let (_, reported) = notes("UPDATE baseline_paths SET lane_fid = 99 WHERE fid = 41;");
    assert_eq!(reported, one("baseline paths of unknown lanes", 1));
    let (map, reported) = notes(
        "INSERT INTO baseline_paths SELECT 43, geom, lane_fid, NULL FROM baseline_paths WHERE fid = 41;",
    );
    assert_eq!(reported, one("further baseline paths of a lane", 1));
    assert_eq!(map.lanes, whole.lanes);
}

#[test]
fn the_map_index_must_match() {
    let nuplan = NuplanLog::new();
    let index = nuplan.path("maps/nuplan-maps-v1.0.json");
    let message = || nuplan.open().unwrap().read_map().unwrap_err().to_string();
    std::fs::remove_file(nuplan.map()).unwrap();
    assert_says(&message(), &["cannot read"], "1.0/map.gpkg");
    std::fs::write(&index, "{}").unwrap();
    assert_eq!(nuplan.open().unwrap().read_map().unwrap(), None);
    std::fs::write(&index, "{\"us-xx-nowhere\": {\"version\": \"../..\"}}").unwrap();
    assert_says(
        &message(),
        &["a name without /", "name or version of a map", "../.."],
        "nuplan-maps-v1.0.json",
    );
    std::fs::write(&index, "[1]").unwrap();
    assert_says(&message(), &["a JSON object of maps with their version"], "nuplan-maps-v1.0.json");
    std::fs::remove_file(&index).unwrap();
    assert_says(&message(), &["cannot read"], "nuplan-maps-v1.0.json");
}

/// A generated log in nuPlan's schema whose rotations are all zero and whose images are 1.23 pixels wide.
#[test]
fn rejects_the_numbers_of_the_generated_minimal_log() {
    let Some(shared) = shared("the minimal nuPlan log") else { return };
    let copy = tempfile::tempdir().unwrap();
    let path = copy.path().join(format!("{LOG}.db"));
    std::fs::write(&path, std::fs::read(shared.join("data/nuplan-minimal/minimal.db")).unwrap()).unwrap();
    let locator = LogLocator::new(&point_skeleton::dataset::nuplan::FORMAT, &path);
    let message = || NuPlan::open(&locator).unwrap_err().to_string();
    assert_says(&message(), &["unit quaternion", "length 0 in lidar 00700000"], ".db");
    let level = pickled(&[1.0, 0.0, 0.0, 0.0]);
    let sql = |statements: &str| {
        rusqlite::Connection::open(&path).unwrap().execute_batch(statements).unwrap();
    };
    sql(&format!("UPDATE lidar SET rotation = {level}; UPDATE ego_pose SET qw = 1, qx = 0, qy = 0, qz = 0;"));
    assert_says(&message(), &["unit quaternion", "length 0 in camera 01000000"], ".db");
    sql(&format!("UPDATE camera SET rotation = {level};"));
    assert_says(&message(), &["whole pixels as width of camera 01000000, found 1.23"], ".db");
    sql("UPDATE camera SET width = 32, height = 18;");
    assert_says(&message(), &["last row 0 0 1, found [0.0, 0.0, 0.0] in camera 01000000"], ".db");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    /// The reader returns a log or an error for any database content.
    #[test]
    fn no_database_makes_the_reader_panic(
        is_map in any::<bool>(),
        places in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        thread_local!(static NUPLAN: NuplanLog = NuplanLog::new());
        NUPLAN.with(|nuplan| {
            let path = if is_map { nuplan.map() } else { nuplan.database() };
            let whole = std::fs::read(&path).unwrap();
            let mut bytes = whole.clone();
            for (place, value) in places {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            std::fs::write(&path, &bytes).unwrap();
            let opened = nuplan.open();
            let map = opened.as_ref().ok().map(|dataset| dataset.read_map().is_ok());
            std::fs::write(&path, &whole).unwrap();
            assert!(map != Some(true) || opened.unwrap().recording().frames.len() <= 8);
        });
    }
}
