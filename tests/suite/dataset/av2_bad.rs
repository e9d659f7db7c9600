//! The Argoverse 2 reader on bad input of every kind. One part of a synthetic log is broken, and the message
//! must name the expected and the found value, and the file.

use std::sync::Arc;

use arrow_array::{ArrayRef, Float16Array, Float32Array, Int64Array, StringArray, UInt64Array};
use arrow_ipc::CompressionType;
use half::f16;
use point_skeleton::dataset::LogReader;
use point_skeleton::dataset::av2::read_sweep_file;
use proptest::prelude::*;

use pskel_testing::av2_log::{
    Columns, FIRST_NS, FRAMES, IMAGE_NS, RING, STEP_NS, TinyAv2, frame_ns, integers, numbers, picture, read,
    set, set_number, sweep, texts, write,
};

const TABLES: [&str; 4] = [
    "annotations.feather",
    "city_SE3_egovehicle.feather",
    "calibration/intrinsics.feather",
    "calibration/egovehicle_SE3_sensor.feather",
];

#[test]
fn a_missing_table_is_named() {
    // Logs of the test split have no annotations.
    for table in TABLES.into_iter().filter(|table| *table != "annotations.feather") {
        let log = TinyAv2::new();
        std::fs::remove_file(log.path(table)).unwrap();
        log.refuses(&["cannot read"], table);
    }
}

#[test]
fn truncated_tables_and_other_formats_are_named() {
    let log = TinyAv2::new();
    for table in TABLES {
        let whole = std::fs::read(log.path(table)).unwrap();
        for cut in (0..whole.len()).step_by(97).chain([whole.len() - 1]) {
            std::fs::write(log.path(table), &whole[..cut]).unwrap();
            let found = match cut {
                0 => "found an empty file".to_owned(),
                _ => format!("found {cut} bytes (cut off, or another format)"),
            };
            log.refuses(&["expected an Arrow file (Feather)", &found], table);
        }
        std::fs::write(log.path(table), [&whole[..], &whole[whole.len() - 6..]].concat()).unwrap();
        log.refuses(&["expected an Arrow file (Feather)"], table);
        std::fs::write(log.path(table), whole).unwrap();
    }
    log.open().unwrap();
}

type Edit = fn(&mut Columns);

/// Counts that are only reported decide nothing.
#[test]
fn unknown_counts_of_points_are_counted() {
    let edits: [Edit; 4] = [
        |c| set(c, "num_interior_pts", integers(vec![-1; 2 * FRAMES])),
        |c| set(c, "num_interior_pts", numbers(vec![f64::NAN; 2 * FRAMES])),
        |c| set(c, "num_interior_pts", texts(&["1"; 2 * FRAMES])),
        |c| c.retain(|(name, _)| name != "num_interior_pts"),
    ];
    let noted = |edit: Edit| {
        let log = TinyAv2::new();
        log.edit(TABLES[0], edit);
        let log = log.open().unwrap();
        let counts = log.box_points().unwrap().concat();
        (log.recording().notes.get("boxes with an unknown number of LiDAR points").copied(), counts)
    };
    for edit in edits {
        assert_eq!(noted(edit), (Some(2 * FRAMES), vec![None; 2 * FRAMES]));
    }
    let floats = noted(|c| set(c, "num_interior_pts", numbers(vec![7.0; 2 * FRAMES])));
    assert_eq!(floats, (None, vec![Some(7); 2 * FRAMES]));
    let wide = TinyAv2::new();
    wide.edit(TABLES[2], |c| set(c, "width_px", numbers(vec![64.0; 8])));
    assert_eq!(wide.open().unwrap().recording().rig[0].camera.width, 64);
}

#[test]
fn wrong_columns_are_named() {
    let remove = |name: &'static str| move |columns: &mut Columns| columns.retain(|(n, _)| n != name);
    for (table, name) in [
        (TABLES[0], "category"),
        (TABLES[0], "track_uuid"),
        (TABLES[1], "tz_m"),
        (TABLES[2], "fx_px"),
        (TABLES[3], "sensor_name"),
    ] {
        let log = TinyAv2::new();
        log.edit(table, remove(name));
        log.refuses(&[&format!("expected a column {name}, found columns ")], table);
    }
    let cases: [(&str, Edit, &[&str]); 6] = [
        (
            TABLES[0],
            |c| set(c, "timestamp_ns", texts(&["1"; 2 * FRAMES])),
            &["integers in column timestamp_ns", "type Utf8"],
        ),
        (
            TABLES[0],
            |c| set(c, "track_uuid", integers(vec![1; 2 * FRAMES])),
            &["texts in column track_uuid", "type Int64"],
        ),
        (
            TABLES[0],
            |c| set(c, "length_m", texts(&["1"; 2 * FRAMES])),
            &["numbers in column length_m", "type Utf8"],
        ),
        (
            TABLES[2],
            |c| set(c, "width_px", integers(vec![-1; 8])),
            &["from 0 to 2^32 - 1", "-1 in column width_px"],
        ),
        (
            TABLES[2],
            |c| set(c, "width_px", numbers(vec![64.5; 8])),
            &["whole floats", "64.5 in column width_px"],
        ),
        (
            TABLES[0],
            |c| {
                let half: Vec<Option<&str>> = [Some("SIGN"), None].repeat(FRAMES);
                set(c, "category", Arc::new(StringArray::from(half)));
            },
            &["a value in every row of column category", "3 empty ones"],
        ),
    ];
    for (table, edit, parts) in cases {
        let log = TinyAv2::new();
        log.edit(table, edit);
        log.refuses(parts, table);
    }
}

/// The same values in other numeric types give the same log.
#[test]
fn numbers_may_have_any_width() {
    let log = TinyAv2::new();
    let expected = log.open().unwrap().recording().clone();
    log.edit(TABLES[0], |columns| {
        let stamps = (0..FRAMES).flat_map(|f| [frame_ns(f) as u64; 2]).collect::<Vec<_>>();
        set(columns, "timestamp_ns", Arc::new(UInt64Array::from(stamps)));
        set(columns, "length_m", Arc::new(Float32Array::from([4.0, 0.5].repeat(FRAMES))));
        let names: Vec<&str> = ["REGULAR_VEHICLE", "SIGN"].repeat(FRAMES);
        set(columns, "category", Arc::new(arrow_array::StringViewArray::from(names.clone())));
        let ids = ["car", "a sign"].repeat(FRAMES);
        set(columns, "track_uuid", Arc::new(arrow_array::LargeStringArray::from(ids)));
    });
    assert_eq!(*log.open().unwrap().recording(), expected);
    log.edit(TABLES[0], |columns| {
        set(columns, "timestamp_ns", Arc::new(UInt64Array::from(vec![u64::MAX; 2 * FRAMES])));
    });
    log.refuses(&["integers below 2^63", "18446744073709551615 in column timestamp_ns"], TABLES[0]);
}

#[test]
fn bad_values_are_named_with_their_row() {
    let cases: [(&str, Edit, &[&str]); 10] = [
        (TABLES[0], |c| set_number(c, "width_m", 1, f64::INFINITY), &["positive length", "x inf x", "row 1"]),
        (TABLES[0], |c| set_number(c, "height_m", 0, f64::NAN), &["positive length", "NaN", "row 0"]),
        (TABLES[0], |c| set_number(c, "qz", 2, 1.0), &["unit quaternion", "1.41", "row 2"]),
        (TABLES[1], |c| set_number(c, "tx_m", 3, f64::INFINITY), &["finite numbers", "row 3"]),
        (TABLES[1], |c| set_number(c, "qw", 0, 0.0), &["unit quaternion", "length 0", "row 0"]),
        (TABLES[2], |c| set_number(c, "fx_px", 0, 0.0), &["invertible", "sensor ring_front_center"]),
        (TABLES[3], |c| set_number(c, "qw", 0, 3.0), &["unit quaternion", "sensor ring_front_center"]),
        (
            TABLES[0],
            |c| set(c, "track_uuid", texts(&["car"; 2 * FRAMES])),
            &["one box per track and time", "two of car at"],
        ),
        (
            TABLES[0],
            |c| {
                let stamps = (0..FRAMES).flat_map(|f| [frame_ns(f), frame_ns(f) + 1]).collect();
                set(c, "timestamp_ns", integers(stamps));
            },
            &["a microsecond apart", "in the microsecond of the one before"],
        ),
        (
            TABLES[2],
            |c| {
                let names = ["ring_front_left", "ring_front_left", "a", "b", "c", "d", "e", "f"];
                set(c, "sensor_name", texts(&names));
            },
            &["every sensor once", "ring_front_left twice"],
        ),
    ];
    for (table, edit, parts) in cases {
        let log = TinyAv2::new();
        log.edit(table, edit);
        log.refuses(parts, table);
    }
}

#[test]
fn times_that_do_not_increase_are_errors() {
    let log = TinyAv2::new();
    log.edit(TABLES[1], |columns| {
        let old = columns[0].1.as_any().downcast_ref::<Int64Array>().unwrap().values().to_vec();
        set(columns, "timestamp_ns", integers(old.into_iter().rev().collect()));
    });
    log.refuses(&["timestamps that grow from row to row", "in row 1"], TABLES[1]);
    // Rows of boxes may be in any order.
    let log = TinyAv2::new();
    let expected = log.open().unwrap().recording().clone();
    log.edit(TABLES[0], |columns| {
        for (_, column) in columns {
            let parts = [column.slice(3, 2 * FRAMES - 3), column.slice(0, 3)];
            *column = join(&[&*parts[0], &*parts[1]]);
        }
    });
    assert_eq!(log.open().unwrap().recording().frames, expected.frames);
}

fn join(parts: &[&dyn arrow_array::Array]) -> ArrayRef {
    use arrow_array::cast::AsArray;
    use arrow_array::types::{Float64Type, Int64Type};
    match parts[0].data_type().to_string().as_str() {
        "Int64" => {
            integers(parts.iter().flat_map(|p| p.as_primitive::<Int64Type>().values().to_vec()).collect())
        }
        "Float64" => {
            numbers(parts.iter().flat_map(|p| p.as_primitive::<Float64Type>().values().to_vec()).collect())
        }
        _ => texts(&parts.iter().flat_map(|p| p.as_string::<i32>().iter().flatten()).collect::<Vec<_>>()),
    }
}

fn notes(log: &TinyAv2) -> Vec<(String, usize)> {
    log.open().unwrap().recording().notes.clone().into_iter().collect()
}

#[test]
fn skipped_items_are_counted() {
    let reported = |edit: &dyn Fn(&TinyAv2)| {
        let log = TinyAv2::new();
        edit(&log);
        notes(&log)
    };
    let one = |what: &str, count: usize| vec![(what.to_owned(), count)];
    let rename = |from: String, to: String| {
        reported(&move |log| std::fs::rename(log.path(&from), log.path(&to)).unwrap())
    };
    let lidar = |t_ns: i64| format!("sensors/lidar/{t_ns}.feather");
    assert_eq!(
        reported(&|log| std::fs::remove_file(log.path(&sweep(1))).unwrap()),
        one("frames without a LiDAR sweep of their own", 1)
    );
    assert_eq!(
        reported(&|log| std::fs::remove_dir_all(log.path("sensors/lidar")).unwrap()),
        one("frames without a LiDAR sweep of their own", FRAMES)
    );
    assert_eq!(
        reported(&|log| std::fs::remove_file(log.path(&picture(0, "ring_side_left"))).unwrap()),
        one("missing camera images", 1)
    );
    assert_eq!(
        reported(&|log| std::fs::write(log.path("sensors/lidar/readme.txt"), "").unwrap()),
        one("sensor files without a time for a name", 1)
    );
    assert_eq!(
        reported(&|log| std::fs::copy(log.path(&sweep(0)), log.path(&lidar(frame_ns(2) + 7)))
            .map(|_| ())
            .unwrap()),
        one("sweeps after the last frame", 1)
    );
    let far = FIRST_NS - 1_000_000_000;
    let image = |t_ns: i64| format!("sensors/cameras/ring_side_left/{t_ns}.jpg");
    assert_eq!(
        rename(picture(0, "ring_side_left"), image(far)),
        [("images without an ego pose".to_owned(), 1), ("missing camera images".to_owned(), 1)]
    );
    // More than 50 ms from any frame.
    let late = frame_ns(2) + 50_000_001;
    assert_eq!(
        rename(picture(2, "ring_side_left"), image(late)),
        [("images after the last frame".to_owned(), 1), ("missing camera images".to_owned(), 1)]
    );
    assert_eq!(
        reported(&|log| log.edit(TABLES[2], |c| {
            let mut names: Vec<&str> = RING.iter().map(|(name, _)| *name).collect();
            names[0] = "other";
            names.push("stereo_front_left");
            set(c, "sensor_name", texts(&names));
        })),
        one("ring cameras without calibration", 1)
    );
    let categories = |names: [&'static str; 6]| {
        reported(&move |log| log.edit(TABLES[0], |c| set(c, "category", texts(&names))))
    };
    assert_eq!(
        categories([
            "REGULAR_VEHICLE",
            "SPACESHIP",
            "REGULAR_VEHICLE",
            "SPACESHIP",
            "REGULAR_VEHICLE",
            "SPACESHIP"
        ]),
        one("boxes of the unknown category SPACESHIP (read as objects)", 3)
    );
    assert_eq!(
        categories(["REGULAR_VEHICLE", "SIGN", "REGULAR_VEHICLE", "SIGN", "BUS", "SIGN"]),
        one("boxes of another category than their track", 1)
    );
}

#[test]
fn frames_without_an_ego_pose_are_skipped() {
    let log = TinyAv2::new();
    log.edit(TABLES[1], |columns| columns.iter_mut().for_each(|(_, c)| *c = c.slice(0, 5)));
    // The poses end half a step after the second frame.
    assert_eq!(log.open().unwrap().recording().frames.len(), 2);
    let reported = notes(&log);
    assert_eq!(reported[0], ("annotated times without an ego pose".to_owned(), 1));
    assert_eq!(reported[1], ("images without an ego pose".to_owned(), RING.len()));
    log.edit(TABLES[1], |columns| columns.iter_mut().for_each(|(_, c)| *c = c.slice(0, 1)));
    log.refuses(&["boxes at a time with an ego pose", "none in 6 rows"], TABLES[0]);
    log.edit(TABLES[1], |columns| columns.iter_mut().for_each(|(_, c)| *c = c.slice(0, 0)));
    log.refuses(&["at least one ego pose", "none"], TABLES[1]);
}

/// Without annotations, the frames are at the times of the sweeps.
#[test]
fn sweeps_without_an_ego_pose_are_counted_once() {
    let log = TinyAv2::new();
    log.edit(TABLES[1], |columns| columns.iter_mut().for_each(|(_, c)| *c = c.slice(0, 5)));
    std::fs::remove_file(log.path(TABLES[0])).unwrap();
    assert_eq!(log.open().unwrap().recording().frames.len(), 2);
    let expected = [
        ("images without an ego pose", RING.len()),
        ("logs without annotations", 1),
        ("sweeps without an ego pose", 1),
    ];
    assert_eq!(notes(&log), expected.map(|(kind, count)| (kind.to_owned(), count)));
}

/// A sweep and images between two frames belong to the later frame.
#[test]
fn data_between_frames_belongs_to_the_next_frame() {
    let log = TinyAv2::new();
    let between = frame_ns(1) + STEP_NS / 2 + 3;
    std::fs::copy(log.path(&sweep(0)), log.path(&format!("sensors/lidar/{between}.feather"))).unwrap();
    let camera = "sensors/cameras/ring_front_left";
    std::fs::copy(log.path(&picture(0, "ring_front_left")), log.path(&format!("{camera}/{between}.jpg")))
        .unwrap();
    let dataset = log.open().unwrap();
    let frame = &dataset.recording().frames[2];
    let sweeps: Vec<_> = frame.sweeps.iter().map(|s| (s.t_us, s.is_key)).collect();
    assert_eq!(sweeps, [(frame_ns(2) / 1000, true), (between / 1000, false)]);
    let images: Vec<_> = frame.between_images.iter().map(|i| (i.t_us, i.channel)).collect();
    assert_eq!(images, [(between / 1000, 6)]);
    assert!(frame.images.len() == 7 && frame.images[6].t_us == (frame_ns(2) + IMAGE_NS) / 1000);
    assert!(dataset.recording().notes.is_empty());
}

#[test]
fn damaged_sweeps_and_images_are_named() {
    let log = TinyAv2::new();
    let dataset = log.open().unwrap();
    let record = &dataset.recording().frames[0].sweeps[0];
    let fails = |parts: &[&str]| {
        let message = dataset.read_sweep(record).unwrap_err().to_string();
        assert!(message.ends_with(record.path.to_str().unwrap()), "{message}");
        assert!(parts.iter().all(|part| message.contains(part)), "{message}\nexpected {parts:?}");
    };
    let points = dataset.read_sweep(record).unwrap().points.len();
    let rows = |c: &Columns| c[0].1.len();
    log.edit(&sweep(0), |c| {
        let x = (0..rows(c)).map(|i| if i < 3 { f16::NAN } else { f16::ONE });
        set(c, "x", Arc::new(Float16Array::from_iter_values(x)));
        let z = numbers((0..rows(c)).map(|i| if i == 5 { 1e300 } else { 0.5 }).collect());
        set(c, "z", z);
    });
    let holed = dataset.read_sweep(record).unwrap();
    assert_eq!((holed.points.len(), holed.dropped_non_finite), (points - 4, 4));
    log.edit(&sweep(0), |c| c.retain(|(name, _)| name != "y"));
    fails(&["a column y", "columns x, z, intensity, laser_number, offset_ns"]);
    assert!(dataset.check_sweep(record).unwrap_err().to_string().contains("a column y"));
    log.edit(&sweep(0), |c| set(c, "x", texts(&vec!["1"; rows(c)])));
    fails(&["a column y"]);
    std::fs::copy(log.path(&sweep(1)), log.path(&sweep(0))).unwrap();
    log.edit(&sweep(0), |c| set(c, "x", texts(&vec!["1"; rows(c)])));
    fails(&["numbers in column x", "type Utf8"]);
    log.edit(&sweep(0), |c| c.iter_mut().for_each(|(_, column)| *column = column.slice(0, 0)));
    assert!(dataset.check_sweep(record).unwrap_err().to_string().contains("at least one point, found none"));
    std::fs::write(&record.path, "text").unwrap();
    fails(&["an Arrow file (Feather)", "4 bytes"]);
    std::fs::remove_file(&record.path).unwrap();
    fails(&["cannot read"]);
    let image = &dataset.recording().frames[0].images[0];
    std::fs::write(&image.path, "text").unwrap();
    assert!(dataset.read_image(image).unwrap_err().to_string().contains("a JPEG or PNG image"));
}

/// Changes every byte of a small file in turn: the reader returns points or an error, for every compression.
#[test]
fn no_byte_of_a_feather_file_makes_the_reader_panic() {
    let log = TinyAv2::new();
    let columns: Columns = read(&log.path(&sweep(0))).into_iter().map(|(n, c)| (n, c.slice(0, 40))).collect();
    let path = log.path("small.feather");
    let (mut refused, mut read_on) = (0, 0);
    for compression in [None, Some(CompressionType::LZ4_FRAME), Some(CompressionType::ZSTD)] {
        write(&path, columns.clone(), compression);
        let whole = std::fs::read(&path).unwrap();
        for (place, old) in whole.iter().enumerate() {
            for value in [0, 0x7f, 0xff, old ^ 1] {
                let mut bytes = whole.clone();
                bytes[place] = value;
                std::fs::write(&path, &bytes).unwrap();
                match read_sweep_file(&path) {
                    Ok(sweep) => {
                        assert!(sweep.points.len() + sweep.dropped_non_finite <= 40);
                        read_on += 1;
                    }
                    Err(error) => {
                        assert!(error.to_string().ends_with("small.feather"), "{error}");
                        refused += 1;
                    }
                }
            }
        }
    }
    assert!(refused > 1000 && read_on > 1000, "{refused} refused, {read_on} read");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// The reader returns a log or an error for any table content.
    #[test]
    fn no_table_makes_the_reader_panic(
        table in 0..TABLES.len(),
        places in proptest::collection::vec((any::<prop::sample::Index>(), any::<[u8; 4]>()), 1..5),
        from_the_end in any::<bool>(),
    ) {
        thread_local!(static LOG: TinyAv2 = TinyAv2::new());
        LOG.with(|log| {
            let path = log.path(TABLES[table]);
            let whole = std::fs::read(&path).unwrap();
            let mut bytes = whole.clone();
            for (place, value) in places {
                // The footer, which holds all offsets, gets half of the changes.
                let span = if from_the_end { bytes.len().min(900) } else { bytes.len() };
                let place = bytes.len() - span + place.index(span - 4);
                bytes[place..place + 4].copy_from_slice(&value);
            }
            std::fs::write(&path, &bytes).unwrap();
            let opened = log.open();
            std::fs::write(&path, &whole).unwrap();
            if let Err(error) = opened {
                assert!(error.to_string().ends_with(".feather"), "{error}");
            }
        });
    }
}
