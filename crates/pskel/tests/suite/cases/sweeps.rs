//! Sweeps of strangers: columns that look like others, flags that look like LiDARs, files without content.

use std::path::PathBuf;

use point_skeleton::dataset::nuscenes::{NuScenes, read_sweep_file};
use point_skeleton::dataset::{LogLocator, LogReader};
use serde_json::Value;

use super::Case;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, sweep};
use pskel_testing::shared::shared;

type Row = [f32; 5];

/// Sweep files of a case's log `b`, with the rows of the recording that belong to them.
struct Sweeps {
    case: Case,
    files: Vec<(PathBuf, Vec<Row>)>,
}

impl Sweeps {
    /// Returns the log with every `step`-th row of the recording; `None` without recordings.
    fn new(step: usize) -> Option<Self> {
        let case = Case::new("data/01-ring-is-constant")?;
        let recorded = shared("the recording")?.join("data/pandaset-002/nuscenes/samples/LIDAR_TOP");
        let folder = case.path().join("in/b/samples/LIDAR_TOP");
        let mut names: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        let rows = |bytes: Vec<u8>| {
            let row = |row: &[u8; 20]| {
                let (values, _) = row.as_chunks::<4>();
                std::array::from_fn(|i| f32::from_le_bytes(values[i]))
            };
            bytes.as_chunks::<20>().0.iter().step_by(step).map(row).collect()
        };
        let file = |name| (folder.join(&name), rows(std::fs::read(recorded.join(&name)).unwrap()));
        let files = names.into_iter().map(file).collect();
        Some(Self { case, files })
    }

    /// Writes all sweeps. `change` gets the rows of a file.
    fn write(&self, change: impl Fn(&[Row]) -> Vec<u8>) {
        self.files.iter().for_each(|(path, rows)| std::fs::write(path, change(rows)).unwrap());
    }

    /// Builds the log, and returns its counts with notes, and the checksums of its points.
    #[track_caller]
    fn build(&self) -> (Value, Value) {
        let _ = std::fs::remove_dir_all(self.case.path().join("sk"));
        self.case.succeed("build nuscenes:in/b --out sk");
        let mut skeleton = self.case.json("sk/skeleton.json");
        let notes = skeleton["report"]["notes"].take();
        (serde_json::json!([skeleton["report"], skeleton["background"], skeleton["actors"]]), notes)
    }

    /// Asserts that the layout of the sweeps is refused by `info` and `build`, naming what was found.
    #[track_caller]
    fn assert_refused(&self, found: &str) {
        let info = self.case.run("info nuscenes:in/b");
        assert_eq!(info.code, Some(1), "{}", info.stdout);
        assert!(info.stdout.contains(found), "{}", info.stdout);
        let build = self.case.run("build nuscenes:in/b --out none");
        assert_eq!(build.code, Some(1));
        assert!(build.stderr.contains(found), "{}", build.stderr);
    }
}

fn bytes(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

#[test]
fn flags_of_one_lidar_keep_all_points_and_are_noted() {
    let Some(sweeps) = Sweeps::new(3) else { return };
    let write = |flag: &dyn Fn(&Row) -> f32| {
        let one = |rows: &[Row]| rows.iter().filter(|row| row[4] == 0.0).copied().collect::<Vec<Row>>();
        sweeps.write(|rows| bytes(one(rows).iter().flat_map(|r| [r[0], r[1], r[2], r[3], flag(r)])));
    };
    write(&|_| 0.0);
    let (right, _) = sweeps.build();
    let is = |yes: bool| f32::from(u8::from(yes));
    let flags: [&dyn Fn(&Row) -> f32; 6] = [
        &|row| is(row[0].hypot(row[1]) > 20.0),
        &|row| is(row[0] > 0.0),
        &|row| is(row[1].atan2(row[0]).abs() < 1.0),
        &|row| is(row[2] < -1.5),
        &|row| is(row[3] > 20.0),
        &|row| if row[2] < -1.3 { 0.0 } else { 1.0 + is(row[1].abs() > 10.0) },
    ];
    for (k, flag) in flags.iter().enumerate() {
        write(*flag);
        let (points, notes) = sweeps.build();
        assert_eq!(points, right, "{k}");
        let note =
            "sweeps with few ring numbers, read as beams (--ring-is device if they number merged LiDARs)";
        assert_eq!(notes[note], sweeps.files.len(), "{k}: {notes}");
    }
}

/// One decision for the sweeps of a log, which a build tells too.
#[test]
fn merged_lidars_are_detected_once_per_log() {
    let Some(sweeps) = Sweeps::new(2) else { return };
    sweeps.write(|rows| bytes(rows.iter().flatten().copied()));
    // Few points of the second LiDAR say nothing on their own.
    let (path, rows) = &sweeps.files[1];
    let retained = rows.iter().enumerate().filter(|(k, row)| row[4] == 0.0 || k % 500 == 0);
    std::fs::write(path, bytes(retained.flat_map(|(_, row)| *row))).unwrap();
    let alone = read_sweep_file(path).unwrap();
    assert!(!alone.devices && alone.notes.keys().any(|note| note.contains("few ring numbers")));
    let locator =
        LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, sweeps.case.path().join("in/b"));
    let dataset = NuScenes::open(&locator).unwrap();
    let read = |record| dataset.read_sweep(record).unwrap().devices;
    assert!(dataset.recording().frames.iter().flat_map(|frame| &frame.sweeps).all(read));
    let (_, notes) = sweeps.build();
    assert_eq!(notes["sweeps of merged LiDARs (--ring-is beam if not)"], 4, "{notes}");
}

#[test]
fn rows_of_zeros_do_not_decide_the_layout() {
    let Some(sweeps) = Sweeps::new(8) else { return };
    let four = |row: &Row| [row[0], row[1], row[2], row[3]];
    sweeps.write(|rows| bytes(rows.iter().flat_map(four)));
    let (right, _) = sweeps.build();
    let actors = &right[2];
    for zeros in [3500, 20_000] {
        sweeps.write(|rows| bytes(vec![0.0; 4 * zeros].into_iter().chain(rows.iter().flat_map(four))));
        let (points, notes) = sweeps.build();
        assert_eq!(&points[2], actors);
        assert_eq!(notes["sweeps of four columns (x y z intensity), without rings"], 4, "{notes}");
    }
    let row =
        |k: usize, row: &Row| if k.wrapping_mul(0x9E37_79B9) >> 3 & 7 == 0 { four(row) } else { [0.0; 4] };
    sweeps.write(|rows| bytes(rows.iter().enumerate().flat_map(|(k, r)| row(k, r))));
    let (_, notes) = sweeps.build();
    assert_eq!(notes["sweeps of four columns (x y z intensity), without rings"], 4, "{notes}");
    sweeps.write(|rows| {
        let points = rows.iter().flat_map(|row| row.iter().copied().chain([0.05]));
        bytes(vec![0.0; 6 * 4096].into_iter().chain(points))
    });
    sweeps.assert_refused("repeat every 6 floats");
    sweeps.write(|rows| {
        let points = rows.iter().flatten().flat_map(|v| f64::from(*v).to_le_bytes());
        vec![0; 40 * 4096].into_iter().chain(points).collect()
    });
    sweeps.assert_refused("floats of 8 bytes");
}

#[test]
fn wide_rows_are_not_read_as_several_points() {
    let Some(sweeps) = Sweeps::new(8) else { return };
    type More<'a> = &'a dyn Fn(usize, &Row) -> Vec<f32>;
    let kinds: [(More<'_>, usize); 5] = [
        (&|_, row| row.to_vec(), 10),
        (&|k, _| vec![k as f32 * 1e-5, 1.0, 0.0, 0.0, 17.0], 10),
        (&|_, row| vec![row[0] * 0.9, row[1] * 0.9, row[2], 5.0, row[4]], 10),
        (&|k, _| vec![(20 + k % 30) as f32, 5.0, 3.0, 1.0, 2.0], 10),
        (&|_, row| [*row, *row].concat(), 15),
    ];
    for (more, columns) in kinds {
        sweeps.write(|rows| {
            bytes(rows.iter().enumerate().flat_map(|(k, r)| [r.to_vec(), more(k, r)].concat()))
        });
        sweeps.assert_refused(&format!("repeat every {columns} floats"));
    }
}

#[test]
fn sweeps_without_content_are_damaged_files() {
    let text: &[u8] = b"404: File not found\n";
    let bom: &[u8] = b"\xef\xbb\xbf404: Not Found   ";
    for (content, found) in [
        (vec![0; 20_000], "zero bytes (a download that was cut off?)"),
        (bytes([f32::NAN; 5000]), "nothing but the value NaN"),
        (vec![0xff; 20_000], "nothing but the value NaN"),
        (
            bytes([f32::NAN, 1.0, 2.0, 3.0, 4.0].repeat(3)),
            "points with finite coordinates, found none in 3 rows",
        ),
        (text.to_vec(), "text that begins with \"404: File not found\""),
        (bom.to_vec(), "text that begins with \"404: Not Found"),
        (b"404: Not Found".to_vec(), "text that begins with \"404: Not Found\""),
        (vec![b' '; 20], "text that begins with \"\""),
    ] {
        let log = TinyLog::new();
        std::fs::write(log.path(&sweep(1)), content).unwrap();
        let info = log.run("info --json nuscenes:log");
        assert_eq!(info.status.code(), Some(1), "{found}");
        let reported: Value = serde_json::from_slice(&info.stdout).unwrap();
        let damaged = reported["damaged"][0].as_str().unwrap();
        assert!(damaged.contains(found) && damaged.contains("1.pcd.bin"), "{damaged}");
        log.succeed("build nuscenes:log --out out/sk");
        assert_eq!(log.json("out/sk/skeleton.json")["report"]["notes"]["damaged sweep files"], 1);
        let refused = log.run("build nuscenes:log --out out/none --missing error");
        assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains(found));
    }
}
