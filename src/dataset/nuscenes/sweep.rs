//! `.pcd.bin`: sweeps as rows of five little-endian `f32`: x, y, z (meters, LiDAR frame), intensity, ring.

use std::io::Write;
use std::path::Path;

use crate::dataset::{Sweep, SweepPoint};
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, read_file};
use crate::files::write_whole;

/// Bytes per point in a `.pcd.bin` file.
pub const POINT_BYTES: usize = 20;

/// Reads a `.pcd.bin` file.
///
/// # Errors
/// Fails if the file is missing or empty, or its length is not a multiple of [`POINT_BYTES`].
pub fn read_sweep_file(path: &Path) -> Result<Sweep, FileError> {
    let bytes = read_file(path, SWEEP_BYTES)?;
    parse_sweep(&bytes, path)
}

/// Parses the bytes of a `.pcd.bin` file; `path` is for messages. Drops and counts points with a NaN or infinite
/// number, and clamps rings to `u16`.
///
/// # Errors
/// Fails if the input is empty or its length is not a multiple of [`POINT_BYTES`].
pub fn parse_sweep(bytes: &[u8], path: &Path) -> Result<Sweep, FileError> {
    check_sweep_len(bytes.len() as u64, path)?;
    let mut sweep = Sweep { points: Vec::with_capacity(bytes.len() / POINT_BYTES), ..Sweep::default() };
    let (rows, _) = bytes.as_chunks::<POINT_BYTES>();
    for row in rows {
        let (numbers, _) = row.as_chunks::<4>();
        let value = |i: usize| f32::from_le_bytes(numbers[i]);
        if (0..5).all(|i| value(i).is_finite()) {
            let position = [value(0), value(1), value(2)];
            sweep.points.push(SweepPoint { position, intensity: value(3), ring: value(4) as u16 });
        } else {
            sweep.dropped_non_finite += 1;
        }
    }
    sweep.devices = names_devices(&sweep.points);
    Ok(sweep)
}

/// Returns whether the ring column identifies merged LiDARs instead of beams: a spinning LiDAR has at least four
/// beams.
fn names_devices(points: &[SweepPoint]) -> bool {
    let last = points.iter().map(|p| p.ring).max();
    last.is_some_and(|last| (1..4).contains(&last))
}

/// Returns the number of points in a file of this many bytes.
///
/// # Errors
/// Fails if the length is zero or not a multiple of [`POINT_BYTES`].
pub(crate) fn check_sweep_len(bytes: u64, path: &Path) -> Result<u64, FileError> {
    if bytes == 0 {
        return Err(FileError::content("at least one point of 20 bytes", "an empty file", path));
    }
    if !bytes.is_multiple_of(POINT_BYTES as u64) {
        let expected = "a multiple of 20 bytes (x y z intensity ring as f32)";
        return Err(FileError::content(expected, format!("{bytes} bytes"), path));
    }
    Ok(bytes / POINT_BYTES as u64)
}

/// Writes a `.pcd.bin` file.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_sweep_file(path: &Path, points: &[SweepPoint]) -> Result<(), FileError> {
    write_whole(path, |writer| {
        for point in points {
            let [x, y, z] = point.position;
            let row = [x, y, z, point.intensity, f32::from(point.ring)].map(f32::to_le_bytes);
            writer.write_all(row.as_flattened()).map_err(FileError::io("write", path))?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_sweep_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd.bin");
        let point = SweepPoint { position: [1.5, -2.25, 0.125], intensity: 17.0, ring: 31 };
        write_sweep_file(&path, &[point, point]).unwrap();
        assert_eq!(read_sweep_file(&path).unwrap().points, [point, point]);
    }

    #[test]
    fn few_ring_numbers_are_devices() {
        let rings = |rings: &[u16]| {
            let point = |&ring: &u16| [0.0, 0.0, 0.0, 0.0, f32::from(ring)].map(f32::to_le_bytes);
            let bytes: Vec<u8> = rings.iter().flat_map(point).flatten().collect();
            parse_sweep(&bytes, Path::new("a.pcd.bin")).unwrap().devices
        };
        assert!(rings(&[0, 1, 1]));
        assert!(!rings(&[0, 0]) && !rings(&[0, 1, 31]));
    }

    #[test]
    fn not_finite_is_dropped_and_counted() {
        let rows: [[f32; 5]; 4] = [
            [1.0, 2.0, 3.0, 4.0, 5.0],
            [f32::NAN, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, f32::INFINITY, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, f32::NAN],
        ];
        let bytes: Vec<u8> = rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let sweep = parse_sweep(&bytes, Path::new("a.pcd.bin")).unwrap();
        assert_eq!((sweep.points.len(), sweep.dropped_non_finite), (1, 3));
        assert_eq!(sweep.points[0].ring, 5);
    }

    proptest! {
        #[test]
        fn any_bytes_are_points_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            match parse_sweep(&bytes, Path::new("a.pcd.bin")) {
                Ok(s) => prop_assert_eq!(s.points.len() + s.dropped_non_finite, bytes.len() / POINT_BYTES),
                Err(e) => {
                    prop_assert!(bytes.is_empty() || bytes.len() % POINT_BYTES != 0);
                    prop_assert!(e.to_string().ends_with(": a.pcd.bin"));
                }
            }
        }
    }
}
