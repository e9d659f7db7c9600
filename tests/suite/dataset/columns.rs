//! Columns of sweeps beside the coordinates.

use std::path::Path;
use std::sync::Arc;

use point_skeleton::dataset::nuscenes::{read_sweep_file, write_sweep_file};
use point_skeleton::dataset::{LogReader, Sweep, SweepPoint};
use pskel_testing::av2_log::{self, TinyAv2};
use pskel_testing::nuplan_log::{self, NuplanLog, sweep_file};

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Empty values of a table are null or NaN, depending on the writer.
#[test]
fn argoverse_sweeps_keep_points_without_intensities_or_beams() {
    use arrow_array::{Float32Array, UInt8Array};
    let log = TinyAv2::new();
    let dataset = log.open().unwrap();
    let record = dataset.recording().frames[0].sweeps[0].clone();
    let before = dataset.read_sweep(&record).unwrap();
    let rows = before.points.len();
    for (null, intensity) in [(true, None), (false, Some(f32::NAN))] {
        log.edit(&av2_log::sweep(0), |columns| {
            let beams: UInt8Array = (0..rows).map(|i| (!null || i % 2 == 0).then_some(7)).collect();
            let intensities: Float32Array = (0..rows).map(|_| intensity).collect();
            av2_log::set(columns, "intensity", Arc::new(intensities));
            av2_log::set(columns, "laser_number", Arc::new(beams));
        });
        let sweep = dataset.read_sweep(&record).unwrap();
        let positions = |sweep: &Sweep| sweep.points.iter().map(|p| p.position).collect::<Vec<_>>();
        assert_eq!((positions(&sweep), sweep.dropped_non_finite), (positions(&before), 0));
        assert!(sweep.points.iter().all(|p| p.intensity == 0.0));
        let noted: Vec<usize> = sweep.notes.into_values().collect();
        assert_eq!(noted, if null { vec![rows, rows / 2] } else { vec![rows] });
    }
}

/// Reads the first sweep of a nuPlan log.
fn read(made: &NuplanLog) -> Result<Sweep, String> {
    let dataset = made.open().unwrap();
    dataset.read_sweep(&dataset.recording().frames[0].sweeps[0]).map_err(|error| error.to_string())
}

/// Writes a PCD file with a device column in place of a nuPlan sweep, with points around the LiDAR.
fn write_devices(path: &Path, device: impl Fn(usize) -> u8) {
    let n = 32 * 400;
    let header = format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity lidar_info ring\nSIZE 4 4 4 1 1 1\nTYPE F F F U U \
            U\n\
         COUNT 1 1 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    );
    let mut file = header.into_bytes();
    for k in 0..n {
        let (beam, turn) = ((k % 32) as f32, (k / 32) as f32 / 400.0 * std::f32::consts::TAU);
        let (sin, cos) = turn.sin_cos();
        file.extend(bytes(&[20.0 * cos, 20.0 * sin, (beam - 20.0) * 0.4]));
        file.extend([9, device(k), beam as u8]);
    }
    std::fs::write(path, file).unwrap();
}

#[test]
fn pcd_device_columns_are_used_unless_they_contain_beams() {
    let made = NuplanLog::new();
    let check = |device: &dyn Fn(usize) -> u8| {
        // The sweeps of a log are judged together.
        (0..nuplan_log::FRAMES).for_each(|frame| write_devices(&made.blob(&sweep_file(frame)), device));
        let sweep = read(&made).unwrap();
        let rings = sweep.points.iter().map(|p| p.ring).max().unwrap();
        (sweep.devices, rings, sweep.notes.into_keys().collect::<Vec<_>>().join(";"))
    };
    assert_eq!(check(&|_| 1), (false, 31, String::new()));
    // Halves of the scene.
    let merged = "sweeps of merged LiDARs (--ring-is beam if not)".to_owned();
    assert_eq!(check(&|k| if k < 6400 { 0 } else { 4 }), (true, 4, merged));
    for beams in [&(|k: usize| (k % 32) as u8) as &dyn Fn(usize) -> u8, &|k: usize| (k % 4) as u8] {
        let (devices, rings, notes) = check(beams);
        assert_eq!((devices, rings), (false, 31));
        assert!(notes.contains("lidar_info numbers beams"), "{notes}");
    }
}

/// A sweep that was written is read again with the same values, with and without a header.
#[test]
fn written_sweeps_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pcd.bin");
    let point = |k: usize| SweepPoint {
        position: [k as f32 * 0.1, -(k as f32) * 0.05, (k % 7) as f32 - 2.0],
        intensity: (k % 200) as f32,
        ring: (k % 32) as u16,
    };
    let points: Vec<SweepPoint> = (0..900).map(point).collect();
    write_sweep_file(&path, &points).unwrap();
    let sweep = read_sweep_file(&path).unwrap();
    assert_eq!((sweep.points, sweep.devices, sweep.notes.len()), (points, false, 0));
}
