//! Images and sweeps that are missing or damaged, in cells and in files that cells name.

use arrow_array::ArrayRef;
use point_skeleton::dataset::py123d::Py123d;
use point_skeleton::dataset::{DatasetError, LogLocator, LogReader};
use pskel_testing::py123d_log::{
    FRAMES, FRONT, LEFT, LIDAR, MAP, SYNC, TinyPy123d, assert_message, binaries, image, picture, sweep, texts,
};

/// Cells of which the one in row 1 is another.
fn cells<'a>(other: Option<&'a [u8]>, cell: &'a [u8]) -> ArrayRef {
    binaries([Some(cell), other, Some(cell), Some(cell)])
}

fn png(height: u32, width: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(width, height).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn images_in_cells_may_be_damaged() {
    let whole = png(48, 64);
    let (other, cut) = (png(32, 64), &whole[..whole.len() / 2]);
    for (cell, parts) in [
        (None, &["expected data in row 1 of column camera.pcam_f0.data", "found none"][..]),
        (Some(&b""[..]), &["a JPEG or PNG image in row 1", "found an empty file"]),
        (Some(b"no image"), &["a JPEG or PNG image in row 1", "text that begins with \"no image\""]),
        (Some(cut), &["image in row 1", "cut off"]),
        (Some(&other), &["48x64", "in row 1", "found 32x64"]),
    ] {
        let mut made = TinyPy123d::new();
        made.edit(FRONT, |table| table.set("data", cells(cell, &whole)));
        let reader = made.open().unwrap();
        for (index, frame) in reader.recording().frames.iter().enumerate() {
            let (check, read) = (reader.check_image(&frame.images[0]), reader.read_image(&frame.images[0]));
            if index == 1 {
                assert_message(&check.unwrap_err(), parts, "/camera.pcam_f0.arrow");
                assert_message(&read.unwrap_err(), parts, "/camera.pcam_f0.arrow");
            } else {
                check.unwrap();
                assert_eq!(read.unwrap().dimensions(), (64, 48));
            }
        }
    }
}

#[test]
fn sweeps_in_cells_may_be_damaged() {
    let whole = sweep(0, 9);
    for (cell, parts) in [
        (None, &["expected data in row 1 of column lidar.lidar_merged.data", "found none"][..]),
        (Some(&b""[..]), &["a sweep in row 1", "found an empty file"]),
        (Some(b"12345"), &["a sweep in row 1", "found 5 bytes of an unknown codec"]),
        (Some(b"\xff\xd8\xff\xe0"), &["a sweep in row 1", "found a JPEG image"]),
        (Some(&whole[..60]), &["a sweep in row 1", "cut off"]),
    ] {
        let mut made = TinyPy123d::new();
        made.edit(LIDAR, |table| table.set("data", cells(cell, &whole)));
        let reader = made.open().unwrap();
        for (index, frame) in reader.recording().frames.iter().enumerate() {
            let (check, read) = (reader.check_sweep(&frame.sweeps[0]), reader.read_sweep(&frame.sweeps[0]));
            if index == 1 {
                assert_message(&check.unwrap_err(), parts, "/lidar.lidar_merged.arrow");
                assert_message(&read.unwrap_err(), parts, "/lidar.lidar_merged.arrow");
            } else {
                assert_eq!((check.unwrap(), read.unwrap().points.len()), (Some(9), 9));
            }
        }
    }
}

/// Returns the log whose table of paths has another one in row 1.
fn with_path(path: Option<&str>) -> TinyPy123d {
    let mut made = TinyPy123d::new();
    let names: Vec<String> = (0..FRAMES).map(picture).collect();
    let rows = names.iter().enumerate().map(|(row, name)| if row == 1 { path } else { Some(name.as_str()) });
    made.edit(LEFT, |table| table.set("data", texts(rows)));
    made
}

#[test]
fn paths_must_stay_below_the_root() {
    let outside = tempfile::tempdir().unwrap();
    let absolute = outside.path().join("image.png");
    image(2).save(&absolute).unwrap();
    for path in ["../image.png", "samples/../../image.png", absolute.to_str().unwrap(), "..", "", ".", "a\0b"]
    {
        let made = with_path(Some(path));
        made.refuses(&["expected ", &format!("found {path:?} in row 1")], "/camera.pcam_l0.arrow");
        let result = Py123d::open(&LogLocator { allow_outside: true, ..made.locator() });
        if path.ends_with("image.png") {
            image(2).save(made.root().join("image.png")).unwrap();
            let reader = Py123d::open(&LogLocator { allow_outside: true, ..made.locator() }).unwrap();
            let found = reader.read_image(&reader.recording().frames[1].images[1]).unwrap();
            assert_eq!(found, image(2));
        } else {
            let expected: &[&str] =
                if path == ".." { &["name of a file"] } else { &["expected the name of a file"] };
            assert_message(&result.err().unwrap(), expected, "/camera.pcam_l0.arrow");
        }
    }
}

#[test]
fn missing_paths_and_files_are_counted() {
    for (path, note) in
        [(None, "images without data or pose"), (Some("samples/no.png"), "missing image files")]
    {
        let reader = with_path(path).open().unwrap();
        let log = reader.recording();
        assert_eq!(log.notes[note], 1, "{:?}", log.notes);
        let images: Vec<usize> = log.frames.iter().map(|frame| frame.images.len()).collect();
        assert_eq!((images, log.gaps.len()), (vec![2, 1, 2, 2], 1));
    }
}

/// Opens a log of a data set without a folder of sensors.
fn without_root(dataset: &str, made: &mut TinyPy123d) -> Result<Py123d, DatasetError> {
    made.edit(SYNC, |table| table.about(|about| about["dataset"] = dataset.into()));
    Py123d::open(&LogLocator { sensor_root: None, ..made.locator() })
}

#[test]
fn paths_need_a_folder() {
    let mut made = TinyPy123d::new();
    for (dataset, expected) in [
        ("truckdrive", "--sensor-root or the variable TRUCKDRIVE_DATA_ROOT: the folder of the files"),
        ("wod_perception", "--sensor-root or the variable WOD_PERCEPTION_DATA_ROOT: the folder"),
        ("nuplan", "--sensor-root or the variable NUPLAN_SENSOR_ROOT or NUPLAN_DATA_ROOT: the folder"),
        ("mine", "expected --sensor-root: the folder of the files that the table names"),
    ] {
        let error = without_root(dataset, &mut made).err().unwrap();
        assert_message(&error, &[expected, "found neither"], "/camera.pcam_l0.arrow");
    }
    // A log without paths needs none.
    std::fs::remove_file(made.path(LEFT)).unwrap();
    let reader = without_root("mine", &mut made).unwrap();
    assert_eq!(reader.recording().cameras, ["PCAM_F0"]);
    for folder in ["none", "logs/made_train/2026.01.02.made/sync.arrow"] {
        let sensor_root = Some(made.root().join(folder));
        let ending = folder.rsplit('/').next().unwrap();
        assert_message(
            &Py123d::open(&LogLocator { sensor_root, ..made.locator() }).err().unwrap(),
            &[],
            ending,
        );
    }
}

#[test]
fn maps_of_places_are_found() {
    let mut made = TinyPy123d::new();
    std::fs::remove_file(made.path(MAP)).unwrap();
    let lanes = |locator: &LogLocator| {
        Ok::<_, DatasetError>(Py123d::open(locator)?.read_map()?.map(|map| map.lanes.len()))
    };
    let put = |folder: &str| {
        let path = made.root().join(folder).join("nuscenes/nuscenes_nowhere.arrow");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        made.tables[MAP].write(&path).unwrap();
    };
    let other = |folder: &str| LogLocator { map_root: Some(made.root().join(folder)), ..made.locator() };
    assert_eq!(lanes(&made.locator()).unwrap(), None);
    std::fs::create_dir_all(made.root().join("elsewhere")).unwrap();
    let error = lanes(&other("elsewhere")).unwrap_err();
    assert_message(&error, &["expected a map of the place, found none"], "nuscenes/nuscenes_nowhere.arrow");
    assert_message(&lanes(&other("nothing")).unwrap_err(), &["cannot read"], "/nothing");
    put("elsewhere");
    assert_eq!((lanes(&other("elsewhere")).unwrap(), lanes(&made.locator()).unwrap()), (Some(1), None));
    put("maps");
    assert_eq!(lanes(&made.locator()).unwrap(), Some(1));
    made.edit(SYNC, |table| table.about(|about| about["location"] = serde_json::Value::Null));
    assert_eq!(lanes(&made.locator()).unwrap(), None);
}
