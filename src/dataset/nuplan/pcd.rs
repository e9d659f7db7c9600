//! PCD files: sweeps with a text header that names the fields, then rows of binary numbers.
//!
//! Only `DATA binary` is supported. Fields other than coordinates, intensity, ring and `lidar_info` (device of a
//! merged sweep) are skipped by their sizes. Bytes after the last point are ignored: in nuPlan's files they are
//! garbage, mostly zeros. Format: <https://pointclouds.org/documentation/tutorials/pcd_file_format.html>.

use std::io::Read;
use std::path::Path;

use crate::dataset::{Sweep, SweepPoint};
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, open_regular, read_file};

/// Maximum header length, bytes; real headers take a few hundred.
const MAX_HEADER_BYTES: u64 = 1 << 16;

/// Returns the number of points of a PCD file from its header, after checking its length.
///
/// # Errors
/// Fails as [`read_pcd_file`], except for errors in the points themselves.
pub fn check_pcd_file(path: &Path) -> Result<u64, FileError> {
    let (file, length) = open_regular(path)?;
    let mut head = Vec::new();
    file.take(MAX_HEADER_BYTES).read_to_end(&mut head).map_err(FileError::io("read", path))?;
    let header = Header::parse(&head, path)?;
    header.check_length(length, path)?;
    Ok(header.points as u64)
}

/// Reads a PCD file. Drops and counts points with a NaN or infinite coordinate.
///
/// # Errors
/// Fails if the file is missing, truncated, compressed or text, its header lacks `x y z` as 4-byte floats, or sizes
/// in the header contradict each other.
pub fn read_pcd_file(path: &Path) -> Result<Sweep, FileError> {
    let bytes = read_file(path, SWEEP_BYTES)?;
    parse_pcd(&bytes, path)
}

/// Parses the bytes of a PCD file; `path` is for messages.
///
/// # Errors
/// Fails as [`read_pcd_file`].
pub fn parse_pcd(bytes: &[u8], path: &Path) -> Result<Sweep, FileError> {
    let header = Header::parse(&bytes[..bytes.len().min(MAX_HEADER_BYTES as usize)], path)?;
    let end = header.check_length(bytes.len() as u64, path)?;
    let points = &bytes[header.start..end];
    let device = |row: &[u8]| header.device.map_or(0, |field| field.number(row) as u16);
    let mut rows = points.chunks_exact(header.stride);
    let first = rows.clone().next().map(device);
    let devices = rows.any(|row| Some(device(row)) != first);
    let mut sweep = Sweep { points: Vec::with_capacity(header.points), dropped_non_finite: 0, devices };
    for row in points.chunks_exact(header.stride) {
        let position = header.position.map(|field| field.number(row) as f32);
        if !position.iter().all(|v| v.is_finite()) {
            sweep.dropped_non_finite += 1;
            continue;
        }
        let intensity = header.intensity.map_or(0.0, |field| field.number(row) as f32);
        let ring = if devices { device(row) } else { header.ring.map_or(0, |f| f.number(row) as u16) };
        sweep.points.push(SweepPoint { position, intensity, ring });
    }
    Ok(sweep)
}

/// Parsed header.
#[derive(Debug)]
struct Header {
    /// Byte offset of the points.
    start: usize,
    points: usize,
    /// Bytes per point.
    stride: usize,
    position: [Field; 3],
    intensity: Option<Field>,
    device: Option<Field>,
    ring: Option<Field>,
}

/// Numeric field of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Field {
    offset: usize,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    F32,
    F64,
    U8,
    U16,
    U32,
    I8,
    I16,
    I32,
}

impl Kind {
    fn parse(kind: &str, size: usize) -> Option<Self> {
        Some(match (kind, size) {
            ("F", 4) => Self::F32,
            ("F", 8) => Self::F64,
            ("U", 1) => Self::U8,
            ("U", 2) => Self::U16,
            ("U", 4) => Self::U32,
            ("I", 1) => Self::I8,
            ("I", 2) => Self::I16,
            ("I", 4) => Self::I32,
            _ => return None,
        })
    }
}

impl Field {
    /// Returns the field's value in a row of the header's stride.
    fn number(self, row: &[u8]) -> f64 {
        let rest = row.get(self.offset..).unwrap_or_default();
        let number = match self.kind {
            Kind::F32 => rest.first_chunk().map(|b| f64::from(f32::from_le_bytes(*b))),
            Kind::F64 => rest.first_chunk().map(|b| f64::from_le_bytes(*b)),
            Kind::U8 => rest.first_chunk().map(|b| f64::from(u8::from_le_bytes(*b))),
            Kind::U16 => rest.first_chunk().map(|b| f64::from(u16::from_le_bytes(*b))),
            Kind::U32 => rest.first_chunk().map(|b| f64::from(u32::from_le_bytes(*b))),
            Kind::I8 => rest.first_chunk().map(|b| f64::from(i8::from_le_bytes(*b))),
            Kind::I16 => rest.first_chunk().map(|b| f64::from(i16::from_le_bytes(*b))),
            Kind::I32 => rest.first_chunk().map(|b| f64::from(i32::from_le_bytes(*b))),
        };
        // Every field was validated to lie within the row.
        number.unwrap_or(f64::NAN)
    }
}

/// Name and layout of a field; no layout for arrays and unknown types.
type Column<'a> = (&'a str, Option<Field>);

/// Header values by key.
#[derive(Default)]
struct Lines<'a> {
    fields: Vec<&'a str>,
    sizes: Vec<&'a str>,
    types: Vec<&'a str>,
    counts: Vec<&'a str>,
    width: &'a str,
    height: &'a str,
    points: &'a str,
}

impl Header {
    fn parse(head: &[u8], path: &Path) -> Result<Self, FileError> {
        let wrong = |expected: &str, found: String| FileError::content(expected, found, path);
        let (lines, start) = Lines::split(head, path)?;
        let number = |key: &str, text: &str| {
            let found = || wrong(&format!("a whole number as {key}"), format!("{text:?}"));
            text.parse::<usize>().map_err(|_| found())
        };
        let (width, height) = (number("WIDTH", lines.width)?, number("HEIGHT", lines.height)?);
        let points = width
            .checked_mul(height)
            .ok_or_else(|| wrong("fewer points", format!("WIDTH {width} and HEIGHT {height}")))?;
        if !lines.points.is_empty() && number("POINTS", lines.points)? != points {
            let found = format!("POINTS {}", lines.points);
            return Err(wrong(&format!("WIDTH times HEIGHT, {points} points"), found));
        }
        let (columns, stride) = lines.columns(path)?;
        let field = |name: &str| columns.iter().find(|(n, _)| *n == name).and_then(|(_, field)| *field);
        let coordinate = |name: &str| {
            let found = || wrong(&format!("{name} as a single 4-byte float (F)"), lines.layout());
            field(name).filter(|f| f.kind == Kind::F32).ok_or_else(found)
        };
        let position = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
        let (intensity, device, ring) = (field("intensity"), field("lidar_info"), field("ring"));
        if points == 0 {
            return Err(wrong("at least one point", "none".to_owned()));
        }
        Ok(Self { start, points, stride, position, intensity, device, ring })
    }

    /// Returns the end offset of the points, or an error if the file is shorter.
    fn check_length(&self, length: u64, path: &Path) -> Result<usize, FileError> {
        let end = self.points.checked_mul(self.stride).and_then(|bytes| bytes.checked_add(self.start));
        end.filter(|end| *end as u64 <= length).ok_or_else(|| {
            let expected = format!("{} points of {} bytes after the header", self.points, self.stride);
            let found = format!("{} bytes (truncated)", length.saturating_sub(self.start as u64));
            FileError::content(expected, found, path)
        })
    }
}

impl<'a> Lines<'a> {
    /// Parses the lines up to `DATA`. Also returns the byte offset of the points.
    fn split(head: &'a [u8], path: &Path) -> Result<(Self, usize), FileError> {
        let mut lines = Self::default();
        let mut at = 0;
        while let Some(length) = head[at..].iter().position(|b| *b == b'\n') {
            let line = str::from_utf8(&head[at..at + length]).unwrap_or_default().trim_end();
            at += length + 1;
            let mut words = line.split_ascii_whitespace();
            let (key, values) = (words.next().unwrap_or(""), words);
            let first = || values.clone().next().unwrap_or_default();
            match key {
                "FIELDS" => lines.fields = values.collect(),
                "SIZE" => lines.sizes = values.collect(),
                "TYPE" => lines.types = values.collect(),
                "COUNT" => lines.counts = values.collect(),
                "WIDTH" => lines.width = first(),
                "HEIGHT" => lines.height = first(),
                "POINTS" => lines.points = first(),
                "DATA" if first() == "binary" => return Ok((lines, at)),
                "DATA" => return Err(FileError::content("DATA binary", format!("{line:?}"), path)),
                "VERSION" | "VIEWPOINT" | "" => {}
                _ if key.starts_with('#') => {}
                _ => break,
            }
        }
        Err(FileError::content("a PCD header that ends with DATA binary", found_instead(head, at), path))
    }

    /// Returns all fields and the bytes per point.
    fn columns(&self, path: &Path) -> Result<(Vec<Column<'a>>, usize), FileError> {
        let wrong = || FileError::content("SIZE, TYPE and COUNT for every field", self.layout(), path);
        let ones = vec!["1"; self.fields.len()];
        let counts = if self.counts.is_empty() { &ones } else { &self.counts };
        if [self.sizes.len(), self.types.len(), counts.len()] != [self.fields.len(); 3] {
            return Err(wrong());
        }
        let (mut columns, mut offset) = (Vec::new(), 0_usize);
        for (i, name) in self.fields.iter().enumerate() {
            let (size, count): (u16, u16) =
                self.sizes[i].parse().ok().zip(counts[i].parse().ok()).ok_or_else(wrong)?;
            let kind = Kind::parse(self.types[i], size.into()).filter(|_| count == 1);
            columns.push((*name, kind.map(|kind| Field { offset, kind })));
            offset += usize::from(size) * usize::from(count);
        }
        Ok((columns, offset))
    }

    /// Formats the layout for messages.
    fn layout(&self) -> String {
        let part = |key: &str, values: &[&str]| format!("{key} {}", values.join(" "));
        let parts = [
            part("FIELDS", &self.fields),
            part("SIZE", &self.sizes),
            part("TYPE", &self.types),
            part("COUNT", &self.counts),
        ];
        parts.join(", ")
    }
}

/// Returns the start of the unexpected content, for messages.
fn found_instead(head: &[u8], at: usize) -> String {
    if head.is_empty() {
        return "an empty file".to_owned();
    }
    match head.get(at..).filter(|rest| !rest.is_empty()) {
        None => format!("none in {} bytes", head.len()),
        Some(rest) => format!("{:?} at byte {at}", String::from_utf8_lossy(&rest[..rest.len().min(40)])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEADER: &str = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity lidar_info ring\nSIZE 4 4 4 1 1 1\n\
        TYPE F F F U U U\nCOUNT 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n";

    /// Two points in the layout above.
    fn file() -> Vec<u8> {
        let mut bytes = HEADER.as_bytes().to_vec();
        for (position, rest) in [([1.5_f32, -2.0, 0.25], [200, 0, 63]), ([3.0, 4.0, 5.0], [7, 4, 0])] {
            bytes.extend(position.map(f32::to_le_bytes).as_flattened());
            bytes.extend(rest);
        }
        bytes
    }

    fn parse(bytes: &[u8]) -> Result<Sweep, FileError> {
        parse_pcd(bytes, Path::new("a.pcd"))
    }

    /// The file with some header text replaced.
    fn changed(from: &str, to: &str) -> Vec<u8> {
        assert!(HEADER.contains(from));
        [HEADER.replace(from, to).as_bytes(), &file()[HEADER.len()..]].concat()
    }

    #[track_caller]
    fn refused(bytes: &[u8], expected: &str, found: &str) {
        let message = parse(bytes).unwrap_err().to_string();
        assert_eq!(message, format!("expected {expected}, found {found}: a.pcd"));
    }

    #[test]
    fn merged_points_are_numbered_by_device() {
        let sweep = parse(&file()).unwrap();
        let point = |position, intensity, ring| SweepPoint { position, intensity, ring };
        assert_eq!(sweep.points, [point([1.5, -2.0, 0.25], 200.0, 0), point([3.0, 4.0, 5.0], 7.0, 4)]);
        assert!(sweep.devices);
    }

    #[test]
    fn a_single_device_keeps_its_rings() {
        let mut bytes = file();
        let device = HEADER.len() + 2 * 15 - 2;
        assert_eq!(std::mem::replace(&mut bytes[device], 0), 4);
        let sweep = parse(&bytes).unwrap();
        assert_eq!((sweep.devices, sweep.points[0].ring, sweep.points[1].ring), (false, 63, 0));
    }

    #[test]
    fn other_fields_are_skipped_and_counts_may_lack() {
        let header = "FIELDS pad z y x time\nSIZE 2 4 4 4 8\nTYPE U F F F F\nCOUNT 3 1 1 1 1\nWIDTH 1\nHEIGHT 1\nDATA binary\n";
        let values = [&[9; 6], [3.0_f32, 2.0, 1.0].map(f32::to_le_bytes).as_flattened(), &[9; 8]].concat();
        let sweep = parse(&[header.as_bytes(), &values].concat()).unwrap();
        assert_eq!(sweep.points, [SweepPoint { position: [1.0, 2.0, 3.0], ..SweepPoint::default() }]);
        assert_eq!(parse(&changed("COUNT 1 1 1 1 1 1\n", "")).unwrap().points.len(), 2);
    }

    #[test]
    fn what_stands_behind_the_points_is_ignored() {
        for behind in [vec![0; 4000], vec![0, 8], vec![0xff; 15], file()] {
            assert_eq!(parse(&[file(), behind].concat()).unwrap(), parse(&file()).unwrap());
        }
    }

    #[test]
    fn not_finite_is_dropped_and_counted() {
        let mut bytes = file();
        bytes[HEADER.len()..HEADER.len() + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        let sweep = parse(&bytes).unwrap();
        assert_eq!((sweep.points.len(), sweep.dropped_non_finite), (1, 1));
    }

    #[test]
    fn truncated_files_are_refused() {
        let whole = file();
        for cut in 0..whole.len() {
            assert!(parse(&whole[..cut]).is_err(), "{cut}");
        }
        refused(&whole[..whole.len() - 1], "2 points of 15 bytes after the header", "29 bytes (truncated)");
        refused(&[], "a PCD header that ends with DATA binary", "an empty file");
        let huge = usize::MAX.to_string();
        let huge = changed("WIDTH 2", &format!("WIDTH {huge}"));
        refused(&huge, &format!("WIDTH times HEIGHT, {} points", usize::MAX), "POINTS 2");
    }

    #[test]
    fn other_layouts_are_refused() {
        let layout =
            "FIELDS x y z intensity lidar_info ring, SIZE 4 4 4 1 1 1, TYPE F F F U U U, COUNT 1 1 1 1 1 1";
        let bytes = changed("TYPE F F F", "TYPE F U F");
        refused(&bytes, "y as a single 4-byte float (F)", &layout.replace("TYPE F F F", "TYPE F U F"));
        let bytes = changed("FIELDS x", "FIELDS u");
        refused(&bytes, "x as a single 4-byte float (F)", &layout.replace("FIELDS x", "FIELDS u"));
        let bytes = changed("SIZE 4 4 4 1 1 1", "SIZE 4 4 4 1 1");
        let found = layout.replace("SIZE 4 4 4 1 1 1", "SIZE 4 4 4 1 1");
        refused(&bytes, "SIZE, TYPE and COUNT for every field", &found);
        refused(&changed("DATA binary", "DATA ascii"), "DATA binary", "\"DATA ascii\"");
        let compressed = changed("DATA binary", "DATA binary_compressed");
        refused(&compressed, "DATA binary", "\"DATA binary_compressed\"");
        refused(&changed("WIDTH 2", "WIDTH -2"), "a whole number as WIDTH", "\"-2\"");
        refused(&changed("POINTS 2", "POINTS 3"), "WIDTH times HEIGHT, 2 points", "POINTS 3");
        assert!(parse(b"\x89PNG\r\n\x1a\n").unwrap_err().to_string().contains("expected a PCD header"));
    }

    #[test]
    fn a_check_counts_without_reading_points() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd");
        std::fs::write(&path, file()).unwrap();
        assert_eq!(check_pcd_file(&path).unwrap(), 2);
        std::fs::write(&path, &file()[..HEADER.len() + 20]).unwrap();
        assert!(check_pcd_file(&path).unwrap_err().to_string().contains("20 bytes (truncated)"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_points_or_an_error(
            places in proptest::collection::vec((0..HEADER.len() + 30, any::<u8>()), 0..6)
        ) {
            let mut bytes = file();
            places.into_iter().for_each(|(at, to)| bytes[at] = to);
            match parse(&bytes) {
                Ok(sweep) => prop_assert!(sweep.points.len() + sweep.dropped_non_finite <= 30),
                Err(e) => prop_assert!(e.to_string().ends_with(": a.pcd")),
            }
        }
    }
}
