//! Sweep files of other writers, and sweep files without content.

use std::path::Path;
use std::sync::Arc;

use point_skeleton::dataset::nuscenes::read_sweep_file;
use point_skeleton::dataset::{LogReader, Sweep};
use pskel_testing::av2_log::{self, TinyAv2};
use pskel_testing::nuplan_log::{NuplanLog, sweep_file};

fn bytes(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// A file that was cut off, and filled with zeros behind its header.
#[test]
fn headers_without_points_are_damaged_files() {
    let made = NuplanLog::new();
    let path = made.blob(&sweep_file(0));
    let mut bytes = std::fs::read(&path).unwrap();
    let end = b"DATA binary\n";
    let start = bytes.windows(end.len()).position(|part| part == end).unwrap() + end.len();
    bytes[start..].fill(0);
    std::fs::write(&path, bytes).unwrap();
    let dataset = made.open().unwrap();
    let error = dataset.read_sweep(&dataset.recording().frames[0].sweeps[0]).unwrap_err();
    assert!(error.is_damage() && error.to_string().contains("points at the origin"), "{error}");
}

/// Only coordinates are needed, and a row without them is not a point.
#[test]
fn argoverse_sweeps_need_only_coordinates() {
    use arrow_array::Float32Array;
    let log = TinyAv2::new();
    let dataset = log.open().unwrap();
    let record = dataset.recording().frames[0].sweeps[0].clone();
    let before = dataset.read_sweep(&record).unwrap();
    for column in ["intensity", "laser_number"] {
        log.edit(&av2_log::sweep(0), |columns| columns.retain(|(name, _)| name != column));
        let sweep = dataset.read_sweep(&record).unwrap();
        let positions = |sweep: &Sweep| sweep.points.iter().map(|p| p.position).collect::<Vec<_>>();
        assert_eq!(positions(&sweep), positions(&before));
        assert_eq!(sweep.notes[&format!("sweeps without a column {column} (read as 0)")], 1);
        assert_eq!(dataset.check_sweep(&record).unwrap(), Some(before.points.len() as u64));
    }
    let rows = before.points.len();
    log.edit(&av2_log::sweep(0), |columns| {
        let x: Float32Array = (0..rows).map(|i| (i % 4 > 0).then_some(i as f32)).collect();
        av2_log::set(columns, "x", Arc::new(x));
    });
    let sweep = dataset.read_sweep(&record).unwrap();
    assert_eq!(sweep.dropped_non_finite, rows.div_ceil(4));
    assert_eq!(sweep.points.len(), rows - rows.div_ceil(4));
    log.edit(&av2_log::sweep(0), |columns| columns.retain(|(name, _)| name != "z"));
    let message = dataset.read_sweep(&record).unwrap_err().to_string();
    assert!(message.contains("expected a column z") && message.contains(".feather"), "{message}");
}

#[test]
fn pcd_files_of_other_writers_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pcd.bin");
    let read = |path: &Path, fields: &str, size: usize, data: &str, points: &[u8]| {
        let header = format!(
            "VERSION 0.7\nFIELDS {fields}\nSIZE {size} {size} {size} 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH \
                2\nHEIGHT 1\n\
             POINTS 2\nDATA {data}\n"
        );
        std::fs::write(path, [header.as_bytes(), points].concat()).unwrap();
        read_sweep_file(path).unwrap()
    };
    let plain = read(&path, "x y z intensity", 4, "binary", &bytes([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]));
    let wide: Vec<u8> = [[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]]
        .into_iter()
        .flat_map(|row| {
            let position = row[..3].iter().flat_map(|v: &f64| v.to_le_bytes());
            position.chain((row[3] as f32).to_le_bytes()).collect::<Vec<u8>>()
        })
        .collect();
    assert_eq!(read(&path, "x y z intensity", 8, "binary", &wide), plain);
    let text = b"1 2 3 4\n5 6 7 8\n";
    assert_eq!(read(&path, "X Y Z Intensity", 4, "ASCII", text), plain);
    let holed = read(&path, "x y z intensity", 4, "ascii", b"1 2 3 4\n-nan(ind) 6 7 8\n");
    assert_eq!((holed.points.len(), holed.dropped_non_finite), (1, 1));
}
