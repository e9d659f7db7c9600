//! The nuScenes reader on bad input of every kind. A short log is written, one part is broken, and the
//! message must name the expected and the found value, and the file.

use std::path::PathBuf;

use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{DatasetError, LogLocator, LogReader, MissingData, expand};
use proptest::prelude::*;
use pskel_testing::six_cameras::{FRAMES, VERSION, copy_to};
use serde_json::{Value, json};

const TABLES: [&str; 13] = [
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
];

/// Tables that are not read.
const UNREAD: [&str; 3] = ["attribute", "map", "visibility"];

/// Copy of a log's files that a test breaks.
struct Broken(tempfile::TempDir);

impl Broken {
    /// Copies only the tables; sweeps and images are empty files.
    fn new() -> Self {
        let copy = tempfile::tempdir().unwrap();
        copy_to(copy.path(), |name| name.starts_with(VERSION));
        let broken = Self(copy);
        broken.edit("sample_data", |records| {
            for record in records {
                let path = broken.0.path().join(record["filename"].as_str().unwrap());
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, "").unwrap();
            }
        });
        broken
    }

    /// Also copies sweeps and images of the first frame.
    fn with_files() -> Self {
        let broken = Self::new();
        copy_to(broken.0.path(), |name| {
            name.contains("__1600000000000000.") || name.contains("__15999999999")
        });
        broken
    }

    fn table(&self, name: &str) -> PathBuf {
        self.0.path().join(VERSION).join(format!("{name}.json"))
    }

    /// Edits the records of a table.
    fn edit(&self, name: &str, edit: impl FnOnce(&mut Vec<Value>)) {
        let text = std::fs::read(self.table(name)).unwrap();
        let mut records: Vec<Value> = serde_json::from_slice(&text).unwrap();
        edit(&mut records);
        std::fs::write(self.table(name), serde_json::to_vec(&records).unwrap()).unwrap();
    }

    fn open_as(&self, tail: &str) -> Result<NuScenes, DatasetError> {
        let name = format!("nuscenes:{}{tail}", self.0.path().display());
        NuScenes::open(&name.parse::<LogLocator>().unwrap())
    }

    /// Opens the log and checks that the error message contains all parts and ends with a path.
    fn refuses(&self, tail: &str, parts: &[&str], ending: &str) {
        let message = self.open_as(tail).expect_err("a damaged log").to_string();
        assert_says(&message, parts, ending);
    }
}

fn assert_says(message: &str, parts: &[&str], ending: &str) {
    assert!(message.ends_with(ending), "{message:?} does not end with {ending:?}");
    for part in parts {
        assert!(message.contains(part), "{message:?} does not contain {part:?}");
    }
}

#[test]
fn a_missing_table_is_named() {
    for table in TABLES {
        let broken = Broken::new();
        std::fs::remove_file(broken.table(table)).unwrap();
        if UNREAD.contains(&table) {
            broken.open_as("").unwrap();
        } else {
            broken.refuses("", &["cannot read"], &format!("v1.0-mini/{table}.json"));
        }
    }
}

#[test]
fn truncated_tables_are_named_with_their_length() {
    for table in ["sample_data", "sample_annotation", "ego_pose", "scene"] {
        let broken = Broken::new();
        let bytes = std::fs::read(broken.table(table)).unwrap();
        let left = &bytes[..bytes.len() - 9];
        std::fs::write(broken.table(table), left).unwrap();
        let end = match table {
            "scene" => format!("the end of the file after {} bytes", left.len()),
            _ => format!("an end of the file after {} bytes", left.len()),
        };
        broken.refuses("", &["expected a JSON array", &end], &format!("{table}.json"));
    }
}

#[test]
fn dangling_tokens_are_named() {
    let cases = [
        ("scene", "log_token", "log"),
        ("scene", "first_sample_token", "sample"),
        ("sample", "next", "sample"),
    ];
    for (table, field, target) in cases {
        let broken = Broken::new();
        broken.edit(table, |records| records[0][field] = json!("nowhere"));
        let by = format!("referred to by {table} ");
        let expected = format!("expected {target}.json to hold token nowhere, found none");
        broken.refuses("", &[&expected, &by], &format!("v1.0-mini/{target}.json"));
    }
}

/// A missing record costs the data and boxes that refer to it, as a missing file does.
#[test]
fn dependents_of_a_missing_record_are_skipped_or_rejected() {
    let cases = [
        ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
        ("sample_data", "ego_pose_token", "ego_pose"),
        ("calibrated_sensor", "sensor_token", "sensor"),
        ("sample_annotation", "instance_token", "instance"),
        ("instance", "category_token", "category"),
    ];
    for (table, field, target) in cases {
        let broken = Broken::new();
        broken.edit(table, |records| records[0][field] = json!("nowhere"));
        let boxes = target == "instance" || target == "category";
        let kind = if boxes { "boxes" } else { "sweeps and images" };
        let kind = format!("{kind} that refer to a missing record");
        let log = broken.open_as("").unwrap();
        let gaps = &log.recording().gaps;
        assert!(gaps[0].to_string().contains(&format!("whose {target} nowhere is missing")), "{}", gaps[0]);
        assert_eq!(log.recording().notes[&kind], gaps.iter().filter(|gap| gap.kind == kind).count());
        assert_eq!(log.recording().frames.len(), FRAMES);
        let mut strict: LogLocator = format!("nuscenes:{}", broken.0.path().display()).parse().unwrap();
        strict.reading.missing = MissingData::Error;
        let message = NuScenes::open(&strict).expect_err("a log with gaps").to_string();
        let file = format!("v1.0-mini/{target}.json");
        assert_says(&message, &[&kind, "whose", "nowhere is missing", &file], "");
    }
}

#[test]
fn bad_numbers_are_named_with_their_record() {
    type Edit = fn(&mut Value);
    let cases: [(&str, Edit, &[&str]); 7] = [
        ("sample_annotation", |r| r["rotation"] = json!([1, 1, 0, 0]), &["unit quaternion", "1.41"]),
        ("ego_pose", |r| r["rotation"] = json!([0.5, 0, 0, 0]), &["unit quaternion", "length 0.5"]),
        ("calibrated_sensor", |r| r["rotation"] = json!([0, 0, 0, 0]), &["unit quaternion", "length 0"]),
        ("calibrated_sensor", |r| r["camera_intrinsic"][0][0] = json!(0), &["invertible", "fx 0"]),
        ("calibrated_sensor", |r| r["camera_intrinsic"] = json!([[1, 2]]), &["3x3", "[[1.0, 2.0]]"]),
        (
            "ego_pose",
            |r| r["translation"] = json!([0, 1]),
            &["JSON array of ego_pose", "2 elements instead of an array of length 3 in translation"],
        ),
        ("sample_data", |r| r["timestamp"] = json!("noon"), &["JSON array of sample_data", "noon"]),
    ];
    for (table, edit, parts) in cases {
        let broken = Broken::new();
        let mut token = String::new();
        broken.edit(table, |records| {
            let record = records.iter_mut().find(|r| r["camera_intrinsic"] != json!([])).unwrap();
            token = record["token"].as_str().unwrap().to_owned();
            edit(record);
        });
        broken.refuses("", parts, &format!("{table}.json"));
        let message = broken.open_as("").err().unwrap().to_string();
        assert!(message.contains(&token), "{message}");
    }
}

#[test]
fn records_that_contradict_each_other_are_named() {
    let broken = Broken::new();
    broken.edit("sample", |r| r[1]["timestamp"] = r[0]["timestamp"].clone());
    broken.refuses("", &["timestamps that grow", "after 1600000000000000"], "sample.json");
    let broken = Broken::new();
    broken.edit("sample", |r| r[1]["next"] = r[0]["token"].clone());
    broken.refuses("", &["chain of samples that ends", "twice"], "sample.json");
    let broken = Broken::new();
    broken.edit("sample", |r| r[1]["scene_token"] = json!("other"));
    broken.refuses("", &["samples of scene", "of scene other"], "sample.json");
    let broken = Broken::new();
    broken.edit("sample_annotation", |r| {
        let mut again = r[0].clone();
        again["token"] = json!("again");
        r.push(again);
    });
    broken.refuses("", &["one box per instance", "two of instance "], "sample_annotation.json");
    let broken = Broken::new();
    broken.edit("sample_annotation", |r| r.push(r[0].clone()));
    broken.refuses("", &["every token once", "twice"], "sample_annotation.json");
    let broken = Broken::new();
    broken.edit("sample_data", |r| {
        let mut again = r[0].clone();
        again["token"] = json!("again");
        r.push(again);
    });
    broken.refuses("", &["one key frame per sensor", "a second key frame of "], "sample_data.json");
}

#[test]
fn scenes_and_versions_must_be_chosen() {
    let broken = Broken::new();
    broken.edit("scene", |r| {
        let mut other = r[0].clone();
        (r[0]["name"], other["token"], other["name"]) = (json!("town-3"), json!("other"), json!("town-6"));
        r.push(other);
    });
    broken.refuses("", &["expected #SCENE to name one of town-3, town-6, found none"], "scene.json");
    broken.refuses("#town-9", &["town-3, town-6, found town-9"], "scene.json");
    assert_eq!(broken.open_as("#town-3").unwrap().recording().frames.len(), FRAMES);
    let expand = |tail: &str| {
        let name: LogLocator = format!("nuscenes:{}{tail}", broken.0.path().display()).parse().unwrap();
        let scenes = |logs: Vec<LogLocator>| logs.into_iter().filter_map(|log| log.scene).collect::<Vec<_>>();
        expand(&name).map(scenes)
    };
    assert_eq!(expand("#*").unwrap(), ["town-3", "town-6"]);
    assert_eq!(expand("#town").unwrap(), ["town-3", "town-6"]);
    assert_eq!(expand("#town-6").unwrap(), ["town-6"]);
    assert_says(&expand("#boston").unwrap_err().to_string(), &["town-3, town-6, found boston"], "scene.json");
    let root = broken.0.path().to_string_lossy().into_owned();
    broken.refuses("@v1.0-none", &["@VERSION to name one of v1.0-mini, found v1.0-none"], &root);
    let other = broken.0.path().join("v1.0-trainval");
    std::fs::create_dir(&other).unwrap();
    // A folder without tables is no version.
    assert!(broken.open_as("#town-3").is_ok());
    std::fs::copy(broken.table("scene"), other.join("scene.json")).unwrap();
    broken.refuses("", &["@VERSION to name one of v1.0-mini, v1.0-trainval, found none"], &root);
    assert!(broken.open_as("@v1.0-mini#town-3").is_ok());
    let nowhere = "nuscenes:/nowhere/at/all".parse().unwrap();
    assert_says(&NuScenes::open(&nowhere).err().unwrap().to_string(), &["cannot read"], "/nowhere/at/all");
}

#[test]
fn skipped_items_are_counted() {
    let broken = Broken::new();
    broken.edit("sample_data", |r| {
        let camera = r.iter().position(|d| d["filename"].as_str().unwrap().contains("CAM_BACK/")).unwrap();
        r.remove(camera);
    });
    broken.edit("sensor", |r| {
        let lidar = r.iter_mut().find(|s| s["modality"] == "lidar").unwrap();
        lidar["modality"] = json!("radar");
    });
    let dataset = broken.open_as("").unwrap();
    let notes: Vec<(&str, usize)> = dataset.recording().notes.iter().map(|(k, n)| (k.as_str(), *n)).collect();
    let expected = [
        ("frames without a LiDAR sweep of their own", FRAMES),
        ("missing camera images", 1),
        ("radar sweeps (not read)", 2 * FRAMES - 1),
    ];
    assert_eq!(notes, expected);
}

/// Adds a sweep or image that is not a key frame: a copy of the sensor's key frame in the last sample, at
/// another time.
fn add_between(records: &mut Vec<Value>, channel: &str, t_us: i64) {
    let of_channel = |r: &&Value| r["filename"].as_str().unwrap().contains(&format!("/{channel}/"));
    let mut copy = records.iter().rfind(of_channel).unwrap().clone();
    copy["token"] = json!(format!("{channel} at {t_us}"));
    (copy["timestamp"], copy["is_key_frame"]) = (json!(t_us), json!(false));
    records.push(copy);
}

#[test]
fn data_between_frames_belongs_to_the_next_frame() {
    let broken = Broken::new();
    let times = broken.open_as("").unwrap().recording().frames.iter().map(|f| f.t_us).collect::<Vec<_>>();
    let (first, last) = (times[0], times[FRAMES - 1]);
    broken.edit("sample_data", |records| {
        for t_us in [last - 150_000, last - 50_000, first - 50_000, last + 50_000] {
            add_between(records, "LIDAR_TOP", t_us);
        }
        for (channel, t_us) in
            [("CAM_BACK", last - 90_000), ("CAM_FRONT", last - 90_000), ("CAM_BACK", first + 1)]
        {
            add_between(records, channel, t_us);
        }
    });
    let dataset = broken.open_as("").unwrap();
    let log = dataset.recording();
    let sweeps = |i: usize| log.frames[i].sweeps.iter().map(|s| s.t_us).collect::<Vec<_>>();
    // The log itself has a sweep every 100 ms.
    assert_eq!(sweeps(0), [first, first - 50_000]);
    assert_eq!(sweeps(1), [times[1], times[1] - 100_000]);
    assert_eq!(sweeps(FRAMES - 1), [last, last - 50_000, last - 100_000, last - 150_000]);
    let between = |i: usize| {
        let images = log.frames[i].between_images.iter();
        images.map(|i| (i.t_us, log.cameras[i.channel].as_str())).collect::<Vec<_>>()
    };
    assert!(between(0).is_empty());
    assert_eq!(between(1), [(first + 1, "CAM_BACK")]);
    assert_eq!(between(FRAMES - 1), [(last - 90_000, "CAM_FRONT"), (last - 90_000, "CAM_BACK")]);
    assert!(log.frames.iter().all(|f| f.images.len() == 6));
    // The copies have the ego poses of another time.
    let is_pose = |kind: &str| kind.starts_with("ego poses of another time than their data");
    let notes = log.notes.iter().map(|(kind, count)| (kind.as_str(), *count));
    let notes: Vec<(&str, usize)> = notes.filter(|(kind, _)| !is_pose(kind)).collect();
    assert_eq!(notes, [("sweeps and images after the last sample", 1)]);
}

#[test]
fn damaged_sweeps_are_named() {
    let broken = Broken::with_files();
    let dataset = broken.open_as("").unwrap();
    let record = &dataset.recording().frames[0].sweeps[0];
    let whole = std::fs::read(&record.path).unwrap();
    let points = dataset.read_sweep(record).unwrap().points.len();
    let fails = |bytes: &[u8], parts: &[&str]| {
        std::fs::write(&record.path, bytes).unwrap();
        assert_says(
            &dataset.read_sweep(record).unwrap_err().to_string(),
            parts,
            record.path.to_str().unwrap(),
        );
    };
    let cut = whole.len() - 7;
    fails(&whole[..cut], &["expected a multiple of 20 bytes", &format!("found {cut} bytes")]);
    fails(&[], &["expected at least one point", "found an empty file"]);
    let mut holes = whole.clone();
    holes[0..4].copy_from_slice(&f32::NAN.to_le_bytes());
    holes[24..28].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
    std::fs::write(&record.path, &holes).unwrap();
    let sweep = dataset.read_sweep(record).unwrap();
    assert_eq!((sweep.points.len(), sweep.dropped_non_finite), (points - 2, 2));
    std::fs::remove_file(&record.path).unwrap();
    assert!(dataset.read_sweep(record).unwrap_err().to_string().starts_with("cannot read"));
}

#[test]
fn damaged_images_are_named() {
    let broken = Broken::with_files();
    let dataset = broken.open_as("").unwrap();
    let record = &dataset.recording().frames[0].images[0];
    let path = record.path.to_str().unwrap();
    let whole = std::fs::read(path).unwrap();
    assert_eq!(dataset.read_image(record).unwrap().dimensions(), (160, 90));
    image::RgbImage::new(40, 30).save(path).unwrap(); // encoded as JPEG because of its name
    let message = || {
        dataset.read_image(record).map(|image| image.dimensions()).expect_err("a damaged image").to_string()
    };
    assert_says(&message(), &["expected an image of 90x160 pixels", "found 30x40"], path);
    std::fs::write(path, &whole[..whole.len() - 9]).unwrap();
    assert_says(&message(), &["expected a whole JPEG image", "without an end marker"], path);
    std::fs::write(path, "text").unwrap();
    assert_says(&message(), &["expected a JPEG or PNG image"], path);
    std::fs::remove_file(path).unwrap();
    assert_says(&message(), &["cannot read"], path);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// The reader returns a log or an error for any table content.
    #[test]
    fn no_table_makes_the_reader_panic(
        table in 0..TABLES.len(),
        places in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in proptest::option::of(any::<prop::sample::Index>()),
    ) {
        thread_local!(static COPY: Broken = Broken::new());
        COPY.with(|copy| {
            let path = copy.table(TABLES[table]);
            let whole = std::fs::read(&path).unwrap();
            let mut bytes = whole.clone();
            for (place, value) in places {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            bytes.truncate(cut.map_or(bytes.len(), |cut| cut.index(whole.len())));
            std::fs::write(&path, &bytes).unwrap();
            let opened = copy.open_as("");
            std::fs::write(&path, &whole).unwrap();
            if let Ok(dataset) = opened {
                assert!(dataset.recording().frames.len() <= FRAMES);
            }
        });
    }
}
