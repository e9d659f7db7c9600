//! Sweep files: `.pcd.bin` files are rows of five little-endian `f32` without a header: x, y, z (meters,
//! LiDAR frame), intensity, ring. Other data sets in this layout have PCD files, or no rings.

use std::io::Write;
use std::os::unix::fs::FileExt;
use std::path::Path;

use super::sweep_info::SweepInfo;
use crate::dataset::sweeps::pcd::{HEAD_BYTES, check_pcd, pcd_rows};
use crate::dataset::sweeps::{ReadAt, SweepRow, SweepRows, columns, is_pcd, named_format};
use crate::dataset::{RingMeaning, Sweep, SweepPoint};
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, open_up_to, read_file};
use crate::files::write_whole;

/// Bytes per point in a `.pcd.bin` file.
pub const POINT_BYTES: usize = 20;

/// Note for sweeps whose description is missing.
const NO_INFO: &str = "sweeps whose info_filename does not exist (columns judged by their values)";

/// Note for sweeps of four columns.
const NO_RING: &str = "sweeps of four columns (x y z intensity), without rings";

/// Reads a sweep file: rows without a header, of five columns or of four (without rings), or a PCD file,
/// whatever its name.
///
/// # Errors
/// Fails if the file is missing or empty, or has another format or layout. Fails if no point has finite
/// coordinates, or all are at the origin.
pub fn read_sweep_file(path: &Path) -> Result<Sweep, FileError> {
    read_rows(path, None)?.finish(RingMeaning::Auto, path)
}

/// Reads the points of a sweep file. `info` is the path of the file that describes it.
///
/// # Errors
/// Fails as [`read_sweep_file`], except that points may be missing. Fails if the description cannot be read
/// or contradicts the length of the file.
pub(in crate::dataset) fn read_rows(path: &Path, info: Option<&Path>) -> Result<SweepRows, FileError> {
    let known = info.map_or(Ok(None), SweepInfo::read)?;
    let mut rows = parse_rows(&read_file(path, SWEEP_BYTES)?, known.as_ref(), path)?;
    if info.is_some() && known.is_none() {
        rows.note(NO_INFO);
    }
    Ok(rows)
}

/// Parses the bytes of a sweep file; `path` is for messages. Drops and counts points with a NaN or infinite
/// coordinate.
///
/// # Errors
/// Fails as [`read_sweep_file`].
pub fn parse_sweep(bytes: &[u8], path: &Path) -> Result<Sweep, FileError> {
    parse_rows(bytes, None, path)?.finish(RingMeaning::Auto, path)
}

fn parse_rows(bytes: &[u8], info: Option<&SweepInfo>, path: &Path) -> Result<SweepRows, FileError> {
    let source = |row: usize| info.and_then(|info| info.source(row));
    if is_pcd(bytes) {
        return pcd_rows(bytes, source, path);
    }
    // The layout asks for bytes within the file only.
    let read = |start: u64, length: usize| Ok(bytes[start as usize..start as usize + length].to_vec());
    let columns = columns_of(bytes, &read, bytes.len() as u64, info, path)?;
    let mut sweep = SweepRows::with_capacity(bytes.len() / (4 * columns));
    for (number, row) in bytes.chunks_exact(4 * columns).enumerate() {
        let (numbers, _) = row.as_chunks::<4>();
        let value = |i: usize| numbers.get(i).map_or(0.0, |bytes| f32::from_le_bytes(*bytes));
        let (position, intensity, ring) = ([value(0), value(1), value(2)], value(3), f64::from(value(4)));
        sweep.push_of(SweepRow { position, intensity, ring, device: None }, source(number));
    }
    if 4 * columns < POINT_BYTES {
        sweep.note(NO_RING);
    }
    Ok(sweep)
}

/// Returns the column count of rows without a header, in a file with `length` bytes that begins with `head`:
/// the one in its description, or the one that its values have.
fn columns_of(
    head: &[u8],
    read: &ReadAt<'_>,
    length: u64,
    info: Option<&SweepInfo>,
    path: &Path,
) -> Result<usize, FileError> {
    if let Some(found) = named_format(head) {
        let expected = "rows of floats (x y z intensity ring) or a PCD file";
        return Err(FileError::content(expected, found, path));
    }
    let Some(stated) = info.and_then(|info| info.columns).filter(|_| length > 0) else {
        return columns(read, length, path);
    };
    if !length.is_multiple_of(4 * stated as u64) {
        let expected = format!("a multiple of {} bytes (num_pts_feats {stated})", 4 * stated);
        return Err(FileError::content(expected, format!("{length} bytes"), path));
    }
    Ok(stated)
}

/// Returns the number of points in a file from its size and parts of it.
///
/// # Errors
/// Fails as [`read_rows`], except for errors in the points themselves.
pub(in crate::dataset) fn check(path: &Path, info: Option<&Path>) -> Result<u64, FileError> {
    let info = info.map_or(Ok(None), SweepInfo::read)?;
    let (file, length) = open_up_to(path, SWEEP_BYTES)?;
    let read = |start: u64, length: usize| {
        let mut bytes = vec![0; length];
        file.read_exact_at(&mut bytes, start).map_err(FileError::io("read", path))?;
        Ok(bytes)
    };
    let head = read(0, length.min(HEAD_BYTES) as usize)?;
    if is_pcd(&head) {
        return check_pcd(&head, length, path);
    }
    Ok(length / (4 * columns_of(&head, &read, length, info.as_ref(), path)? as u64))
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
    fn a_written_sweep_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd.bin");
        let point = SweepPoint { position: [1.5, -2.25, 0.125], intensity: 17.0, ring: 31 };
        write_sweep_file(&path, &[point, point]).unwrap();
        assert_eq!(read_sweep_file(&path).unwrap().points, [point, point]);
    }

    /// Returns rows around a LiDAR: x y z intensity ring.
    fn rows(count: i64) -> Vec<[f32; 5]> {
        let number = |i: i64, axis: i64, most: f64| crate::hash::between(3, &[i, axis], -most, most) as f32;
        let row = |i: i64| {
            let (intensity, ring) = (number(i, 3, 99.0).abs().floor(), (i % 32) as f32);
            [number(i, 0, 60.0), number(i, 1, 60.0), number(i, 2, 3.0), intensity, ring]
        };
        (0..count).map(row).collect()
    }

    fn bytes<const N: usize>(rows: &[[f32; N]]) -> Vec<u8> {
        rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn parse(bytes: &[u8]) -> Result<Sweep, FileError> {
        parse_sweep(bytes, Path::new("a.pcd.bin"))
    }

    #[test]
    fn rows_without_rings_have_the_same_points() {
        for count in [500, 503] {
            let rows = rows(count);
            let four: Vec<[f32; 4]> = rows.iter().map(|row| [row[0], row[1], row[2], row[3]]).collect();
            let (five, four) = (parse(&bytes(&rows)).unwrap(), parse(&bytes(&four)).unwrap());
            let without = |p: &SweepPoint| SweepPoint { ring: 0, ..*p };
            assert_eq!(four.points, five.points.iter().map(without).collect::<Vec<_>>());
            assert_eq!((four.notes[NO_RING], five.notes.len()), (1, 0));
        }
    }

    #[test]
    fn pcd_headers_are_recognized_at_any_length() {
        let rows = rows(7);
        let expected = parse(&bytes(&rows)).unwrap();
        for padding in 0..20 {
            let header = format!(
                "# .PCD v0.7{}\nVERSION 0.7\nFIELDS x y z intensity ring\nSIZE 4 4 4 4 4\nTYPE F F F F F\n\
                 COUNT 1 1 1 1 1\nWIDTH 7\nHEIGHT 1\nPOINTS 7\nDATA binary\n",
                ".".repeat(padding)
            );
            let file = [header.as_bytes(), &bytes(&rows)].concat();
            assert_eq!(parse(&file).unwrap(), expected, "{padding}");
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.pcd.bin");
            std::fs::write(&path, &file).unwrap();
            assert_eq!(check(&path, None).unwrap(), 7);
        }
    }

    #[test]
    fn rejects_other_formats_by_name() {
        for (start, name) in [(&b"\x93NUMPY\x01\0"[..], "an NPY array"), (b"ply\nformat ascii", "a PLY file")]
        {
            let file = [start, &[0; 2000][..2000 - start.len()]].concat();
            let message = parse(&file).unwrap_err().to_string();
            assert!(message.contains(&format!("or a PCD file, found {name}: ")), "{message}");
        }
    }

    #[test]
    fn only_coordinates_must_be_finite() {
        let rows: [[f32; 5]; 4] = [
            [1.0, 2.0, 3.0, 4.0, 5.0],
            [f32::NAN, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, f32::INFINITY, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, f32::NAN],
        ];
        let sweep = parse(&bytes(&rows)).unwrap();
        assert_eq!((sweep.points.len(), sweep.dropped_non_finite), (2, 2));
        assert_eq!((sweep.points[0].ring, sweep.points[1].ring), (5, 0));
    }

    proptest! {
        #[test]
        fn any_bytes_are_points_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            match parse_sweep(&bytes, Path::new("a.pcd.bin")) {
                Ok(s) => prop_assert_eq!(s.points.len() + s.dropped_non_finite, bytes.len() / POINT_BYTES),
                Err(e) => {
                    let is_finite = |row: &[u8]| {
                        row.as_chunks::<4>().0[..3].iter().all(|v| f32::from_le_bytes(*v).is_finite())
                    };
                    let has_point = bytes.chunks_exact(POINT_BYTES).any(is_finite);
                    prop_assert!(bytes.len() % POINT_BYTES != 0 || !has_point);
                    prop_assert!(e.to_string().ends_with(": a.pcd.bin"));
                }
            }
        }
    }
}
